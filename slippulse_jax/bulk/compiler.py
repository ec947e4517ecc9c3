"""Options of XLA, loops of several results, and products and inverses.

`compile_loops_whole`: XLA's CPU runtime calls a compiled function for every operation (or fusion of some), at 0.1–0.2 µs each;
in a loop over short arrays that is most of the time. XLA compiles a loop whole where one turn of it touches less than a
kilobyte, and an option of its own raises that threshold. The option belongs to a process: ``jax.jit`` cannot pass it for one
function.

`in_one_loop`: XLA writes one loop over the elements for each array that is handed on, and repeats in it all that the array
depends on. Its one operation that has several results and takes a function of one's own is a reduction. So the arguments are
laid down twice along a new axis (no memory is written for that) and "reduced" along it by a function that forgets what was
accumulated and takes the row at hand. What is left of it in the compiled program is a loop of vector instructions, each value
computed once. It rests on XLA's reducing on a CPU in the order of the axis.

Both are for CPUs, and used where this jaxlib is seen to do so: `knows` looks for the option, `reduces_in_one_loop` compiles a
sample. Elsewhere a warning says so, and everything is compiled as usual, with the same results to rounding: series take some
four times as long, lengths in bulk and their derivatives three times.

`in_full`: an accelerator multiplies matrices of single precision with factors rounded to ten bits, unless told not to.
"""

import functools
import mmap
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast

import jax
import jax.numpy as jnp
import jaxlib.version
import numpy as np
from jax import lax
from jax.custom_batching import custom_vmap
from jax.stages import Compiled, Lowered
from jaxtyping import Array, Float

from slippulse_jax.bulk.kept import kept

F = TypeVar("F", bound=Callable)

OPTIONS: dict[str, Any] = {
    "xla_backend_optimization_level": 3,
    "xla_cpu_multi_thread_eigen": False,
    "xla_cpu_prefer_vector_width": 512,
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner,small-while-loop-hoisting",
}
"""For programs that run side by side, so that nothing in one is to be split, in loops that fill the widest vectors.

Whatever the process was given in ``XLA_FLAGS``, they are fully optimised and their loops are never compiled whole, which is
slower over long arrays: the last digit would depend on either.
"""


def local_devices(*, cpu: bool = False) -> Sequence[Any]:
    """Devices to work on: the chosen one or all; or the CPU's."""
    chosen = jax.config.jax_default_device  # pyright: ignore[reportAttributeAccessIssue]
    if chosen is None:
        devices = jax.local_devices()
    else:
        devices = jax.local_devices(backend=chosen)[:1] if isinstance(chosen, str) else [chosen]
    if not cpu or devices[0].platform == "cpu":
        return devices
    try:
        return jax.local_devices(backend="cpu")
    except RuntimeError:  # JAX_PLATFORMS names the accelerator alone
        return devices


@functools.cache
def knows(option: str) -> bool:
    """Whether the XLA of this jaxlib has an option of this name.

    The name is looked for in XLA's own library, in milliseconds: asking XLA itself, by ``XLA_FLAGS``, would end the process if
    the option is unknown.
    """
    for library in Path(jaxlib.version.__file__).parent.glob("*jax_common*"):
        with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            if content.find(f"\0{option}\0".encode()) >= 0:
                return True
    return False


@functools.cache
def _say_once(what: str) -> None:
    warnings.warn(what, RuntimeWarning, stacklevel=2)


def in_full(f: F) -> F:
    """Compute the matrix products of `f` in full precision of their type.

    And those of its derivatives. It goes where a product is written, and on the rule of a derivative that has one: JAX notes
    the precision when it traces. Blocks need none: they are computed in double precision, which every accelerator multiplies
    in full.
    """

    @functools.wraps(f)
    def traced(*args: Any, **kwargs: Any) -> Any:
        with jax.default_matmul_precision("highest"):
            return f(*args, **kwargs)

    return cast(F, traced)


