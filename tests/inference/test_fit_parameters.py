"""Several parameters, priors, uncertain inputs, further observables, counts, censoring, losses: each against an independent answer."""

import dataclasses
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from oracles import dense_chain
from reports import unfolded
from scipy.integrate import quad
from scipy.special import ndtr
from scipy.stats import chi2
from scipy.stats import t as student_t
from slopes import slopes_of

import slippulse_jax as sp
from slippulse_jax import Measurements, Parameter, fit, read_measurements
from slippulse_jax.base.status import Outcome
from slippulse_jax.inference.fit import wanted_parameters
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.observables import EVERY, Count, Length
from slippulse_jax.inference.observables.observable import Observations, loss_of
from slippulse_jax.inference.parameters import checked, observables_of, parameter_set
from slippulse_jax.inference.result.samples import bootstrap
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.search.intervals import rise_of
from slippulse_jax.inference.search.likelihood import EXPECTED, INFORMATION, costs, make_problem


def model(height, stiffness, poisson=0.3, prestress=0.0, slope=0.0):
    inputs = Inputs.of(height, stiffness, poisson, prestress, slope)
    return FirstFront().lengths(inputs.ravel()).reshape(inputs.poisson.shape)


def log_stderr(result):
    """Relative standard error of the first parameter."""
    return result.stderrs[result.names[0]] / result.values[result.names[0]]


def observations(observable, value, sigma, weight):
    """Data without a model."""
    return Observations(observable, value, sigma, weight, *[None] * 5)


def log_width(result, level):
    """Width of the interval of the first parameter, in its logarithm; of one piece."""
    (piece,) = result.intervals[result.names[0]][level]
    return np.log(piece.high / piece.low)


HEIGHTS = np.array([15.0, 20.0, 30.0, 45.0, 60.0])


def problem_of_everything(loss):
    """Every parameter at once, and θ."""
    m = Measurements(
        height=[3000, 5000, 7000], poisson=0.3, length=[1500, 3000, 5000], length_sigma=[40, 50, 60], kind=["length", "whole", "at_least"],
        correlation_length=1e-5, young=3e9, displacement=[4e-6, np.nan, 5e-6], displacement_sigma=1e-7, force=[np.nan, 40, 50],
        force_sigma=5, specimen=("A", "B", "B"),
    )  # fmt: skip
    asked = [
        Parameter("stiffness", each="specimen"), "poisson", "prestress", "strength", "offset",
        Parameter("correlation_length", prior=(1e-5, 1e-6)), Parameter("young", prior=(3e9, 1e8)), Parameter("model_factor", prior=(1, 0.1)),
    ]  # fmt: skip
    q = parameter_set(m, asked, observables=observables_of(FirstFront(), loss))
    problem = make_problem(m, q)
    value = {"poisson": 0.31, "prestress": 0.05, "offset": 1e-4}
    start = {
        "areal_stiffness[A]": 2e10,
        "areal_stiffness[B]": 2.3e10,
        "strength": 1e5,
        "model_factor": 1.02,
    }
    size = {**value, **start, "correlation_length": 1.02e-5, "young": 2.95e9}
    return q, problem, np.array([one.theta(size[one.label]) for one in q.free])


@pytest.mark.ci
@pytest.mark.parametrize("loss", ["normal", "student"])
def test_gradient_is_that_of_the_value(loss):
    """Every parameter at once, against central differences of the value."""
    q, problem, theta = problem_of_everything(loss)
    step = np.array([1e-8 if one.name == "offset" else 1e-5 for one in q.free])
    around = np.concatenate([theta + np.diag(step), theta - np.diag(step)])
    values = problem(around).value
    numerical = (values[: len(step)] - values[len(step) :]) / (2 * step)
    found = problem(theta, order=1).gradient[0]
    rounding = 1e-15 * abs(values[0]) / step
    assert (np.abs(found - numerical) <= 1e-4 * np.abs(numerical) + 10 * rounding).all()
    # what is held is left out, and nothing else: in a profile of the stiffness, and where no input of the model moves
    inputs = ("areal_stiffness", "poisson", "prestress", "correlation_length", "young")
    for names in (inputs[:1], inputs):
        held = np.array([one.name in names for one in q.free])
        at = dataclasses.replace(problem, held=held)(theta, order=1)
        np.testing.assert_allclose(at.gradient[0][~held], found[~held], rtol=1e-12)
        np.testing.assert_allclose(
            at.metric[0][~held][:, ~held], problem(theta, order=1).metric[0][~held][:, ~held], rtol=1e-12
        )


