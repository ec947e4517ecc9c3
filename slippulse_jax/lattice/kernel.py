"""Loops of many small operations, compiled by XLA on a CPU into one function instead of one function an operation.

XLA's CPU runtime calls a compiled function for every operation (or fusion of some), at about 0.1 µs each, which in a loop
over short arrays is most of the time. XLA compiles loops that touch less than a kilobyte as a whole; this asks for it beyond
that, by the attribute XLA itself marks such loops with. The attribute is not documented, and XLA ends the process where such a
function is not as it expects. So it is asked for only under the releases of jaxlib that the tests were run with; under others
the loop is compiled as usual: the same breaks, and a series of events takes some five times as long.
"""

from collections.abc import Callable
from typing import Any

import jax
import jaxlib.version
from jax import lax

TRIED = ("0.10.",)
"""Releases of jaxlib under which tests/test_kernel.py was seen to pass."""


def as_one_kernel(f: Callable, *given: Any) -> Any:
    """f(*given), compiled as one function on a CPU.

    f must call no library (linear algebra, sorting, random numbers) and contract no axis by a product and a sum, which XLA
    would hand to one.
    """
    if not jaxlib.version.__version__.startswith(TRIED):
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