def check_jit() -> None:
    """Check that JAX compiles, as computing in bulk needs."""
    if jax.config.jax_disable_jit:  # pyright: ignore[reportAttributeAccessIssue]
        raise RuntimeError(
            "jax_disable_jit is set (JAX_DISABLE_JIT), and this package needs jit for fits, sweeps and lengths in bulk: unset "
            "it, or compute inside `with jax.disable_jit(False):`"
        )


def compiled(f: Callable, *shapes: jax.ShapeDtypeStruct, device: Any, fusion_emitters: bool, named: Any = None) -> Compiled:
    """Compile `f` for one device in double precision.

    On a CPU it is compiled with `OPTIONS`, if this jaxlib takes them. Where programs are kept (`slippulse_jax.bulk.kept`),
    `named` tells this one from all others; by default f itself does.
    """

    def lowered() -> Lowered:
        with jax.enable_x64(True), jax.default_device(device), jax.numpy_rank_promotion("allow"):
            return jax.jit(f).lower(*shapes)

    def program(lowered: Lowered) -> Compiled:
        if device.platform != "cpu":
            return lowered.compile()
        try:
            return lowered.compile(compiler_options=options)
        except jax.errors.JaxRuntimeError as error:
            usual = lowered.compile()  # raises again if the options are not the reason
            _say_once(f"compiled without the options slippulse_jax asks for, and so more slowly executed: {error}")
            return usual

    options = OPTIONS | {"xla_cpu_use_fusion_emitters": fusion_emitters}
    options = {name: value for name, value in options.items() if knows(name)}  # JAX 0.12 has given up some
    return kept(lowered, program, shapes, device, named or f, options)


LOOP_BYTES = 10_000_000
"""Bytes that a turn of a loop may touch for the loop to be compiled whole: more than any series or rupture needs."""


def compile_loops_whole() -> None:
    """Make XLA compile each loop as one function, in this process.

    It must be called before JAX computes anything. Ruptures and series then run several times as fast on a CPU. It sets the
    environment variable ``XLA_FLAGS``, which XLA reads once and which child processes inherit; options for the backend that
    are there already stay as they are. ``slippulse`` calls it where it helps, in a process of its own.
    """
    options, threshold = "xla_backend_extra_options", "xla_cpu_small_while_loop_byte_threshold"
    flags = os.environ.get("XLA_FLAGS", "")
    if unknown := [name for name in (options, threshold) if not knows(name)]:
        _say_once(
            f"jaxlib {jaxlib.version.__version__} has no option {unknown[0]}: ruptures and series take some four times as long"
        )
    elif options not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --{options}={threshold}={LOOP_BYTES}".strip()


def in_one_loop(f: Callable, *given: Any) -> Any:
    """Evaluate f(*given) element by element, in one loop on a CPU.

    The arguments are trees of arrays of one shape and type. f is written for single numbers, maps them by elementary
    operations, and has at least as many results as arguments. All results should be used: XLA looks for unused ones in a time
    that grows exponentially with the depth of f.
    """
    if local_devices()[0].platform != "cpu" or not reduces_in_one_loop():
        return f(*given)
    return _reduced(f, *given)


@functools.cache
def reduces_in_one_loop() -> bool:
    """Whether this jaxlib compiles a reduction as `in_one_loop` needs it.

    It is seen in a sample, once per process. The rows must be taken in their order, and all results come from one loop.
    """

    def sample(x: Any, y: Any) -> tuple[Any, ...]:
        return y - x, x + 2 * y, x * y  # whole numbers, so exactly; and not its own repetition

    x, y = np.arange(1000.0), np.arange(3000.0, 2000, -1)
    shape = jax.ShapeDtypeStruct(x.shape, np.float64)
    try:
        program = compiled(functools.partial(_reduced, sample), shape, shape, device=local_devices()[0], fusion_emitters=True)
        with jax.enable_x64(True):
            right = all(map(np.array_equal, program(x, y), sample(x, y)))
        loops = str(program.as_text()).count(" fusion(")
        seen = f"in {loops} loops" if right else "in another order"
    except jax.errors.JaxRuntimeError as error:
        right, loops, seen = False, 0, f"with an error ({error})"
    if right and loops == 1:
        return True
    _say_once(f"jaxlib {jaxlib.version.__version__} compiles reductions {seen}: lengths in bulk take up to three times as long")
    return False


