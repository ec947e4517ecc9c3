"""Compiled programs kept whole, so that none is traced again.

JAX's own cache saves the compiling, but JAX has to trace and lower a program to look for it there, which takes a second for the
larger ones. Where the environment names a folder, the programs of `slippulse_jax.bulk.chunks` are kept in it as XLA made them.
A file is named by all that its program depends on: the kernel, the sources of this package, JAX, and the options of XLA.

XLA may fail to write a program, or to read it again. So a program is tried before it is kept and as it is read, and a file that
fails is deleted and its program compiled as usual. Not kept are programs that call a library, which would crash, and those that
JAX's cache holds already, of which XLA writes a part only.
"""

import functools
import hashlib
import math
import os
import threading
import types
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import jax
import jaxlib.version
import numpy as np
from jax.experimental import serialize_executable
from jax.stages import Compiled, Lowered

from slippulse_jax.base.files import read_whole, write_atomically

FOLDER = "SLIPPULSE_PROGRAMS"
"""Environment variable that names the folder; ``slippulse`` sets it to one in the user's cache."""
LARGEST = 256 * 2**20
"""Bytes of the largest program that is read: real ones have a few million."""
LIBRARIES = "stablehlo.custom_call"
"""What a lowered program has where it calls a library, or Python."""
LIMIT = "jax_persistent_cache_min_compile_time_secs"
"""JAX keeps what takes longer to compile."""
PLAIN = (bool, int, float, str, bytes, type(None), jax.tree_util.PyTreeDef)


Shapes = Sequence[jax.ShapeDtypeStruct]


def kept(
    lower: Callable[[], Lowered], compile_it: Callable[[Lowered], Compiled], shapes: Shapes, device: Any, *what: Any
) -> Compiled:
    """Read the program of `what`, or lower, compile and keep it.

    It is read from its file if that has one that works. It takes arrays of these shapes and returns a tuple of arrays.
    """
    path = _file(device, *what, [(x.shape, str(x.dtype)) for x in shapes])
    if path is not None:
        with suppress(Exception):
            digest, results, content = read_whole(path, LARGEST).split(b"\n", 2)
            if digest == _digest(path.name, content):  # XLA may crash on a damaged one
                return _tried(content, shapes, int(results), device)
        with suppress(OSError):
            path.unlink(missing_ok=True)
    lowered = lower()
    if path is None or LIBRARIES in lowered.as_text():
        return compile_it(lowered)
    with _not_in_the_cache_of_jax():
        program = compile_it(lowered)
    with suppress(Exception):
        content, _, _ = serialize_executable.serialize(program)
        results = len(program.out_info)
        _tried(content, shapes, results, device)
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_atomically(path, b"\n".join([_digest(path.name, content), str(results).encode(), content]))
    return program


_compiling: list[float] = []
"""JAX's own limit, once for each thread that is compiling."""
_lock = threading.Lock()


@contextmanager
def _not_in_the_cache_of_jax() -> Iterator[None]:
    """Keep what is compiled out of JAX's cache."""
    with _lock:
        limit = _compiling[0] if _compiling else getattr(jax.config, LIMIT)
        _compiling.append(limit)
        jax.config.update(LIMIT, math.inf)
    try:
        yield
    finally:
        with _lock:
            _compiling.pop()
            if not _compiling:
                jax.config.update(LIMIT, limit)


def _tried(content: bytes, shapes: Shapes, results: int, device: Any) -> Compiled:
    """Read a program and run it on no chunks."""
    trees = (jax.tree.structure((tuple(shapes), {})), jax.tree.structure((0,) * results))
    program = serialize_executable.deserialize_and_load(content, *trees, backend=device.client, execution_devices=[device])
    with jax.enable_x64(True), jax.default_device(device):
        jax.block_until_ready(program(*(np.zeros(x.shape, x.dtype) for x in shapes)))
    return program


def _digest(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + content).hexdigest().encode()


def _file(device: Any, *what: Any) -> Path | None:
    """File of a program; None where it is not kept."""
    folder = os.environ.get(FOLDER)
    if not folder or device.platform != "cpu":
        return None
    try:
        parts = [sources(), jax.__version__, jaxlib.version.__version__, device.id, *map(_name, what)]
    except TypeError:
        return None
    parts += sorted(f"{name}={value}" for name, value in os.environ.items() if name.startswith(("JAX_", "XLA_")))
    return Path(folder, hashlib.sha256(repr(parts).encode()).hexdigest()[:32])


def _name(one: Any) -> Any:
    """Whatever tells a kernel from another; refuse what may change between runs."""
    if isinstance(one, PLAIN):
        return repr(one)
    if isinstance(one, (tuple, list)):
        return type(one).__qualname__, [_name(x) for x in one]
    if isinstance(one, dict):
        return [(_name(x), _name(y)) for x, y in one.items()]
    if isinstance(one, functools.partial):
        return _name((one.func, one.args, one.keywords))
    if isinstance(one, types.FunctionType) and _is_own(one):
        held = [cell.cell_contents for cell in one.__closure__ or ()]
        return one.__module__, one.__qualname__, one.__code__.co_firstlineno, one.__code__.co_code.hex(), _name(held)
    if isinstance(one, type) and _is_own(one) or _is_own(type(one)) and not getattr(one, "__dict__", True):
        return type(one).__qualname__, getattr(one, "__qualname__", "")
    raise TypeError(f"{one!r} may change")


def _is_own(one: Any) -> bool:
    return one.__module__.partition(".")[0] == __name__.partition(".")[0]


@functools.cache
def sources() -> str:
    """Digest of all modules of this package."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()
