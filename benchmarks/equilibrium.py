"""Equilibrium of a chain against scipy.linalg.solve_banded on the same matrix, in one run.

python -m benchmarks equilibrium [sites …, 100, 10⁴ and 10⁶ by default]
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import solve_banded

import slippulse_jax as sp
from benchmarks.timing import side_by_side
from slippulse_jax.paper import FIG2

SMALLEST = "100"

jax.config.update("jax_enable_x64", True)


def banded(chain, load):
    """Unknowns u_t[0], u[0], u_t[1], u[1] …: two diagonals on either side."""
    n = chain.sites
    upper, layer, across, contact = (np.asarray(x) for x in (chain.upper, chain.layer, chain.across, chain.contact))
    own_t, own = np.zeros(n), np.zeros(n)
    own_t[1:] += upper
    own_t[:-1] += upper
    own[1:] += layer
    own[:-1] += layer
    own_t += across
    own += across + contact
    own_t[-1] += float(chain.end.upper) + float(chain.end.across)
    own[-1] += float(chain.end.layer) + float(chain.end.across)
    bands = np.zeros((5, 2 * n))
    bands[2, ::2], bands[2, 1::2] = own_t, own
    bands[1, 1::2] = bands[3, ::2] = -across
    bands[1, -1] = bands[3, -2] = -across[-1] - float(chain.end.across)
    bands[0, 2::2], bands[0, 3::2] = -upper, -layer
    bands[4, :-2:2], bands[4, 1:-2:2] = -upper, -layer
    rhs = np.zeros(2 * n)
    bands[2, 0], bands[1, 1], bands[0, 2], rhs[0] = 1, 0, 0, load
    return bands, rhs


def main(sizes):
    solve = jax.jit(sp.equilibrium)
    print("| N | slippulse_jax, ms | solve_banded, ms | ratio | largest difference, u_s |")
    print("|---|---|---|---|---|")
    for n in sizes:
        rng = np.random.default_rng(0)
        c = sp.chain(FIG2, sites=n, contact=0.03 * rng.uniform(0.5, 1.5, n))
        state = c.relaxed(3.0)
        bands, rhs = banded(c, 3.0)
        x = solve_banded((2, 2), bands, rhs)
        found = solve(c, state)
        difference = float(jnp.abs(found.layer - x[1::2]).max())
        taken = side_by_side(
            {
                "ours": lambda c=c, state=state: jax.block_until_ready(solve(c, state)),
                "theirs": lambda bands=bands, rhs=rhs: solve_banded((2, 2), bands, rhs),
            },
            int(np.clip(10**6 // n, 3, 100)),
        )
        mine, theirs = taken["ours"], taken["theirs"]
        print(f"| {n} | {1e3 * mine:.3g} | {1e3 * theirs:.3g} | {theirs / mine:.2f} | {difference:.1e} |", flush=True)


if __name__ == "__main__":
    main([int(x) for x in sys.argv[1:]] or (100, 10**4, 10**6))
