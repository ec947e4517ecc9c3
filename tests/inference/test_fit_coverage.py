"""A seeded sample of benchmarks/fit_coverage.py: intervals hold the truth as often as they say, degenerate studies get no number."""

import numpy as np
import pytest

from benchmarks.fit_coverage import DEGENERATE, coverage, degenerate, study
from slippulse_jax import fit

pytestmark = pytest.mark.ci


def within(share, level, tries):
    """Three binomial standard deviations."""
    return abs(share - level) <= 3 * np.sqrt(level * (1 - level) / tries)


def test_sample_of_coverage():
    rng = np.random.default_rng(11)
    hits = np.zeros(2)
    tries = 20
    for _ in range(tries):
        m, truth = study(rng, 3, "identifiable")
        hits += [any(p.low <= truth <= p.high for p in pieces) for pieces in fit(m).intervals["stiffness"].values()]
    assert within(hits[0] / tries, 0.6827, tries)
    assert within(hits[1] / tries, 0.95, tries)


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow if kind == "every front ran past" else ()) for kind in DEGENERATE]
)
def test_degenerate_studies_get_no_number(kind):
    rng = np.random.default_rng(3)
    assert all(degenerate(rng, kind) for _ in range(2))


@pytest.mark.slow
@pytest.mark.parametrize("regime", ["identifiable", "near-plateau"])
@pytest.mark.parametrize("specimens", [1, 3, 8])
def test_coverage(regime, specimens):
    found = coverage(500, specimens, regime, seed=specimens)
    for name in ("profile", "calibrated"):
        assert within(found[name][0].value, 0.6827, 500), (name, found)
        assert within(found[name][1].value, 0.95, 500), (name, found)
