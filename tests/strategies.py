"""Where tests look: ranges within the domains of the package, as seeded samples for batches and as hypothesis strategies.

A `Range` maps the unit interval; `sample` draws a batch from several of them by seed, and `sliders`, `interfaces` and `profiles`
are what hypothesis draws one by one and shrinks. One program should serve all examples of a test: arrays of a fixed shape,
numbers that are arguments of a compiled function.
"""

from typing import NamedTuple

import hypothesis
import numpy as np
from hypothesis import strategies as st

from slippulse_jax.base import domains

# the same examples in every run, and no state between runs
hypothesis.settings.register_profile("same", derandomize=True, deadline=None, database=None, max_examples=25)
hypothesis.settings.load_profile("same")


class Range(NamedTuple):
    """Part of a domain, from one end to the other, evenly or on a logarithmic scale."""

    domain: domains.Domain
    start: float
    end: float
    log: bool = False

    def at(self, u):
        """The number a fraction `u` of the way."""
        return self.start * (self.end / self.start) ** u if self.log else self.start + (self.end - self.start) * u


HEIGHT = Range(domains.HEIGHT, 2.0, 1e5, log=True)
STIFFNESS = Range(domains.STIFFNESS, 1.0, 1e-6, log=True)
POISSON = Range(domains.POISSON, 0.0, 0.5)
SLIDER = HEIGHT, STIFFNESS, POISSON
"""The domain the toolkit answers for."""

SHORT = (
    Range(domains.HEIGHT, 3.0, 60.0),
    Range(domains.STIFFNESS, 1e-4, 1.0, log=True),
    Range(domains.POISSON, 0.0, 0.49),
)
"""Fronts of tens of contacts, which dense matrices can follow."""

PRESTRESS = Range(domains.PRESTRESS, -0.9, 0.4)
THRESHOLD_SLOPE = Range(domains.THRESHOLD_SLOPE, -0.002, 0.01)
THRESHOLD = Range(domains.THRESHOLD, 0.85, 1.15)


def sample(count, seed, *ranges):
    """Rows of `count` numbers from each range, all of them inside its domain; SLIDER where no range is given."""
    ranges = ranges or SLIDER
    rows = np.stack(
        [one.at(u) for one, u in zip(ranges, np.random.default_rng(seed).uniform(size=(len(ranges), count)), strict=True)]
    )
    assert all(one.domain.holds(row).all() for one, row in zip(ranges, rows, strict=True))
    return rows


def random_sliders(count, seed):
    """Sliders of the whole domain, (H/λc, k/K, ν) in the last axis."""
    return sample(count, seed).T


def numbers(one):
    """A number of a range."""
    return st.floats(0, 1).map(one.at)


def sliders(ranges=SHORT):
    """(H/λc, k/K, ν)."""
    return st.tuples(*map(numbers, ranges))


def interfaces():
    """(φ, ε)."""
    return st.tuples(numbers(PRESTRESS), numbers(THRESHOLD_SLOPE))


def profiles(sites, prestress=Range(domains.PRESTRESS, -0.3, 0.3)):  # noqa: B008 - a constant
    """(θ, φ), `sites` numbers each; contact 0 the weakest and the most loaded, so that it is the first to break."""

    def edge_first(both):
        theta, phi = (np.array(x) for x in both)
        theta[0], phi[0] = min(theta[0], 0.9), max(phi[0], 0.1)
        return theta, phi

    many = (st.lists(numbers(one), min_size=sites, max_size=sites) for one in (THRESHOLD, prestress))
    return st.tuples(*many).map(edge_first)


def outside(domain):
    """A number outside a domain, at its open ends among them, or not finite."""
    ends = [domain.low, domain.low - 1] + ([domain.high + 0.1] if domain.closed else [domain.high])
    return st.sampled_from([*ends, np.nan, -np.inf, np.inf])
