"""Chains of given fields, for the dense program and for the package."""

import jax
import jax.numpy as jnp
from oracles.dense_chain import DenseChain, uniform_springs

import slippulse_jax as sp


def ended(slider, sites=None, right="free", machine=None):
    """The same slider with an end, or a machine."""
    end = {} if right == "semi-infinite" else {"length": sites, "right": None if sites is None else right}
    return sp.Slider(slider.height, slider.stiffness, slider.poisson, machine=machine, **end)


def both_chains(slider, sites, right, fields):
    """`DenseChain` and `Chain` of the same bonds, contacts, thresholds and prestress."""
    *_, across, _, end = uniform_springs(*slider, sites, right)
    dense = DenseChain(
        fields["upper"], fields["layer"], across, fields["contact"], end,
        stiffness=slider[1], threshold=fields["threshold"], prestress=fields["prestress"],
    )  # fmt: skip
    return dense, sp.chain(ended(sp.Slider(*slider), sites, right), sites=sites, **fields)


SITES = 150


def long_series(chain, *protocol, ageing=None):
    """150 events of a chain of `SITES`, with a record of breaks: one program for each protocol and way of ageing, whatever is asked."""
    return sp.series(chain, *protocol, events=150, ageing=ageing, recorded_breaks=4000, stop_when_spanning=False)


def batch(trees):
    """One tree of stacked leaves."""
    return jax.tree.map(lambda *x: jnp.stack(x), *trees)