def test_parts_of_a_sum_of_squares():
    """Residuals and information of plain lengths with a prior, against the value and its derivatives; replicates."""
    m = Measurements(height=[20.0, 30.0, 40.0], poisson=0.3, length=[20.0, 29.0, 36.0], length_sigma=[0.5, 1.0, 2.0])
    q = parameter_set(m, ["stiffness", Parameter("poisson", prior=(0.3, 0.02))])
    problem = make_problem(m, q)
    theta = np.array([np.log(0.03), 0.31])
    at, mu = problem(theta, order=2), problem.predictions(theta[None])
    residuals = problem.residuals(theta[None])
    np.testing.assert_allclose(residuals[0], [*(mu[0] - m.length) / m.length_sigma, 0, 0.5], rtol=1e-12)
    assert problem.plain
    assert (problem.count, problem.p) == (4, 2)
    assert at.value[0] == pytest.approx((residuals**2).sum() / 2, rel=1e-12)
    jacobian = problem.jacobian(theta)
    information = jacobian.T @ jacobian
    np.testing.assert_allclose(information, at.metric[0], rtol=1e-12)
    np.testing.assert_allclose(jacobian.T @ residuals[0], at.gradient[0], rtol=1e-12)
    # what is left of the second derivatives is Σ r ∂²μ/σ
    step = np.array([1e-4, 1e-4])
    mixed = [problem.predictions((theta + step * s)[None])[0] for s in ([1, 1], [1, -1], [-1, 1], [-1, -1])]
    bend = (mixed[0] - mixed[1] - mixed[2] + mixed[3]) / 4e-8
    assert at.curvature[0, 0, 1] == pytest.approx(
        at.metric[0, 0, 1] + (residuals[0, :3] / m.length_sigma * bend).sum(), rel=1e-4
    )
    # other numbers measured, in lane 1
    lengths = np.stack([m.length, m.length + 1])
    both = problem.with_replicates([(lengths, np.ones((2, 3)))], np.array([[0, 0.3], [0, 0.28]]))
    other = (mu[0] - lengths[1]) / m.length_sigma
    values = both(np.stack([theta, theta]), lane=np.array([0, 1])).value
    np.testing.assert_allclose(values, [at.value[0], ((other**2).sum() + 1.5**2) / 2], rtol=1e-12)


def closed_form(rows, ways):
    """ℓ* at rows of (ln H/λc, ln k/K, ν, φ, ε), and its first two derivatives along `ways`."""

    def along(row, way):
        def length(t):
            x = row + t * way
            return sp.exact_length(sp.Slider(jnp.exp(x[0]), jnp.exp(x[1]), x[2]), sp.Interface(x[3], x[4]))

        return length(0.0), jax.jacfwd(length)(0.0), jax.jacfwd(jax.jacfwd(length))(0.0)

    with jax.enable_x64(True):
        return [np.asarray(x) for x in jax.jit(jax.vmap(along))(rows, ways)]


@pytest.mark.ci
@pytest.mark.parametrize("prestressed", [pytest.param(False, marks=pytest.mark.slow), True])
def test_slopes_are_those_of_the_closed_form(prestressed):
    """In every input, and the second derivative along a line in all, against the series: the longer a front the closer."""
    rng = np.random.default_rng(2)
    inputs = Inputs(rng.uniform(1.5, 9, 200), rng.uniform(-8, -2, 200), rng.uniform(0, 0.45, 200), *np.zeros((2, 200)))
    inputs = inputs._replace(
        prestress=prestressed * rng.uniform(-0.3, 0.3, 200), threshold_slope=prestressed * 1e-3 * np.exp(-inputs.log_height)
    )
    way = rng.normal(size=(200, 5)) * np.exp(-np.outer(inputs.log_height, np.arange(5) == 4))
    found, expected = FirstFront().evaluate(inputs, way), closed_form(np.stack(inputs[:5], 1), way)
    for low, high, most in ((10, 30, 1e-3), (30, 100, 1e-5), (100, 1e9, 1e-7)):
        here = (expected[0] > low) & (expected[0] < high)
        assert here.sum() > 10
        for mine, theirs, factor in zip(found, expected, (1, 1, 100), strict=True):
            assert (np.abs(mine - theirs) / (np.abs(theirs) + expected[0]))[here].max() < factor * most


def test_tall_sliders_and_stiff_contacts_beside_the_loop():
    """Where values and derivatives are not those of the loop: against the series, and against JAX's of the recursion."""
    inputs = Inputs.of([2e4, 3e4, 25.0, 25.0], [1e-4, 1e-4, 7.9, 8.1], 0.3)
    way = np.tile([0.0, 1, 0, 0, 0], (4, 1))
    found, tall = FirstFront().evaluate(inputs, way), closed_form(np.stack(inputs[:5], 1), way)

    def length(log_stiffness):
        return sp.precursor_length(sp.Slider(25.0, jnp.exp(log_stiffness), 0.3))

    with jax.enable_x64(True):
        stiff = [jax.vmap(f)(inputs.log_stiffness[2:]) for f in (length, jax.grad(length), jax.hessian(length))]
    for mine, theirs, others, rtol in zip(found, tall, stiff, (1e-10, 1e-7, 1e-4), strict=True):
        np.testing.assert_allclose(mine[:2], theirs[:2], rtol=rtol)
        np.testing.assert_allclose(mine[2:], others, rtol=rtol)


