"""A chain of given fields, for the dense program and for the package; and a batch of them."""

import jax
import jax.numpy as jnp
import numpy as np

import slippulse_jax as sp
from oracles.dense_chain import Dense, end_stiffness


def both_chains(slider, sites, right, fields):
    """`Dense` and `Chain` of the same bonds, contacts, thresholds and prestress."""
    height, stiffness, poisson = slider
    K_T = 1 / (2 * (1 + poisson) * height)
    dense = Dense(
        K_L=fields["upper"],
        K=fields["layer"],
        K_T=np.full(sites, K_T),
        k=fields["contact"],
        threshold=fields["threshold"],
        prestress=fields["prestress"],
        k_ref=stiffness,
        end=end_stiffness(right, height, 1.0, K_T, stiffness),
    )
    return dense, sp.chain(sp.Slider(height=height, stiffness=stiffness, poisson=poisson), sites=sites, right=right, **fields)


def batch(trees):
    """One tree of stacked leaves."""
    return jax.tree.map(lambda *x: jnp.stack(x), *trees)
