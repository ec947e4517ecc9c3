"""The force law of a distribution of thresholds: exact cases, an explicit ensemble, and where the instability disappears."""

import jax
import numpy as np
import pytest
from oracles.dense_chain import chain_matrix, responses
from scipy import stats

import slippulse_jax as sp
from slippulse_jax.paper.distribution import (
    ThresholdDistribution,
    edge_loads,
    ensemble_force,
    force_law,
    smooth_width,
    stability,
)

FIG2 = sp.Slider(25.0, 0.03, 0.3)


def plain_ensemble(thresholds, stretch):
    """Independent program: one junction after another, broken one by one; a row of thresholds each."""
    force = np.zeros(len(stretch))
    for row in thresholds:
        drawn = iter(row)
        pinned, until = 0.0, next(drawn)
        for i, x in enumerate(stretch):
            while until <= x:
                pinned, until = until, until + next(drawn)
            force[i] += x - pinned
    return force / len(thresholds)


@pytest.mark.ci
def test_exponential_thresholds_have_a_closed_form():
    """Weibull of shape 1: a junction forgets its age, and F = 1 − e^{−X} exactly. Second order in the spacing."""
    errors = []
    for points in (201, 401, 801):
        law = force_law(ThresholdDistribution("weibull", 1.0), points=points)
        errors.append(abs(law.force + np.expm1(-np.asarray(law.stretch))).max())
    assert errors[-1] < 1e-5
    assert (abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 2) < 0.1).all()


@pytest.mark.parametrize(
    ("kind", "width"),
    [("weibull", 0.3), *(pytest.param(*one, marks=pytest.mark.ci) for one in (("normal", 0.1), ("uniform", 0.2)))],
)
def test_plateau_and_cumulative(kind, width):
    """F(∞) = ⟨x²⟩/2⟨x⟩, and P_c is the textbook's."""
    half = np.sqrt(3) * width
    from scipy.special import gamma

    textbook = {
        "normal": stats.truncnorm(-1 / width, 1 / width, 1, width),
        "uniform": stats.uniform(1 - half, 2 * half),
        "weibull": stats.weibull_min(1 / width, scale=1 / gamma(1 + width)),
    }[kind]
    thresholds = ThresholdDistribution(kind, width)
    x = np.linspace(0, 2.5, 50)
    assert abs(thresholds.cumulative(x) - textbook.cdf(x)).max() < 1e-12
    law = force_law(thresholds, reach=40.0, points=4001)
    assert abs(law.force[-1] - textbook.moment(2) / (2 * textbook.moment(1))) < 1e-4
    drawn = np.asarray(thresholds.sample(jax.random.key(0), (200_000,)))
    assert stats.kstest(drawn[:20000], textbook.cdf).pvalue > 1e-3


def test_width_zero_is_the_sawtooth_of_the_paper():
    law = force_law(ThresholdDistribution("uniform", 1e-9), reach=2.5, points=2001)
    x = np.asarray(law.stretch)
    away = (abs(x - 1) > 0.01) & (abs(x - 2) > 0.02)
    assert abs(np.asarray(law.force) - x % 1)[away].max() < 2e-3


@pytest.mark.ci
@pytest.mark.parametrize(
    ("kind", "width"),
    [("weibull", 0.5), *(pytest.param(*one, marks=pytest.mark.ci) for one in (("normal", 0.15), ("uniform", 0.3)))],
)
def test_explicit_junctions_against_the_master_equation_and_a_plain_program(kind, width):
    thresholds = ThresholdDistribution(kind, width)
    stretch = np.linspace(0.1, 3, 30)
    law = force_law(thresholds, points=1601)
    many = ensemble_force(thresholds, 200_000, stretch, jax.random.key(1))
    assert abs(many - law(stretch)).max() < 5 * 0.6 / np.sqrt(200_000)
    from scipy.special import gamma

    rng, shape = np.random.default_rng(2), (800, 100)
    drawn = {
        "normal": lambda: stats.truncnorm.ppf(rng.uniform(size=shape), -1 / width, 1 / width, 1, width),
        "uniform": lambda: 1 + np.sqrt(3) * width * (2 * rng.uniform(size=shape) - 1),
        "weibull": lambda: rng.weibull(1 / width, shape) / gamma(1 + width),
    }
    plain = plain_ensemble(drawn[kind](), stretch)
    assert abs(plain - law(stretch)).max() < 5 * 0.6 / np.sqrt(800)


def test_finite_ensembles_are_reproducible_and_narrow_as_one_over_root():
    thresholds, stretch = ThresholdDistribution("normal", 0.2), np.linspace(1, 3, 40)
    law = np.asarray(force_law(thresholds, points=1601)(stretch))
    few = ensemble_force(thresholds, 400, stretch, jax.random.key(3))
    assert np.array_equal(few, ensemble_force(thresholds, 400, stretch, jax.random.key(3)))
    many = ensemble_force(thresholds, 40_000, stretch, jax.random.key(3))
    ratio = np.std(np.asarray(few) - law) / np.std(np.asarray(many) - law)
    assert 4 < ratio < 25