@pytest.mark.ci
def test_slopes_in_the_threshold_slope_and_at_the_end_of_the_domain():
    rng = np.random.default_rng(3)
    inputs = Inputs(rng.uniform(4, 6, 20), rng.uniform(-7, -3, 20), np.full(20, 0.5), np.zeros(20), np.full(20, 1e-4))
    lanes = np.stack([np.exp(inputs.log_height), np.exp(inputs.log_stiffness), *inputs[2:5]])
    exact = sp.exact_lengths(sp.Slider(*lanes[:3]), sp.Interface(*lanes[3:]), derivatives=1)
    found = slopes_of(FirstFront(), inputs, ("poisson", "threshold_slope"))
    np.testing.assert_allclose(found["threshold_slope"], exact.interface.threshold_slope, rtol=1e-4)
    np.testing.assert_allclose(found["poisson"], exact.slider.poisson, rtol=1e-4)


def test_likelihood_of_a_count_is_that_of_its_interval():
    """P(n) = Φ((n − ℓ)/σ) − Φ((n − 1 − ℓ)/σ), also far out in both tails, and without blur the interval itself."""
    data = observations(
        Count(),
        np.array([[26.0, 26, 26, 26]]),
        np.array([0.7, 0.01, 1e-6, 0.0]),
        np.ones((1, 4)),
    )
    for mu in (25.3, 25.99, 20.0, 40.0):
        # by the tail that loses no digits
        a, b = (25 - mu) / 0.7, (26 - mu) / 0.7
        probability = ndtr(-a) - ndtr(-b) if a > 0 else ndtr(b) - ndtr(a)
        found, slope, *_ = costs(np.full((1, 4), mu), data, np.zeros(1, int))
        assert found[0, 0] == pytest.approx(-np.log(probability), rel=1e-9)
        assert np.isfinite(found).all()
        h = 1e-6
        near = [costs(np.full((1, 4), mu + s), data, np.zeros(1, int))[0] for s in (h, -h)]
        np.testing.assert_allclose(slope[0, :1], (near[0] - near[1])[0, :1] / (2 * h), rtol=1e-6)
        inside = 25 < mu <= 26
        assert (found[0, 3] < 1e-6) == inside


def test_an_improbable_count_is_as_rare_as_its_cost_says():
    """What lets a count be tested: costs of t more than that of the middle of a count have a probability of 2 exp(−t) at most."""
    count, worst = np.arange(1.0, 160), 0.0
    for sigma in np.geomspace(0.02, 20, 13):
        m = Measurements(np.full(159, 200.0), 0.3, count, np.full(159, sigma), kind=["whole"] * 159)
        problem = make_problem(m, parameter_set(m, wanted_parameters(m, "stiffness", None, None)))
        least = np.where(count > 1, -np.log(2 * ndtr(1 / (2 * sigma)) - 1), 0)
        assert problem.perfect(problem.parameters.low) == pytest.approx(2 * least.sum(), rel=1e-9, abs=1e-9)
        for mu in np.concatenate([np.linspace(0, 3, 16), np.linspace(30, 31, 11)]):
            cost = costs(np.full((1, 159), mu), problem.observed[0], np.zeros(1, int))[0, 0]
            rare = np.exp(least - cost)
            order = np.argsort(rare)
            share = np.cumsum(np.exp(-cost)[order]) / np.maximum(rare[order], 1e-300)
            worst = max(worst, float(share[rare[order] > 1e-9].max()))
    assert 1.9 < worst < 2.001


@pytest.mark.ci
@pytest.mark.parametrize("kind", ["at_least", "whole"])
def test_a_misfit_beside_a_limit_or_a_count_is_seen(kind):
    """Two lengths of different stiffnesses, with a third that the model may meet or miss: 0.2 said that it fits."""
    height = np.array([250.0, 500.0, 750.0])
    length = model(height, 3e-4) * [1.1, 1 / 1.1, 1.0]
    length[2] = np.floor(0.5 * length[2]) if kind == "at_least" else np.ceil(length[2])
    m = Measurements(height, 0.3, length, 0.01 * length, kind=["length", "length", kind])
    result = fit(m)
    assert result.identifiability is Identifiability.POOR_FIT
    plain = fit(Measurements(height[:2], 0.3, length[:2], 0.01 * length[:2]))
    if kind == "at_least":  # it costs nothing, so χ² and its degree of freedom are those of the two lengths
        assert result.testable_dof == 1
        assert result.misfit == pytest.approx(plain.deviance, rel=1e-6)
    else:
        assert result.testable_dof == 4  # two of each kind, none less for the parameter: a bound
    met = fit(dataclasses.replace(m, length=np.where(np.arange(3) < 2, model(height, 3e-4), length)))
    assert met.identifiability is Identifiability.IDENTIFIED
    assert met.p_value > 0.5
    assert "(p at most " in unfolded(met.report()) or kind == "at_least"


def test_a_limit_that_the_lengths_deny_counts_against_the_fit():
    height = np.array([250.0, 500.0, 750.0])
    length = model(height, 3e-4) * [1.0, 1.0, 1.1]
    result = fit(Measurements(height, 0.3, length, 0.01 * length, kind=["length", "length", "at_least"]))
    assert result.identifiability is Identifiability.POOR_FIT
    assert result.testable_dof == 4
    assert "The deviance is" in unfolded(result.report())
    assert "degrees of freedom" not in unfolded(result.report())  # of which the bound on p takes more than there are data
    assert "(p at most " in unfolded(result.report())


