"""Programs kept whole: the same numbers without tracing, whatever is in the folder."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slippulse_jax.bulk import kept
from slippulse_jax.bulk.compiler import local_devices
from slippulse_jax.front.lanes import arrest_kernel, gradient_kernel, jet_kernel, length_kernel
from slippulse_jax.lengths import general_kernel

ROOT = Path(__file__).parents[2]

LENGTHS = """
import sys
import jax
import numpy as np
from slippulse_jax import Interface, Slider, precursor_lengths
traced = []
jax.monitoring.register_event_duration_secs_listener(lambda event, *_, **more: traced.append((event, more)))
rng = np.random.default_rng(0)
slider = Slider(rng.uniform(10, 60, 200), rng.uniform(1e-3, 0.05, 200), rng.uniform(0.1, 0.45, 200))
found = precursor_lengths(slider, derivatives=1)
ended = precursor_lengths(Slider(slider.height, slider.stiffness, slider.poisson, length=70.5), Interface(0.02))
few = precursor_lengths(Slider(slider.height[:5], slider.stiffness[:5], slider.poisson[:5]))
jax.tree.map(lambda x: sys.stdout.write(x.tobytes().hex() + "\\n"), (found, ended, few))
print(bool([event for event, _ in traced if 'trace' in event]))
"""


def lengths(folder: Path | None, **more: str) -> tuple[str, bool]:
    """The bits of some lengths, from a process of its own, and whether it had to trace a program."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_COMPILATION_CACHE")}
    env |= {} if folder is None else {kept.FOLDER: str(folder)}
    done = subprocess.run([sys.executable, "-c", LENGTHS], env=env | more, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    *found, traced = done.stdout.split()
    return "".join(found), traced == "True"


@pytest.mark.ci
def test_a_kept_program_gives_the_same_bits_without_tracing(tmp_path):
    usual = lengths(None)
    assert lengths(tmp_path) == usual == (usual[0], True)
    assert len(list(tmp_path.iterdir())) >= 3
    assert lengths(tmp_path) == (usual[0], False)
    # other options of XLA, another program
    assert lengths(tmp_path, XLA_FLAGS="--xla_cpu_enable_fast_math=false") == usual


@pytest.mark.ci
def test_damaged_files_are_replaced_and_an_unwritable_folder_is_not_missed(tmp_path):
    usual = lengths(tmp_path)
    whole = {path: path.read_bytes() for path in tmp_path.iterdir()}
    first, second, third, *others = whole
    changed = bytearray(whole[third])
    changed[len(changed) // 2] ^= 1
    first.write_bytes(b"")
    second.write_bytes(whole[second][:-100])
    third.write_bytes(changed)
    for path in others:
        path.write_bytes(whole[third])  # another program
    assert lengths(tmp_path)[0] == usual[0]
    assert {path: len(path.read_bytes()) for path in tmp_path.iterdir()} == {path: len(x) for path, x in whole.items()}
    assert lengths(tmp_path) == (usual[0], False)
    (tmp_path / "a_file").touch()
    assert lengths(tmp_path / "a_file") == usual


@pytest.mark.parametrize("size", [2**20 + 1, None])
def test_a_file_larger_than_programs_are_is_not_read_whole(tmp_path, monkeypatch, size):
    """One without an end, too; it is replaced."""
    monkeypatch.setenv(kept.FOLDER, str(tmp_path))
    monkeypatch.setattr(kept, "LARGEST", 2**20)
    (device, *_), shapes = local_devices(), [jax.ShapeDtypeStruct((3,), float)]
    path = kept._file(device, "twice", [((3,), str(shapes[0].dtype))])
    if size:
        path.write_bytes(bytes(size))
    else:
        path.symlink_to("/dev/zero")
    program = kept.kept(lambda: jax.jit(lambda x: (2 * x,)).lower(*shapes), lambda one: one.compile(), shapes, device, "twice")
    assert program(jnp.ones(3))[0].tolist() == [2, 2, 2]
    assert path.read_bytes()
    assert path.stat().st_size < 2**20


@pytest.mark.ci
@pytest.mark.slow
def test_a_program_of_the_cache_of_jax_is_compiled_as_usual(tmp_path):
    """XLA cannot write such a program whole; and what is kept whole is not in that cache too."""
    cache = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / "jax"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    usual = lengths(None, **cache)
    assert any("all_chunks" in path.name for path in (tmp_path / "jax").iterdir())
    for _ in range(2):
        assert lengths(tmp_path / "whole", **cache)[0] == usual[0]
    fresh = {**cache, "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "fresh")}
    assert lengths(tmp_path / "others", **fresh) == usual
    assert not any("all_chunks" in path.name for path in (tmp_path / "fresh").iterdir())
    assert lengths(tmp_path / "others", **fresh) == (usual[0], False)


def test_every_program_has_a_name_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setenv(kept.FOLDER, str(tmp_path))
    (device, *_) = local_devices()
    kernels = [length_kernel(100), length_kernel(101), length_kernel(100, "free"), arrest_kernel(100), gradient_kernel(100)]
    kernels += [jet_kernel(100), jet_kernel(100, "clamped")]
    names = [kept._file(device, kernel, width) for kernel in kernels for width in (64, 1000)]
    assert None not in names
    assert len(set(names)) == len(names)
    length_kernel.cache_clear()
    assert kept._file(device, length_kernel(100), 64) == names[0]
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
    assert kept._file(device, kernels[0], 64) not in names


def test_functions_that_are_not_of_this_package_are_never_kept(tmp_path, monkeypatch):
    """Their sources may change while their names stay."""
    monkeypatch.setenv(kept.FOLDER, str(tmp_path))
    (device, *_) = local_devices()
    assert kept._file(device, lambda lanes: (lanes,)) is None
    assert kept._file(device, general_kernel(object(), 10, 0)) is None
    assert kept._file(device, np.ones(3)) is None
    monkeypatch.delenv(kept.FOLDER)
    assert kept._file(device, length_kernel(100)) is None