@pytest.mark.ci
def test_a_single_contact_jumps_below_the_critical_width_and_slides_above():
    """One contact pulled through a spring K_s: balance K_s(U − X) = F(X) has one solution for every U iff F' > −K_s."""
    for spring in (0.5, 1.5):
        for width in (0.05, 0.15, 0.3, 0.5):
            law = force_law(ThresholdDistribution("normal", width), points=3201)
            pulled_by = np.asarray(law.stretch) + np.asarray(law.force) / spring  # U as a function of X
            assert (np.diff(pulled_by) > 0).all() == bool(law.steepest_fall > -spring)


@pytest.mark.slow
def test_critical_width_of_the_papers_slider():
    """Below it the contact at the edge is unstable in its surroundings, above it not; the surroundings from dense solves."""
    own = responses(25, 0.03, 0.3, 300, "semi-infinite", 1)[1]
    matrix = chain_matrix(25, 0.03, 0.3, 801)
    force = np.zeros(1602)
    force[801 + 400] = 0.03
    middle = np.linalg.solve(matrix, force)[801 + 400]
    for kind in ("normal", "uniform", "weibull"):
        width = smooth_width(FIG2, kind)
        below, above = (stability(FIG2, ThresholdDistribution(kind, width * f)) for f in (0.99, 1.01))
        assert not below.smooth
        assert above.smooth
        assert abs(below.surroundings_at_edge - (1 - own[0, 0]) / own[0, 0]) < 1e-8
        assert abs(below.surroundings - (1 - middle) / middle) < 1e-6


def test_smallest_smooth_width_of_a_stiff_slider():
    """A normal law as wide as its mean falls more steeply than one half as wide; and no width will do on a very stiff slider."""
    stiff, stiffest = sp.Slider(25.0, 3.0, 0.3), sp.Slider(25.0, 30.0, 0.3)
    width = smooth_width(stiff, "normal")
    smooth = [bool(stability(stiff, ThresholdDistribution("normal", w)).smooth) for w in (0.99 * width, 1.01 * width, 1.0)]
    assert smooth == [False, True, False]
    assert smooth_width(stiffest, "normal") == np.inf
    assert not any(stability(stiffest, ThresholdDistribution("normal", w)).smooth for w in (0.3, 0.5, 1.0, 10.0))


def plain_edge_loads(law, stretches, sites):
    """Newton's method on the whole chain, as a dense matrix, for one prescribed stretch of the first contact after another."""
    force, dx = np.asarray(law.force), float(law.spacing)
    slope = np.diff(force) / dx
    matrix = chain_matrix(25, 0.03, 0.3, sites)[1:]  # without the row that holds the edge
    contacts = np.arange(sites)
    x, loads = np.zeros(2 * sites), []
    for stretch in stretches:
        x[sites] = stretch
        for _ in range(50):
            u = x[sites:]
            cell = np.clip((u / dx).astype(int), 0, len(slope) - 1)
            residual, tangent = matrix @ x, matrix.copy()
            residual[sites - 1 :] += 0.03 * (force[cell] + (u - cell * dx) * slope[cell] - u)
            tangent[sites - 1 + contacts, sites + contacts] += 0.03 * (slope[cell] - 1)
            moved = np.linalg.solve(np.delete(tangent, sites, axis=1), -residual)
            x = x + np.insert(moved, sites, 0.0)
            if abs(moved).max() < 1e-11:
                break
        loads.append(x[0])
    return np.array(loads)


@pytest.mark.ci
def test_a_chain_of_wide_contacts_slides_smoothly():
    """C12 for the whole chain: the load along the path of the first contact rises without a fall only at widths well beyond the
    criterion of a contact among neighbours that hold; against a dense program, and the equilibrium where it is unique."""
    stretches = np.arange(0.01, 2.5, 0.01)

    @jax.jit
    def path(width):
        law = force_law(ThresholdDistribution("normal", width))
        chain = sp.chain(FIG2, sites=40, law=law)
        loads = edge_loads(chain, stretches)
        at_loads = jax.vmap(lambda u: sp.equilibrium(chain, chain.relaxed(u)).layer[0])(loads[::25])
        return law, loads, at_loads

    alone = smooth_width(FIG2, "normal")
    for width, smooth in ((alone, False), (1.01 * alone, False), (0.19, False), (0.21, False), (0.225, True), (0.3, True)):
        law, loads, edge = path(width)
        assert abs(loads - plain_edge_loads(law, stretches, 40)).max() < 1e-9
        assert bool((np.diff(loads) > 0).all()) == smooth, width
        if smooth:
            assert abs(edge - stretches[::25]).max() < 1e-9


@pytest.mark.parametrize(("kind", "width"), [("normal", 0.0), ("uniform", 0.6), ("weibull", 1.5), ("cauchy", 0.1)])
def test_errors(kind, width):
    with pytest.raises(ValueError, match="ThresholdDistribution"):
        ThresholdDistribution(kind, width)