def test_a_datum_left_out_costs_nothing_where_its_front_never_stops():
    """Nor does it warn: 0 times inf is NaN. As in a refit without an outlier, and in a bootstrap by cases."""
    data = observations(Length(), np.array([[9.0, 20.0]]), np.array([0.5, 0.5]), np.array([[1.0, 0.0]]))
    found = costs(np.array([[9.5, np.inf]]), data, np.array([0]))
    np.testing.assert_allclose(found[0], [[0.5, 0.0]])
    assert np.isfinite(found).all()


def test_fixed_that_is_no_dict_is_named():
    with pytest.raises(TypeError, match=r"fixed is list: must be a dict of parameters and values, as {'poisson': 0.3}"):
        fit(Measurements([25.0, 50.0], 0.3, [14.0, 36.0], 0.5), fixed=["poisson"])


def test_counts_of_every_length_add_up_to_certainty():
    """A count of 1 is any length up to 1: contact 0 breaks even where no domino starts."""
    count = np.arange(1.0, 40)
    for sigma in (0.0, 0.3, 2.0):
        data = observations(Count(), count[None], np.full(39, sigma), np.ones((1, 39)))
        for mu in (0.0, 0.6, 3.2, 17.4):
            found, slope, *_ = costs(np.full((1, 39), mu), data, np.zeros(1, int))
            assert np.exp(-found).sum() == pytest.approx(1, abs=1e-12)
            assert np.isfinite(slope).all()


def test_losses():
    """−ln p of Student's t with 4 degrees of freedom; its information and mean deviance, from integrals."""
    r = np.array([0.1, 1.0, 5.0])
    np.testing.assert_allclose(loss_of(r**2 / 2, "student"), student_t.logpdf(0, 4) - student_t.logpdf(r, 4), rtol=1e-12)
    np.testing.assert_array_equal(loss_of(r**2 / 2), r**2 / 2)
    own = quad(lambda r: 5 * np.log1p(r**2 / 4) * student_t.pdf(r, 4), -np.inf, np.inf)[0]
    assert [EXPECTED[loss] for loss in ("normal", "student")] == pytest.approx([1, own], rel=1e-9)
    score = quad(lambda r: (5 * r / (4 + r**2)) ** 2 * student_t.pdf(r, 4), -np.inf, np.inf)[0]
    assert [INFORMATION[loss] for loss in ("normal", "student")] == pytest.approx([1, score], rel=1e-9)


@pytest.mark.ci
def test_whole_contacts_without_blur_allow_the_interval_of_stiffness():
    """26 contacts at H/λc = 25, σ = 0: the values of k/K with 25 < ℓ ≤ 26, in two pieces, and no best one."""
    result = fit(Measurements(height=[25.0], poisson=0.3, length=26, length_sigma=0.0, kind=["whole"]))
    assert result.stderrs["stiffness"] is None
    grid = np.exp(np.linspace(np.log(0.01), np.log(0.3), 40_001))
    inside = (model(25.0, grid) > 25) & (model(25.0, grid) <= 26)
    ends = grid[np.nonzero(np.diff(inside.astype(int)))[0]]
    pieces = result.intervals["stiffness"][0.95]
    found = np.array([end for piece in pieces for end in (piece.low, piece.high)])
    np.testing.assert_allclose(found, ends, rtol=2e-3)


@pytest.mark.ci
def test_all_censored_is_one_sided_and_never_a_number():
    result = fit(Measurements(height=[20.0, 30.0], poisson=0.3, length=[8, 12], length_sigma=1.0, kind=["at_least"] * 2))
    assert result.identifiability is not Identifiability.IDENTIFIED
    assert result.stderrs["stiffness"] is None
    (piece,) = result.intervals["stiffness"][0.95]
    assert piece.open_high
    assert not piece.open_low


@pytest.mark.ci
def test_one_outlier():
    """Student's loss stays near the truth where least squares does not."""
    length = model(HEIGHTS, 0.004)
    length[2] *= 1.5
    m = Measurements(height=HEIGHTS, poisson=0.3, length=length, length_sigma=0.02 * model(HEIGHTS, 0.004))
    off = {loss: abs(np.log(fit(m, loss=loss).values["stiffness"] / 0.004)) for loss in ("normal", "student")}
    assert off["student"] < off["normal"]
    assert off["student"] < 0.02


@pytest.mark.ci
def test_uncertain_inputs_widen_the_error_as_propagation_says():
    """One λc and ν, each with its own error, shared by all lengths: var = var(ℓ) + Σ (∂ ln k/∂input)² var(input)."""
    length = model(HEIGHTS * 100, 6e-5)
    common = dict(
        height=HEIGHTS * 100, poisson=0.3, length=length, length_sigma=0.01 * length, correlation_length=1e-5, young=3e9
    )
    plain = fit(Measurements(**common))
    wide = fit(Measurements(**common, poisson_sigma=0.02, young_sigma=0.2e9))
    assert set(wide.inputs) == {"poisson[0.3]", "young[3e+09]"}
    shifted = fit(Measurements(**{**common, "poisson": 0.301}))
    by_poisson = (np.log(shifted.values["areal_stiffness"]) - np.log(plain.values["areal_stiffness"])) / 0.001
    expected = np.sqrt(log_stderr(plain) ** 2 + (by_poisson * 0.02) ** 2 + (0.2 / 3) ** 2)
    assert log_stderr(wide) == pytest.approx(expected, rel=0.05)
    assert log_width(wide, 0.6827) / 2 == pytest.approx(expected, rel=0.05)