def _reduced(f: Callable, *given: Any) -> Any:
    arrays, tree = jax.tree.flatten(given)
    count = len(arrays)

    def once(row: Sequence[Any]) -> Any:  # that holds none of the arrays, which JAX may trace
        return f(*jax.tree.unflatten(tree, row[:count]))

    results = jax.tree.structure(jax.eval_shape(once, [jax.ShapeDtypeStruct((), x.dtype) for x in arrays]))
    spare = results.num_leaves - count
    if spare < 0:
        raise ValueError(f"{count} arguments, {results.num_leaves} results: in_one_loop needs at least as many")
    one = arrays[0]
    rows = tuple(jnp.broadcast_to(x, (2, *one.shape)) for x in [*arrays, *[jnp.zeros_like(one)] * spare])
    zeros = tuple(jnp.zeros((), x.dtype) for x in rows)
    found = lax.reduce(rows, zeros, lambda _, row: tuple(jax.tree.leaves(once(row))), (0,))
    return jax.tree.unflatten(results, found)


def lane_by_lane(f: Callable, *given: Any) -> Any:
    """Evaluate f(*given) lane by lane under ``jax.vmap``.

    On a CPU, where a finished lane costs nothing then, as in ``jax.lax.map``; an accelerator runs the lanes in step.
    """
    one = custom_vmap(f)

    @one.def_vmap
    def _rule(size, in_batched, *args):  # pyright: ignore[reportUnusedFunction]
        given, batched = list(args), list(in_batched)
        if size == 1:  # XLA would unroll a loop over a single lane, which might then round differently
            given = jax.tree.map(lambda x, several: jnp.concatenate([x, x]) if several else x, given, batched)

        def lane(i: Array) -> Any:
            return one(*jax.tree.map(lambda x, several: x[i] if several else x, given, batched))

        found = lax.map(lane, jnp.arange(max(size, 2)))
        found = jax.tree.map(lambda x: x[:size], found)
        return found, jax.tree.map(lambda _: True, found)

    return lax.platform_dependent(*given, cpu=one, default=f)


def solve_without_pivots(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solve a few equations whose diagonal dominates, by elimination without pivots.

    Written out, because a library's solution inside a program that runs beside others can wait for their threads for ever.
    """

    def eliminate(k: Array, system: Array) -> Array:
        row = system[k] / system[k, k]
        return (system - system[:, k][:, None] * row[None]).at[k].set(row)

    return lax.fori_loop(0, right.size, eliminate, jnp.concatenate([matrix, right[:, None]], axis=1))[:, -1]


BY_HALVES = 64
"""Size of a matrix beyond which it is inverted by halves."""


def inverse_without_pivots(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a symmetric positive definite matrix.

    By halves, and of small matrices by elimination. As fast as a library's, which has threads of its own: on cores that are all
    busy these take longer to agree than to compute.
    """
    n, half = len(matrix), len(matrix) // 2
    if n == 0:  # such as displacements across a slider
        return matrix
    if n > BY_HALVES:
        first, beside, last = matrix[:half, :half], matrix[:half, half:], matrix[half:, half:]
        first = inverse_without_pivots(first)
        carried = first @ beside
        last = inverse_without_pivots(last - beside.T @ carried)
        beside = -carried @ last
        return jnp.block([[first - beside @ carried.T, beside], [beside.T, last]])

    def eliminate(k: Array, partly: Array) -> Array:
        here = jnp.arange(n) == k
        row, column = jnp.where(here, 1, partly[k]) / partly[k, k], jnp.where(here, -1, partly[:, k])
        return jnp.where(here[:, None] | here[None], 0, partly) - column[:, None] * row[None]

    return lax.fori_loop(0, n, eliminate, matrix)
