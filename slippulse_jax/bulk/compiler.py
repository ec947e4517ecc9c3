"""Two things XLA does not do by itself on a CPU: a loop as one function, and several results from one loop over the elements.

`as_one_kernel`: XLA's CPU runtime calls a compiled function for every operation (or fusion of some), at about 0.1 µs each,
which in a loop over short arrays is most of the time. XLA compiles loops that touch less than a kilobyte as a whole; this asks
for it beyond that, by the attribute XLA itself marks such loops with. The attribute is not documented, and XLA ends the process
where such a function is not as it expects.

`in_one_loop`: XLA writes one loop over the elements for each array that is handed on, and repeats in it all that the array
depends on. Its one operation that has several results and takes a function of one's own is a reduction. So the arguments are
laid down twice along a new axis (no memory is written for that) and "reduced" along it by a function that forgets what was
accumulated and takes the row at hand. What is left of it in the compiled program is a loop of vector instructions, each value
computed once. It rests on XLA's reducing on a CPU in the order of the axis.

So both are used only under the releases of jaxlib that the tests were run with; under others everything is compiled as usual,
with the same results to rounding: a series of events takes some five times as long, lengths in bulk and their derivatives
three times.
"""

import functools
import warnings
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import jaxlib.version
from jax import lax

TRIED = ("0.10.0", "0.10.1", "0.10.2")
"""Releases of jaxlib under which tests/test_kernel.py was seen to pass."""


OPTIONS: dict[str, Any] = {
    "xla_cpu_multi_thread_eigen": False,
    "xla_cpu_prefer_vector_width": 512,
    "xla_disable_hlo_passes": "cpu-parallel-task-assigner",
}
"""For programs that run side by side, so that nothing in one is to be split, in loops that fill the widest vectors."""


def _tried() -> bool:
    if jaxlib.version.__version__ in TRIED:
        return True
    _say_once(
        f"jaxlib {jaxlib.version.__version__} is not among the releases slippulse_jax was tuned for ({', '.join(TRIED)}): "
        "results are the same, but lengths in bulk take up to three times as long"
    )
    return False


@functools.cache
def _say_once(what: str) -> None:
    warnings.warn(what, RuntimeWarning, stacklevel=2)


def compiled(f: Callable, *shapes: jax.ShapeDtypeStruct, device: Any) -> Callable[..., Any]:
    """`f` compiled for one device in double precision, with `OPTIONS` on a CPU where this jaxlib knows them."""
    with jax.enable_x64(True), jax.default_device(device), jax.numpy_rank_promotion("allow"):
        lowered = jax.jit(f).lower(*shapes)
    if device.platform != "cpu" or not _tried():
        return lowered.compile()
    try:
        return lowered.compile(compiler_options=OPTIONS)
    except jax.errors.JaxRuntimeError as unknown:
        usual = lowered.compile()  # raises again what has nothing to do with the options
        _say_once(f"compiled without the options slippulse_jax asks for, and so more slowly executed: {unknown}")
        return usual


def as_one_kernel(f: Callable, *given: Any) -> Any:
    """f(*given), compiled as one function on a CPU.

    f must call no library (linear algebra, sorting, random numbers) and contract no axis by a product and a sum, which XLA
    would hand to one.
    """
    if not _tried():
        return f(*given)
    from jax.experimental.xla_metadata import set_xla_metadata

    def with_witnesses(*args: Any) -> tuple:
        # XLA aborts on an argument that such a function does not use: hand on a number of each
        return f(*args), [x[(0,) * x.ndim] for x in jax.tree.leaves(args)]

    whole = jax.jit(with_witnesses)

    def on_cpu(*args: Any) -> Any:
        # nor may one be a constant, which would be folded in and leave its argument unused
        tagged: Any = set_xla_metadata(whole(*lax.optimization_barrier(args)), xla_cpu_small_call="true", inlineable="false")
        return tagged[0]

    return lax.platform_dependent(*given, cpu=on_cpu, default=f)


def in_one_loop(f: Callable, *given: Any) -> Any:
    """f(*given) of trees of arrays of one shape and type, element by element, all results from one loop on a CPU.

    f is written for single numbers, maps them by elementary operations, and has at least as many results as arguments. All
    results should be used: XLA looks for unused ones in a time that grows exponentially with the depth of f.
    """
    if not _tried():
        return f(*given)

    def on_cpu(*given: Any) -> Any:
        arrays, tree = jax.tree.flatten(given)

        def flat(*numbers: Any) -> tuple:
            return tuple(jax.tree.leaves(f(*jax.tree.unflatten(tree, numbers))))

        like = [jax.ShapeDtypeStruct((), x.dtype) for x in arrays]
        results = jax.tree.structure(jax.eval_shape(f, *jax.tree.unflatten(tree, like)))
        spare = results.num_leaves - len(arrays)
        if spare < 0:
            raise ValueError(f"{len(arrays)} arguments, {results.num_leaves} results: in_one_loop needs at least as many")
        one = arrays[0]
        rows = tuple(jnp.broadcast_to(x, (2, *one.shape)) for x in [*arrays, *[jnp.zeros_like(one)] * spare])
        zeros = tuple(jnp.zeros((), x.dtype) for x in rows)
        found = lax.reduce(rows, zeros, lambda _, row: flat(*row[: len(arrays)]), (0,))
        return jax.tree.unflatten(results, found)

    return lax.platform_dependent(*given, cpu=on_cpu, default=f)