@pytest.mark.ci
def test_prestress_of_either_sign_beside_a_front_that_ran_away():
    """The truth back; and each row's front ends as its own conditions have it, whatever those of the others are."""
    phi = np.array([-0.3, 0.0, 0.3, -0.01, 0.6])
    length = model(HEIGHTS, 0.01, prestress=phi)
    assert np.isinf(length[4])
    assert (np.diff(model(30.0, 0.01, prestress=np.linspace(-0.9, 0.5, 8))) > 0).all()
    known = {"poisson": 0.3, "length_sigma": 0.1, "kind": ["length"] * 4 + ["at_least"], "prestress": phi}
    result = fit(Measurements(height=HEIGHTS, length=np.where(np.isfinite(length), length, 200.0), **known), ["stiffness"])
    assert result.values["stiffness"] == pytest.approx(0.01, rel=1e-6)
    assert list(result.front_status) == [Outcome.ARRESTED] * 4 + [Outcome.RUN_AWAY]


@pytest.mark.ci
def test_two_parameters_are_found_and_correlated():
    """k/K and a common prestress from heights and known data: the truth back, and the profile against a grid."""
    truth = 0.006, 0.2
    length = model(HEIGHTS, truth[0], prestress=truth[1])
    result = fit(
        Measurements(height=HEIGHTS, poisson=0.3, length=length, length_sigma=0.005 * length),
        ["stiffness", Parameter("prestress", bounds=(0.0, 0.45))],
    )
    assert result.values["stiffness"] == pytest.approx(truth[0], rel=1e-4)
    assert result.values["prestress"] == pytest.approx(truth[1], abs=1e-4)
    (value,) = result.correlations.values()
    assert -1 < value < 0  # both lengthen the precursor
    curve = result.curves["prestress"]
    i = len(curve.node) // 3
    k = np.exp(np.linspace(np.log(1e-3), np.log(0.03), 20001))
    chi2 = (((model(HEIGHTS, k[:, None], prestress=curve.node[i]) - length) / (0.005 * length)) ** 2).sum(axis=1)
    assert curve.deviance[i] == pytest.approx(chi2.min(), rel=1e-3)


def test_areal_stiffness_and_young_together_are_refused_a_number():
    """Only their ratio acts: said, with the ratio, and no standard error for either."""
    length = model(HEIGHTS * 100, 6e-5)
    m = Measurements(
        height=HEIGHTS * 100, poisson=0.3, length=length, length_sigma=0.01 * length, correlation_length=1e-5, young=3e9
    )
    result = fit(m, ["stiffness", "young"])
    assert result.identifiability is Identifiability.UNINFORMATIVE
    assert result.stderrs["areal_stiffness"] is None
    assert result.stderrs["young"] is None
    assert "young^-1" in result.reason
    first, second = result.directions
    assert np.isfinite(first["stderr"])
    assert np.isinf(second["stderr"])
    np.testing.assert_allclose(np.abs(first["coefficients"]), np.sqrt(0.5), rtol=1e-6)


@pytest.mark.ci
def test_force_and_displacement_give_the_strength():
    """σ_s is in the load at nucleation and not in the length."""
    areal, young, lc, strength = 2e10, 3e9, 1e-5, 2e6
    height = HEIGHTS * 100
    inputs = Inputs.of(height, areal * lc / young, 0.3)
    length = FirstFront().lengths(inputs)
    m = Measurements(
        height=height, poisson=0.3, length=length, length_sigma=0.01 * length, correlation_length=lc, young=young,
        displacement=EVERY["displacement"]().evaluate(FirstFront(), inputs)[0] * strength / areal, displacement_sigma=1e-6,
        force=EVERY["force"]().evaluate(FirstFront(), inputs)[0] * strength * lc, force_sigma=100.0,
    )  # fmt: skip
    result = fit(m, ["stiffness", "strength"])
    assert result.values["strength"] == pytest.approx(strength, rel=1e-5)
    assert result.values["areal_stiffness"] == pytest.approx(areal, rel=1e-5)
    assert result.identifiability is Identifiability.IDENTIFIED


def test_force_at_nucleation_is_what_the_contacts_carry():
    """The sum over the lattice modes, against the stresses of a dense chain added up one by one."""
    load, _ = dense_chain.responses(10.0, 0.03, 0.3, 600, "semi-infinite", 600)
    inputs = Inputs.of([10.0], 0.03, 0.3)
    assert EVERY["force"]().evaluate(FirstFront(), inputs)[0, 0] == pytest.approx(load.sum() / load[0], rel=1e-9)
    assert EVERY["displacement"]().evaluate(FirstFront(), inputs)[0, 0] == pytest.approx(1 / load[0], rel=1e-9)


@pytest.mark.ci
@pytest.mark.parametrize("young_sigma", [None, 2e8])
def test_errors_from_the_scatter_keep_those_of_inputs(young_sigma):
    """Only the ratios of σ count; a stated error of E adds in quadrature, as k/E is what the lengths determine."""
    rng = np.random.default_rng(7)
    height = np.repeat([2000.0, 3500, 5000, 8000], 2)
    length = model(height, 7.5e-5) * (1 + 0.03 * rng.standard_normal(8))

    def fitted(size, young_sigma):
        known = {"correlation_length": 1e-5, "young": 3.3e9, "young_sigma": young_sigma}
        m = Measurements(height=height, poisson=0.3, length=length, length_sigma=size and size * length, **known)
        return fit(m, sigma="relative")

    exact = fitted(0.03, None)
    for size in (0.003, 0.03, 0.3, None):
        result = fitted(size, young_sigma)
        assert result.identifiability is Identifiability.IDENTIFIED
        if size is None:  # of equal size, which is another fit
            exact = fitted(None, None)
        value, error = exact.values["areal_stiffness"], exact.stderrs["areal_stiffness"]
        assert result.values["areal_stiffness"] == pytest.approx(value, rel=1e-6)
        assert result.stderrs["areal_stiffness"] == pytest.approx(np.hypot(error, value * (young_sigma or 0) / 3.3e9), rel=1e-3)
        assert np.mean((result.residuals) ** 2) * 8 / 7 == pytest.approx(1, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["normal", "student"])
def test_scatter_of_many_lengths_is_that_of_their_errors(loss):
    """The size is right for errors as the loss supposes: of 6000 lengths to within two and a half standard errors."""
    rng, count = np.random.default_rng(11), 6000
    errors = rng.standard_t(4, count) if loss == "student" else rng.standard_normal(count)
    height = np.repeat(np.geomspace(20, 200, 20), count // 20)
    length = model(height, 0.004)
    m = Measurements(height=height, poisson=0.3, length=length * (1 + 0.02 * errors), length_sigma=0.01 * length)
    result = fit(m, sigma="relative", loss=loss, intervals="profile")
    assert result.scatter == pytest.approx(2, rel=2.5 * (0.016 if loss == "student" else 0.012))


@pytest.mark.ci
def test_scaled_errors():
    """σ doubled, all of them: same value, same error when only their ratios are believed; half with σ given."""
    rng = np.random.default_rng(3)
    length = model(HEIGHTS, 0.004)
    noisy = length * (1 + 0.02 * rng.standard_normal(5))
    fits = [
        fit(Measurements(height=HEIGHTS, poisson=0.3, length=noisy, length_sigma=c * length), sigma="relative")
        for c in (0.01, 0.02)
    ]
    for name in ("values", "stderrs"):
        assert getattr(fits[0], name) == pytest.approx(getattr(fits[1], name), rel=1e-6)
    assert "scaled by" in fits[0].report()
    none = fit(Measurements(height=HEIGHTS, poisson=0.3, length=noisy))
    assert "No standard errors were given" in none.report()
    assert log_width(none, 0.95) / 2 == pytest.approx(
        2.776 * log_stderr(none), rel=0.1
    )  # Student's t with four degrees of freedom


@pytest.mark.ci
def test_bootstrap_spread_is_the_standard_error():
    length = model(HEIGHTS, 0.004)
    result = fit(Measurements(height=HEIGHTS, poisson=0.3, length=length, length_sigma=0.01 * length))
    drawn = bootstrap(result, 400, seed=1)
    assert drawn.lost == 0
    assert drawn.theta.std() == pytest.approx(log_stderr(result), rel=0.15)
    again = bootstrap(result, 400, seed=1)
    np.testing.assert_array_equal(drawn.theta, again.theta)
    case = bootstrap(result, 50, kind="case")
    assert case.theta.std() < 1e-6  # exact data refit to the same value whichever are drawn


def test_table_with_everything(tmp_path):
    path = tmp_path / "all.csv"
    path.write_text(
        "specimen,height_mm,height_sigma_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm,kind,prestress,"
        "displacement_um,displacement_sigma_um,force_N_per_mm,force_sigma_N_per_mm\n"
        "A,50,0.1,10,0.3,3,20,0.5,length,0,,,40,2\nA,60,0.1,10,0.3,3,30,,at_least,0.1,3,0.1,,\n"
    )
    m = read_measurements(path)
    assert m.kind == ("length", "at_least")
    assert m.length_sigma[1] == 0
    np.testing.assert_allclose(m.height_sigma, 10)
    assert np.isnan(m.displacement[0])
    assert m.displacement[1] == pytest.approx(3e-6)
    assert m.force[0] == pytest.approx(4e4)
    q = parameter_set(m, ["stiffness", "strength"])
    assert q.names == ["areal_stiffness", "strength", "height[A, 0.05]", "height[A, 0.06]"]


def test_bounds_leave_a_parameter_as_it_was():
    """Whether it is a nuisance too."""
    m, one = Measurements([25.0], 0.3, length=[20.0]), Parameter("stiffness", prior=(0.1, 0.01), nuisance=True)
    assert wanted_parameters(m, one, (1e-3, 1.0), None) == [dataclasses.replace(one, bounds=(1e-3, 1.0))]
    with pytest.raises(ValueError, match="bounds of the stiffness, which is not fitted"):
        wanted_parameters(m, "prestress", (1e-3, 1.0), {"stiffness": 0.01})


@pytest.mark.parametrize("more", [{"prior": (0.3, 0.05)}, {"bounds": (0.2, 0.4)}, {"each": "specimen"}])
def test_a_held_parameter_takes_nothing_else(more):
    with pytest.raises(ValueError, match="parameter poisson: held by `value`, so that a prior"):
        Parameter("poisson", value=0.31, **more)


@pytest.mark.ci
def test_intervals_of_the_ratio_do_not_depend_on_the_order_of_parameters():
    """k/K is proportional to the areal stiffness, whether that was asked for first or last."""
    m = read_measurements(Path(__file__).resolve().parents[2] / "fit_examples/pmma_block/lengths.csv")
    both = (["stiffness", "prestress"], ["prestress", "stiffness"])
    one, other = (fit(m, free, intervals="profile") for free in both)
    assert one.intervals["stiffness"][0.95][0].low == pytest.approx(other.intervals["stiffness"][0.95][0].low, rel=1e-4)


@pytest.mark.parametrize("dof", [1, 2, 3, 5])
def test_rise_is_the_quantile_of_chi_squared(dof):
    for level in (0.6827, 0.95):
        assert chi2.cdf(rise_of(level, dof), dof) == pytest.approx(level, rel=1e-12)


@pytest.mark.ci
def test_a_root_that_nothing_determines_has_no_error():
    """Of two specimens, one with a count alone, which a range of stiffness gives: no ± of many times the value."""
    height = np.array([30.0, 40.0, 50.0, 50.0])
    length = np.asarray(sp.exact_lengths(sp.Slider(height, 0.002, 0.3)))
    length[3] = np.ceil(length[3])
    kind, sigma = ["length"] * 3 + ["whole"], [0.5] * 3 + [0.0]
    result = fit(
        Measurements(height, 0.3, length, sigma, kind=kind, specimen=list("AAAB")), Parameter("stiffness", each="specimen")
    )
    for root in result.roots:
        assert root.stderrs["stiffness[B]"] is None
        assert root.stderrs["stiffness[A]"] < 0.1 * root.values["stiffness[A]"]


def test_simulated_intervals_are_refused_before_the_search(monkeypatch):
    """Of three parameters, of counts, and where the size of errors is taken from the scatter."""

    def searched(*_, **__):
        raise AssertionError("searched")

    monkeypatch.setattr("slippulse_jax.inference.fit._explore", searched)
    m = Measurements([30, 40, 50, 60.0], 0.3, [12.0, 18.0, 25.0, 30.0], 0.5)
    for given, free, more in (
        (m, ["stiffness", "prestress", "threshold_slope"], {}),
        (dataclasses.replace(m, kind=["whole"] * 4, length_sigma=0.0), ["stiffness"], {}),
        (m, ["stiffness"], {"sigma": "relative"}),
    ):
        with pytest.raises(ValueError, match="calibrated intervals"):
            fit(given, free, intervals="calibrated", **more)


@pytest.mark.ci
def test_contacts_broken_are_those_of_the_front_itself():
    """Not of the length as it would be measured, with a factor and an offset of all lengths."""
    height = np.array([20.0, 40.0, 60.0])
    length = 1.15 * model(height, 0.003) + 1.5
    m = Measurements(height, 0.3, length, 0.3, provenance=("measured",) * 3)
    result = fit(m, fixed={"offset": 1.5, "model_factor": 1.15, "threshold_scatter": 0})
    front = model(height, result.values["stiffness"])
    np.testing.assert_allclose(result.fitted, 1.15 * front + 1.5, rtol=1e-9)
    assert result.contacts_broken.tolist() == np.ceil(front).astype(int).tolist()
    assert (result.contacts_broken < result.fitted - 1).all()


@pytest.mark.parametrize("body", ["slider", "block"])
def test_bounds_of_the_ratio_on_a_table_in_si_are_refused(body):
    """k/K given where Pa/m are meant: the message has the unit, what is expected, and the value that was meant.

    Of a slider 10 to 30 Pa/m too, where at most the first contact breaks, and a prior or a held value in k/K.
    """
    name = {"slider": "pmma_block", "block": "pushed_block"}[body]
    m = read_measurements(Path(__file__).resolve().parents[2] / f"fit_examples/{name}/lengths.csv")
    low, high = (1e9, 1e12)
    for given in (
        {"bounds": (1e-5, 1e-2)},
        {"free": [Parameter("stiffness", bounds=(1e-5, 1e-2))]},
        {"bounds": (10, 30)},
        {"free": [Parameter("stiffness", prior=(1e-3, 1e-4))]},
        {"free": "poisson", "fixed": {"areal_stiffness": 1e-3}},
    ):
        with pytest.raises(ValueError, match=r"in Pa/m: no domino starts at k/K .* expected within \S+ to \S+ Pa/m") as refused:
            fit(m, **given)
        assert ("(k/K = " in str(refused.value)) == ("(10, 30)" not in str(refused.value))
    result = fit(m, bounds=(low, high), intervals="profile")
    assert low < result.values["areal_stiffness"] < high


@pytest.mark.ci
def test_bounds_are_refused_where_no_domino_starts_and_only_there(monkeypatch):
    """Too soft and too stiff; not where a prestress that is fitted lengthens fronts, nor where a single contact was counted."""

    def searched(*_, **__):
        raise AssertionError("searched")

    for name in ("_explore", "between_contacts"):
        monkeypatch.setattr(f"slippulse_jax.inference.fit.{name}", searched)
    m = Measurements([15.0, 25.0], 0.3, [9.0, 25.0], 0.5)
    assert model(m.height, 6e-6).max() == 0
    assert model(m.height, 2e-5).max() > 1
    for bounds in ((1e-9, 1e-7), (1e-7, 6e-6), (300.0, 900.0)):
        with pytest.raises(ValueError, match="no domino starts at k/K from .* expected within"):
            fit(m, bounds=bounds)
    counted = dataclasses.replace(m, length=np.array([1.0, 2.0]), kind=["whole"] * 2)
    for given, free, bounds in (
        (m, "stiffness", (1e-7, 2e-5)),
        (m, ["stiffness", "prestress"], (1e-7, 6e-6)),
        (m, ["stiffness", Parameter("height", bounds=(15.0, 60.0))], (1e-7, 6e-6)),
        (dataclasses.replace(m, height=np.array([15.0, 50.0])), "stiffness", (1e-7, 6e-6)),
        (counted, "stiffness", (1e-7, 6e-6)),
    ):
        with pytest.raises(AssertionError, match="searched"):
            fit(given, free, bounds=bounds)


def test_a_force_without_strength_names_its_column_and_what_to_give(tmp_path):
    path = tmp_path / "force.csv"
    path.write_text(
        "height_mm,correlation_length_um,poisson,young_GPa,length_mm,length_sigma_mm,force_N_per_mm,force_sigma_N_per_mm\n"
        "25,10,0.3,3,14,0.5,40,2\n50,10,0.3,3,34,0.5,60,2\n"
    )
    said = "column force_N_per_mm: what it states scales with σ_s: fit strength too, or hold it at its value in Pa: "
    with pytest.raises(ValueError, match="scales with σ_s") as refused:
        fit(path, ["stiffness", "poisson"])
    free = 'free=["stiffness", "poisson", "strength"]'
    command = "--free stiffness --free poisson --free strength"
    assert str(refused.value) == f"{path}, {said}{command}, in Python {free}"
    with pytest.raises(ValueError, match="scales with σ_s") as refused:
        fit(dataclasses.replace(read_measurements(path), lines=()), [Parameter("areal_stiffness")])
    assert str(refused.value).endswith(': free=["stiffness", "strength"]')


@pytest.mark.parametrize("free", ["stiffness", ["stiffness", "strength"]])
@pytest.mark.parametrize("event", [None, "full"])
def test_the_force_of_a_later_event_is_refused_of_a_slider(free, event):
    """Of the first event it is read, with its number or without."""
    rows = {
        "height_mm": [25, 50], "correlation_length_um": 10, "poisson": 0.3, "young_GPa": 3, "length_mm": [14, 34],
        "length_sigma_mm": 0.5, "force_N_per_mm": [40, 60], "force_sigma_N_per_mm": 2,
    }  # fmt: skip
    later = pd.DataFrame(rows | {"event": [1, 2]})
    with pytest.raises(ValueError, match=r"table, row 1, column event: 2: later events are those of a block"):
        fit(later, free, event=event)
    first = sp.Measurements.from_dataframe(pd.DataFrame(rows | {"event": [1, 1]}))
    assert checked(first, ["stiffness", "strength"], event).names == ["areal_stiffness", "strength"]


@pytest.mark.parametrize(
    ("held", "message"),
    [
        ({"poisson": 3}, r"^poisson = 3 means ν = 3 for some .*: Poisson's ratio ν; give another value$"),
        ({"height": 0.5}, r"^height = 0.5 means H/λc = 0.5 for some .*; give another value$"),
        (
            {"young": 1e8, "areal_stiffness": 1e40},
            r"^young = 1e\+08 and areal_stiffness = 1e\+40 means k/K = 1e\+27 for some .*; give another value$",
        ),
    ],
)
def test_a_held_value_outside_the_domain_is_named(held, message):
    m = Measurements([20.0, 36.0], 0.3, [10.0, 20.0], 1.0)
    free = "stiffness"
    if "young" in held:
        m, free = dataclasses.replace(m, correlation_length=np.full(2, 1e-5), young=np.full(2, 3e8)), "prestress"
    with pytest.raises(ValueError, match=message):
        checked(m, [free, *(Parameter(name, value=value) for name, value in held.items())])
