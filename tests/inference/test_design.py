"""Expected information against closed forms, quadrature of another make, brute force with dice, and counts from dense solves."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from oracles import dense_chain
from scipy.integrate import quad
from scipy.special import ndtr
from scipy.stats import norm

import slippulse_jax as sp
from slippulse_jax.cli.design import command
from slippulse_jax.cli.shared import BAD_INPUT
from slippulse_jax.inference.design import OUTCOMES, Predictions, draw, gain, greedy, log_likelihoods
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import WholeEvent
from slippulse_jax.inference.observables.observable import Observations
from slippulse_jax.inference.search.likelihood import log_densities


def one_datum(length, sigma, kind="length", covariance=None):
    """An experiment of one datum, of which the draws predict these lengths."""
    observable = dict(zip(("length", "whole"), OUTCOMES, strict=True))[kind]
    data = Observations(observable, np.ones((1, 1)), np.array([sigma]), *[None] * 6)  # pyright: ignore[reportArgumentType]
    return [Predictions(data, np.asarray(length)[:, None], covariance)]


def expected_gain(known, length, sigma, kind="length"):
    (found,), _ = greedy(known, [one_datum(length, sigma, kind)], 1, seed=0)
    return found


def normal_prior(sd, nodes=801):
    x = np.linspace(-8, 8, nodes)
    return sp.Knowledge(sd * x, np.exp(-(x**2) / 2))


@pytest.mark.ci
@pytest.mark.parametrize(("sd", "slope", "sigma"), [(0.5, 3.0, 1.0), (0.2, 0.1, 0.5), (1.0, -20.0, 2.0)])
def test_linear_gaussian_limit(sd, slope, sigma):
    """I = ½ ln(1 + s²J²/σ²) and 1/var = 1/s² + J²/σ², for one experiment and for three."""
    prior = normal_prior(sd)
    length = 30 + slope * prior.log_stiffness
    for count in (1, 3):
        truth, noise = draw(prior, count, seed=0)
        log_p = sum(log_likelihoods(one_datum(length, sigma), truth, of_step[:, None]) for of_step in noise.T)
        information, error, log_stderr, _ = gain(prior, truth, log_p)
        expected = 0.5 * np.log1p(count * (sd * slope / sigma) ** 2)
        assert abs(information - expected) < 4 * error + 1e-9
        assert error < (0.004 if count == 1 else 0.03)
        assert log_stderr == pytest.approx((sd**-2 + count * (slope / sigma) ** 2) ** -0.5, rel=1e-2)


@pytest.mark.ci
def test_data_that_err_together():
    """Two of one error common to both, and the same as one of two independent data: I = ½ ln det of the sum of covariances."""
    prior, sd, sigma, common = normal_prior(0.5), 0.5, 0.7, 0.9
    slope = np.array([2.0, -3.0])
    mean, data = (
        prior.log_stiffness[:, None] * slope,
        Observations(OUTCOMES[0], np.ones((1, 2)), np.full(2, sigma), *[None] * 6),
    )  # pyright: ignore[reportArgumentType]
    shared = np.full((len(prior), 2, 2), common**2)
    (found,), _ = greedy(prior, [[Predictions(data, mean, shared)]], 1, seed=0)
    noise = common**2 + sigma**2 * np.eye(2)
    expected = np.log(np.linalg.det(noise + sd**2 * np.outer(slope, slope)) / np.linalg.det(noise)) / 2
    assert abs(found.information - expected) < 4 * found.error
    assert found.error < 0.02
    apart, together = greedy(prior, [[Predictions(data, mean)], [Predictions(data, mean, 0 * shared)]], 1, seed=0)[0]
    assert apart.information == pytest.approx(together.information, rel=1e-9)


@pytest.mark.parametrize("apart", [0.1, 1.0, 3.0, 20.0])
def test_two_values_of_stiffness(apart):
    """Against SciPy's adaptive quadrature: ln 2 less the entropy that is left of which of two it is."""
    prior = sp.Knowledge([0.0, 1.0], root=[0, 1])
    information, error, log_stderr, told_apart = expected_gain(prior, np.array([10.0, 10.0 + apart]), 1.0)

    def integrand(y):
        p = np.exp(-((y - np.array([0, apart])) ** 2) / 2) / np.sqrt(2 * np.pi)
        return sum(0.5 * x * np.log(x / p.mean()) for x in p if x > 0)

    pieces = [(-9, apart / 2), (apart / 2, apart + 9)]
    assert abs(information - sum(quad(integrand, *ends, epsabs=1e-12)[0] for ends in pieces)) < 4 * error + 1e-9
    assert error < 0.01
    if apart == 20:
        assert information == pytest.approx(np.log(2), abs=1e-3)
        assert told_apart == pytest.approx(1)
        assert log_stderr == pytest.approx(0, abs=1e-6)
    # told apart where the odds exceed 19: |y − middle| > ln(19)/apart, from either side
    edge = np.log(19) / apart
    assert told_apart == pytest.approx(ndtr(apart / 2 - edge) + ndtr(-apart / 2 - edge), abs=0.05)


def brute_force(length, weight, sigma, seed, rolls=20000):
    """Information by throwing dice, in loops and without the package."""
    rng = np.random.default_rng(seed)
    gains = []
    for i in rng.choice(len(length), rolls, p=weight):
        y = length[i] + sigma * rng.normal()
        p = np.exp(-(((y - length) / sigma) ** 2) / 2)
        gains.append(np.log(p[i] / np.sum(weight * p)))
    return np.mean(gains), np.std(gains) / np.sqrt(rolls)


@pytest.mark.ci
def test_information_against_brute_force():
    known = sp.Knowledge.lognormal([0.01, 0.06], [0.3, 0.1], share=[1, 2], nodes=300)
    found = sp.design(known, height=[10, 25, 50], sigma=[0.2, 0.5, 0.5])
    for j in range(3):
        mean, error = brute_force(found.length[:, j], known.weight, found.candidates[j].sigma, seed=j)
        assert abs(found.information[j] - mean) < 4 * error
        assert found.information_error[j] < 0.02


@pytest.mark.ci
def test_counts_against_dense_solves():
    """Without error a count tells the entropy of its own distribution; the counts here are those of the dense program."""
    theta = np.linspace(np.log(0.003), np.log(0.2), 41)
    known = sp.Knowledge(theta)
    found = sp.design(known, height=[8, 14], sigma=0.0, kind="whole")
    for j, height in enumerate([8, 14]):
        counts = [dense_chain.front(height, q, 0.3, np.ones(60), np.zeros(60), 0, 60)[0] for q in np.exp(theta)]
        share = np.unique(counts, return_counts=True)[1] / 41
        assert abs(found.information[j] + share @ np.log(share)) < 4 * found.information_error[j]
        assert found.information_error[j] < 0.05
    blurred = sp.design(known, height=[8, 14], sigma=0.3, kind="whole")
    assert (blurred.information < found.information).all()


def test_probability_of_a_count():
    """Against SciPy's normal distribution; without error the count is the whole contacts of the length, 1 where no domino starts."""
    length = np.array([0.0, 0.6, 3.2, 17.4, 40.7])
    y, counts = np.array([1.0, 2, 3, 4, 17, 18, 41]), OUTCOMES[1]
    for sigma in (0.3, 2.0):
        lower = np.where(y > 1, y - 1, -np.inf)[:, None]
        expected = norm.cdf(y[:, None], length, sigma) - norm.cdf(lower, length, sigma)
        np.testing.assert_allclose(np.exp(log_densities(counts, length, y[:, None], sigma)), expected, rtol=1e-9, atol=1e-14)
    certain = np.exp(log_densities(counts, length, y[:, None], 0.0))
    np.testing.assert_array_equal(certain, y[:, None] == np.maximum(np.ceil(length), 1))


def test_nothing_is_learnt_at_the_peak_nor_on_the_plateau():
    """At H/λc = 25 ℓ(k/K) is flat at 0.0454; Λ/H of a tall block on a stiff interface has all but its largest value."""
    flat = sp.design(sp.Knowledge.lognormal(0.0454, 0.05), height=25, sigma=0.5)
    assert flat.information[0] < 1e-3
    soft, stiff = (sp.design(sp.Knowledge.lognormal(k, 0.3), height=75000, sigma=750) for k in (1e-5, 3e-4))
    assert stiff.information[0] < 0.01 < 1 < soft.information[0]
    assert "no candidate adds much information" in flat.report()


@pytest.mark.ci
def test_roots_of_one_length_are_told_apart_elsewhere():
    """25.9 ± 0.1 at H/λc = 25 has two roots; a taller block parts them."""
    one = sp.Measurements(height=25.0, poisson=0.3, length=25.9, length_sigma=0.1)
    known = sp.Knowledge.from_measurements(one)
    assert len(known.roots) == 2
    for share, stiffness, _ in known.roots:
        assert 0.3 < share < 0.7
        assert abs(sp.exact_lengths(sp.Slider(25.0, [stiffness], 0.3))[0] - 25.9) < 0.05
    found = sp.design(known, height=[5, 25, 50, 100], sigma=0.5, experiments=2)
    assert found.best == 3
    assert found.information[1] < 0.05
    assert found.told_apart[1] < 0.01 < 0.9 < found.told_apart[3]
    one, two = found.sequence
    assert one.candidate == 3
    assert two.information > one.information
    assert two.log_stderr < one.log_stderr


ONE = sp.Measurements(height=25.0, poisson=0.3, length=24.5, length_sigma=0.1)
"""Has two roots; at the stiffer one the edge contact breaks again before the front stops."""


@pytest.mark.parametrize("of", ["measurements", pytest.param("fit", marks=pytest.mark.ci)])
def test_the_root_at_which_the_edge_breaks_again_is_called_so(of):
    """With bounds to paste that keep the other; in the report, in JSON and in the picture."""
    known = sp.Knowledge.from_measurements(ONE) if of == "measurements" else sp.Knowledge.from_fit(sp.fit(ONE))
    assert known.rebreaks.tolist() == [False, True]
    found = sp.design(known, height=[10, 100], sigma=0.5)
    lines = found.report().splitlines()
    assert re.search(r"0\.0186.*0\.114.*; edge breaks again\)$", lines[0])
    assert re.search(r"if k/K = 0\.114 \(edge breaks again\)", found.report())
    assert f"  Note: {known.notes[0]}" in lines
    assert [root["rebreaks"] for root in found.to_dict()["knowledge"]["roots"]] == [False, True]
    names = [text.get_text() for text in sp.plot.design_lengths(found).get_legend().get_texts()]
    assert {"known so far", "known so far, edge breaks again", "edge breaks again"} <= {*names}
    bounds = tuple(map(float, re.search(r"--bounds (\S+) (\S+) ", str(known)).groups()))
    for prior in (None, sp.Knowledge(known.log_stiffness, known.weight)):
        kept = sp.Knowledge.from_measurements(ONE, bounds=bounds, prior=prior)
        assert kept.log_stiffness.max() < np.log(0.03)
        assert not kept.rebreaks.any()
        assert str(kept) == kept.statement
        assert "again" not in str(kept)


def test_where_every_root_breaks_again_whole_events_are_advised():
    stiff = sp.Knowledge.from_measurements(ONE, bounds=(0.05, 1.0))
    assert stiff.rebreaks.tolist() == [True]
    assert "--event full" in str(stiff)
    assert "--bounds" not in str(stiff)
    assert "\n" not in str(sp.Knowledge.lognormal([0.01, 0.06], 0.2))


def test_information_is_that_of_the_slope_where_little_is_unknown():
    """ℓ is straight over a narrow prior: the D-optimal gain ½ ln(1 + s²J²/σ²)."""
    known = sp.Knowledge.lognormal(0.01, 0.02)
    found = sp.design(known, height=[25, 50], sigma=0.3)
    for j, height in enumerate([25.0, 50.0]):
        h = 1e-5
        up, down = sp.exact_lengths(sp.Slider(height, 0.01 * np.exp([h, -h]), 0.3))
        slope = (up - down) / (2 * h)
        assert found.information[j] == pytest.approx(0.5 * np.log1p((0.02 * slope / 0.3) ** 2), rel=5e-3)


@pytest.mark.ci
def test_a_front_that_never_stops_is_an_outcome():
    prior = normal_prior(1.0, 101)
    length = np.where(prior.log_stiffness > 0.5, np.inf, 30 + 5 * prior.log_stiffness)
    never = prior.weight @ np.isinf(length)
    information, error, *_ = expected_gain(prior, length, 1e4)
    # with an error that swamps every length, what is left is whether it stops
    expected = -never * np.log(never) - (1 - never) * np.log1p(-never)
    assert abs(information - expected) < 4 * error + 1e-4
    assert error < 0.01


def test_units():
    """In SI the same plan as in λc."""
    plain = sp.design(sp.Knowledge.lognormal(0.02, 0.5), height=[10, 25], sigma=0.5)
    young, fine = 3e9, 2e-3
    si = sp.Knowledge.lognormal(0.02 * young / fine, 0.5, in_si=True)
    found = sp.design(si, height=[10 * fine, 25 * fine], sigma=0.5 * fine, correlation_length=fine, young=young)
    np.testing.assert_allclose(found.information, plain.information, rtol=1e-6)
    assert "H = 50 mm" in found.report()


def test_too_few_samples_are_noticed():
    chain = np.random.default_rng(0).normal(np.log(0.02), 0.5, 30)
    found = sp.design(sp.Knowledge(chain), height=100, sigma=0.001)
    assert found.information_error[0] > 0.2
    assert "too few" in found.report()


def test_earlier_measurements_sharpen_a_prior():
    prior = sp.Knowledge.lognormal(0.01, 1.0)
    m = sp.Measurements(height=[10.0, 25.0], poisson=0.3, length=[7.0, 20.0], length_sigma=[0.3, 0.5])
    known = sp.Knowledge.from_measurements(m, prior=prior)
    assert known.log_sd < 0.2 < prior.log_sd
    fitted = sp.fit(m)
    assert abs(known.mean - np.log(fitted.values["stiffness"])) < 0.5 * known.log_sd


@pytest.mark.ci
def test_knowledge_of_measurements_against_quadrature():
    """Lengths, a count with a blur and a front that ran past a length: SciPy's densities, on a grid of its own."""
    m = sp.Measurements(
        height=[10.0, 25.0, 30.0], poisson=0.3, length=[7.0, 20.0, 15.0], length_sigma=[0.3, 0.5, 2.0],
        kind=("length", "whole", "at_least"),
    )  # fmt: skip
    theta = np.linspace(-8, 0, 40001)
    a, b, c = (sp.precursor_lengths(sp.Slider(h, np.exp(theta), 0.3)) for h in m.height)
    w = norm.pdf(a, 7, 0.3) * (ndtr((20 - b) / 0.5) - ndtr((19 - b) / 0.5)) * ndtr((c - 15) / 2)
    w /= w.sum()
    mean, sd = w @ theta, np.sqrt(w @ (theta - w @ theta) ** 2)
    known = sp.Knowledge.from_measurements(m)
    assert known.mean == pytest.approx(mean, rel=1e-7)
    assert known.log_sd == pytest.approx(sd, rel=1e-6)
    prior = sp.Knowledge(theta[theta > -6])
    assert sp.Knowledge.from_measurements(m, prior=prior).log_sd == pytest.approx(sd, rel=1e-6)


def test_a_sample_without_weight_teaches_nothing():
    known, alone = sp.Knowledge(np.log([0.01, 0.02, 0.03]), [0.0, 1.0, 0.0]), sp.Knowledge(np.log([0.02]))
    for one in (known, alone):
        found = sp.design(one, height=25.0, sigma=0.5)
        assert found.information[0] == pytest.approx(0, abs=1e-9)
        assert np.isfinite(found.information_error[0])


@pytest.mark.ci
def test_a_fit_is_the_knowledge_of_its_measurements():
    """To what the interpolated profile of a fit gives away."""
    one = sp.Measurements(height=25.0, poisson=0.3, length=25.0, length_sigma=0.3)
    fitted, direct = sp.Knowledge.from_fit(sp.fit(one)), sp.Knowledge.from_measurements(one)
    for found, expected in zip(fitted.roots, direct.roots, strict=True):
        np.testing.assert_allclose(found, expected, rtol=2e-3)
    each = sp.Measurements(height=[10, 25], poisson=0.3, length=[7, 20], length_sigma=0.3, specimen=("A", "B"))
    with pytest.raises(ValueError, match="2 stiffnesses"):
        sp.Knowledge.from_fit(sp.fit(each, [sp.Parameter("stiffness", each="specimen")]))


def test_designs_take_lengths_as_the_fit_did():
    """Of whole events where contacts break again; no design predicts cracks or smooth fronts."""
    height, stiffness = np.array([20.0, 40.0]), 0.1
    length = sp.precursor_lengths(sp.Slider(height, stiffness, 0.3), event="full")
    m = sp.Measurements(height, 0.3, length, 0.02 * length)
    whole = sp.Knowledge.from_fit(sp.fit(m, event="full", intervals="profile"))
    found = sp.design(whole, height=40.0, sigma=1.0)
    expected = WholeEvent().lengths(Inputs.of(40.0, np.exp(whole.log_stiffness), 0.3))
    np.testing.assert_allclose(found.length[:, 0], expected, rtol=1e-14)  # by ln k, where this is by k
    assert (expected > sp.exact_lengths(sp.Slider(40.0, np.exp(whole.log_stiffness), 0.3)) + 0.2).mean() > 0.5
    assert "those of whole events" in found.report()
    assert found.to_dict()["knowledge"]["event"] == "full"
    again = sp.Knowledge.from_measurements(m, prior=whole)
    assert (
        again.event == sp.Knowledge.from_measurements(m, prior=sp.Knowledge(np.log([0.05, 0.1])), event="full").event == "full"
    )
    assert not whole.rebreaks.any()
    assert again.log_sd < whole.log_sd
    crack = sp.fit(m, fixed={"friction": 0.3}, event="crack", intervals="profile")
    with pytest.raises(ValueError, match="the fit is of crack-like fronts: designs predict"):
        sp.Knowledge.from_fit(crack)
    with pytest.raises(ValueError, match="event = 'crack'"):
        sp.Knowledge([0.0], event="crack")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sigma": 0.0}, "sigma = 0"),
        ({"height": [25, 0.5]}, "height over correlation length = 0.5 at index 1"),
        ({"height": [25, 50], "poisson": [0.3, 0.7]}, "candidates, row 1, column poisson: 0.7: must lie in"),
        ({"prestress": 1.0}, "candidates, row 0, column prestress: 1: must lie in"),
        ({"kind": "force"}, "kind = 'force'"),
        ({"young": 3e9}, "give both, or neither"),
        ({"correlation_length": 1e-5, "young": 3e9, "height": 0.01, "sigma": 1e-3}, "the knowledge is about k/K"),
        ({"height": [1, 2, 3], "prestress": [0, 0.1]}, "must broadcast"),
        ({"experiments": 0}, "experiments = 0"),
    ],
)
def test_errors_name_the_argument(wrong, message):
    with pytest.raises(ValueError, match=message):
        sp.design(sp.Knowledge.lognormal(0.02, 0.5), **{"height": 25.0, "sigma": 0.5, **wrong})
    with pytest.raises(ValueError, match="log_sd = -1"):
        sp.Knowledge.lognormal(0.02, -1.0)
    with pytest.raises(ValueError, match="Knowledge.weight"):
        sp.Knowledge([0.0, 1.0], [1.0, -1.0])


def test_command(tmp_path):
    table = tmp_path / "lengths.csv"
    table.write_text("height,poisson,length,length_sigma\n25,0.3,25.9,0.1\n", encoding="utf-8")
    picture = tmp_path / "design.png"
    asked = ["--height", "10:50:2", "--sigma", "0.5", "--poisson", "0.3", "--next", "2", "--json", "--figure", str(picture)]
    done = CliRunner().invoke(command, ["--measured", str(table), *asked])
    assert done.exit_code == 0, done.stderr
    content = json.loads(done.stdout)
    assert [c["rank"] for c in content["candidates"]] == [2, 1]
    assert len(content["knowledge"]["roots"]) == 2
    assert len(content["sequence"]) == 2
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert done.stderr.strip() == f"figure written to {picture}"
    done = CliRunner().invoke(command, ["--measured", str(table), *asked[:-2], "--bounds", "1e-3", "0.045"])
    assert len(json.loads(done.stdout)["knowledge"]["roots"]) == 1


@pytest.mark.ci
def test_command_of_whole_events():
    asked = ["--height", "10", "--sigma", "0.5", "--poisson", "0.3", "--stiffness", "0.1", "--log-sd", "0.1", "--event", "full"]
    done = CliRunner().invoke(command, [*asked, "--json"])
    assert json.loads(done.stdout)["knowledge"]["event"] == "full"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--height", "10", "--sigma", "0.5", "--poisson", "0.3"], "missing --stiffness"),
        (["--height", "10,x", "--sigma", "0.5", "--poisson", "0.3"], "'10,x' is not a number, a list a,b,c or a range"),
        (["--height", "10", "--poisson", "0.3", "--stiffness", "0.02", "--log-sd", "1"], "missing --sigma"),
        (["--height", "0.5", "--sigma", "0.5", "--poisson", "0.3", "--stiffness", "0.02", "--log-sd", "1"], "must exceed 1"),
        (["--height", "9", "--sigma", "0.5", "--poisson", "0.3", "--measured", "nowhere.csv"], "nowhere.csv"),
        (
            ["--height", "9", "--sigma", "1", "--poisson", "0.3", "--stiffness", "1", "--log-sd", "1", "--bounds", "1", "2"],
            "--bounds is the range of the stiffness that --measured",
        ),
    ],
)
def test_bad_usage_is_one_line_and_exit_status_2(arguments, message):
    done = CliRunner().invoke(command, arguments)
    assert done.exit_code == BAD_INPUT
    assert message in done.output
    assert "Traceback" not in done.output


def test_pictures():
    from matplotlib.figure import Figure

    found = sp.design(sp.Knowledge.lognormal([0.01, 0.06], 0.2), height=[10, 25], sigma=0.5)
    left, right = Figure().subplots(1, 2)
    assert sp.plot.design(found, ax=left) is left
    assert sp.plot.design_lengths(found, ax=right) is right
    assert "bits" in left.get_xlabel()


@pytest.mark.slow
def test_at_what_height_to_push_a_block():
    """Information where ℓ is linear in ln k, from cascades of their own; and the report, the picture and the command."""
    height, middle, sd, sigma = 400.0, 8e-4, 0.05, 6.0
    known = sp.Knowledge.lognormal(middle, sd)
    at = np.array([0.15, 0.3, 0.5])
    plan = sp.design(known, height=height, sigma=sigma, push_height=at)
    for i, h in enumerate(at):
        block = [sp.Block(height, middle * np.exp(x), 0.3, sp.Push(h)) for x in (-0.1, 0.1)]
        low, high = (float(sp.precursor_length(one, event="full")) for one in block)
        assert plan.expected_length[i, 0] == pytest.approx((low + high) / 2, rel=0.01)
        assert plan.information[i] == pytest.approx(0.5 * np.log1p((sd * (high - low) / 0.2 / sigma) ** 2), rel=0.12)
    assert plan.best == 2

    assert "pushed over everything above at the height h, displacement held" in plan.report()
    assert sp.plot.design_figure(plan).axes
    given = ["--height", "400", "--sigma", "6", "--poisson", "0.3", "--stiffness", "8e-4", "--log-sd", "0.05"]
    said = json.loads(CliRunner().invoke(command, [*given, "--push-height", "0.15,0.3,0.5", "--json"]).stdout)
    np.testing.assert_allclose([c["information"] for c in said["candidates"]], plan.information, rtol=1e-12)


@pytest.mark.slow
def test_a_push_is_over_the_height_of_its_block_or_in_mm():
    """One h/H for blocks of several heights scales with each; mm stay mm. As for a block, and for `sweep`."""
    known = sp.Knowledge.lognormal(9e10, 0.2, in_si=True)
    material = {"sigma": 0.2e-3, "correlation_length": 50 * 1e-6, "young": 3e9}  # as the command converts
    plan = sp.design(known, height=[10e-3, 20e-3], push_height=0.25, push_width=0.1, **material)
    for candidate, mean in zip(plan.candidates, plan.expected_length[:, 0], strict=True):
        block = sp.Block.from_material(
            height=candidate.height, correlation_length=50e-6, areal_stiffness=9e10, poisson=0.3, young=3e9,
            push_height=0.25 * candidate.height, push_width=0.1 * candidate.height,
        )  # fmt: skip
        assert mean == pytest.approx(float(sp.precursor_length(block, event="full")), rel=0.03)

    given = ["--sigma-mm", "0.2", "--correlation-length-um", "50", "--young-gpa", "3", "--poisson", "0.3", "--json"]
    given += ["--stiffness", "9e10", "--log-sd", "0.2", "--height-mm"]

    def command_plans(*arguments):
        done = CliRunner().invoke(command, [*given, *arguments])
        assert done.exit_code == 0, done.output
        return json.loads(done.stdout)

    said = command_plans("10,20", "--push-height-mm", "2.5,5", "--push-width-mm", "1,2")
    np.testing.assert_allclose([c["length"] for c in said["candidates"]], plan.expected_length[:, 0], rtol=1e-9)
    np.testing.assert_allclose([c["push_height"] for c in said["candidates"]], 0.25)
    assert said["units"]["push"] == "H"
    assert [c["label"] for c in command_plans("10", "--push-height-mm", "2.5,5")["candidates"]] == ["h = 2.5 mm", "h = 5 mm"]
    same = command_plans("10,20", "--push-height-mm", "2.5")["candidates"]
    assert [c["push_height"] for c in same] == pytest.approx([0.25, 0.125])
    for heights, pushes, message in [
        ("10,20", "1,2,3", "--push-height-mm: 3 values for 2 of --height-mm"),
        ("0", "1", "height over correlation length = 0 at index 0"),
        ("10", "12", r"push_height = 1.2 at index 0: must lie in \(0, 1\), as it is over the height"),
    ]:
        done = CliRunner().invoke(command, [*given, heights, "--push-height-mm", pushes])
        assert done.exit_code == BAD_INPUT
        assert re.search(message, done.output)


@pytest.mark.ci
def test_earlier_measurements_of_a_block_are_knowledge_of_it():
    block = sp.Block(400.0, 8e-4, 0.3, sp.Push(0.25))
    length = float(sp.precursor_length(block, event="full"))
    m = sp.Measurements(height=400, poisson=0.3, length=length, length_sigma=0.02 * length, push_height=100)
    known = sp.Knowledge.from_measurements(m, bounds=(1e-4, 1e-2))
    assert (known.body, known.event) == ("block", "full")
    assert np.exp(known.mean) == pytest.approx(8e-4, rel=0.03)
    both = sp.Knowledge.from_measurements(m)  # stiff contacts give as short an event
    assert np.unique(both.root).size == 2
    stiff = np.exp(np.average(both.log_stiffness, weights=both.weight * (both.root == 1)))
    again = sp.precursor_length(sp.Block(400.0, stiff, 0.3, sp.Push(0.25)), event="full")
    assert float(again) == pytest.approx(length, rel=0.05)  # the fit adds 3.5 % for the contacts that it follows
    with pytest.raises(ValueError, match="candidates are sliders"):
        sp.design(known, height=400, sigma=2.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"push_height": [0.2, 5.0]},
            r"push_height = 5 at index 1: must lie in \(0, 1\), as it is over the height of the block, h/H",
        ),
        (
            {"push_height": 0.2, "push_width": 3.0},
            r"push_width = 3 at index 0: must lie in \(0, 1\), .* over the height .*, w/H",
        ),
        ({"push_height": 0.02}, "height of the push over correlation length = 0.5 at index 0: must exceed 1"),
        ({"push_height": 0.2, "push_width": 0.48}, "column push_width: 12 λc: reaches beyond the side of the block"),
        ({"push_width": 0.3}, "candidates: push_width is given without push_height"),
        ({"push_control": "force"}, "push_control is given without push_height"),
        ({"push_height": 0.2, "push_control": "speed"}, "column push_control: 'speed': one of displacement, force"),
        ({"push_height": 0.2, "threshold_slope": 1e-3}, "thresholds under a block are level"),
    ],
)
def test_pushes_that_cannot_be(wrong, message):
    with pytest.raises(ValueError, match=message):
        sp.design(sp.Knowledge.lognormal(0.02, 0.3), height=25.0, sigma=0.5, **wrong)


# --- tables -----------------------------------------------------------------------------------------------------------------


def with_forces(sigma=5.0):
    """Lengths and forces of two blocks, as `read_measurements` gives them."""
    return pd.DataFrame({
        "height_mm": [10, 30], "correlation_length_um": 500, "poisson": 0.3, "young_GPa": 3, "length_mm": [8.2, 22.0],
        "length_sigma_mm": [0.2, 0.4], "force_N_per_mm": [40, 60], "force_sigma_N_per_mm": sigma,
    })  # fmt: skip


def test_a_table_of_lengths_is_worth_what_its_rows_are():
    """As the keywords say, if it has one row; of two, more than either and less than both."""
    known = sp.Knowledge.lognormal(2e10, 0.3, in_si=True)
    table = with_forces().drop(columns=["force_N_per_mm", "force_sigma_N_per_mm"])
    plan = sp.design(known, {"one": table.head(1), "other": table.tail(1), "both": table})
    rows = sp.design(
        known, height=[0.01, 0.03], sigma=[2e-4, 4e-4], correlation_length=5e-4, young=3e9
    )  # fmt: skip
    np.testing.assert_allclose(plan.information[:2], rows.information, rtol=0.02)
    assert plan.information[:2].max() < plan.information[2] < plan.information[:2].sum()
    assert plan.candidates.measured.tolist() == ["1 length", "1 length", "2 lengths"]
    assert np.isnan(plan.length).all()
    assert "2 lengths" in plan.report()
    assert "2 lengths" in plan._repr_html_()
    said = json.loads(json.dumps(plan.to_dict()))
    assert [one["name"] for one in said["candidates"]] == ["one", "other", "both"]
    assert said["candidates"][0]["length"] is None
    assert len(sp.plot.design_figure(plan).axes) == 1
    with pytest.raises(ValueError, match=r"tables, not lengths: use plot\.design"):
        sp.plot.design_lengths(plan)


@pytest.mark.ci
def test_forces_tell_what_their_errors_allow():
    """With the strength left open as the fit left it, smaller errors of the forces tell more, of the stiffness too."""
    fitted = sp.fit(with_forces(), ["stiffness", "strength"])
    known = sp.Knowledge.from_fit(fitted)
    assert known.more.keys() == {"strength"}
    (mean,), (error,) = (np.atleast_1d(x) for x in (fitted.theta[1], np.sqrt(fitted.covariance[1, 1])))
    strength = known.more["strength"]
    middle = known.weight @ strength
    assert middle == pytest.approx(mean, abs=0.3 * error)
    assert np.sqrt(known.weight @ (strength - middle) ** 2) == pytest.approx(error, rel=0.3)
    plan = sp.design(known, {str(sigma): with_forces(sigma) for sigma in (500.0, 5.0, 0.05)})
    lengths = sp.design(known, {"lengths": with_forces().drop(columns=["force_N_per_mm", "force_sigma_N_per_mm"])})
    assert plan.information[0] == pytest.approx(lengths.information[0], rel=0.02)
    assert (np.diff(plan.information) > 0.3).all()
    assert (np.diff(plan.log_stderr) < 0).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"candidates": {"a": with_forces()}, "height": 0.03}, "height beside candidates: their tables state it"),
        ({}, "give candidates, or height and sigma"),
        ({"candidates": {}}, "at least one is needed"),
        ({"candidates": {"a": with_forces()}, "poisson": [0.3, 0.4]}, "poisson beside candidates"),
        ({"candidates": {"a": with_forces()}}, "scales with σ_s: fit strength too"),
        (
            {
                "candidates": {
                    "far": with_forces().drop(columns=["force_N_per_mm", "force_sigma_N_per_mm"]).assign(kind="at_least")
                }
            },
            "a lower limit is no plan",
        ),
        (
            {"candidates": {"plain": pd.DataFrame({"height": [25.0], "length": 20.0, "length_sigma": 0.5, "poisson": 0.3})}},
            "in Pa/m",
        ),
    ],
)
def test_tables_that_are_no_plan(given, message):
    with pytest.raises(ValueError, match=message):
        sp.design(sp.Knowledge.lognormal(2e10, 0.3, in_si=True), **given)


def test_tables_of_one_name_are_told_apart_and_nothing_given_is_ignored(tmp_path):
    """By their paths; a prior beside forces of a sequence would have been left out."""
    paths = [tmp_path / folder / "plan.csv" for folder in ("one", "two")]
    for path, sigma in zip(paths, (0.2, 0.4), strict=True):
        path.parent.mkdir()
        lengths = with_forces().drop(columns=["force_N_per_mm", "force_sigma_N_per_mm"]).assign(length_sigma_mm=sigma)
        lengths.to_csv(path, index=False)
    known = ["--stiffness", "2e10", "--log-sd", "0.3"]
    done = CliRunner().invoke(command, [*known, *(x for path in paths for x in ("--table", str(path))), "--json"])
    assert done.exit_code == 0, done.output
    assert [one["label"] for one in json.loads(done.stdout)["candidates"]] == list(map(str, paths))
    twice = CliRunner().invoke(command, [*known, "--table", str(paths[0]), "--table", str(paths[0])])
    assert (twice.exit_code, "the same table twice" in twice.output) == (BAD_INPUT, True)
    sequence = "fit_examples/sequence/lengths.csv"
    both = CliRunner().invoke(command, [*known, "--measured", sequence, "--table", str(paths[0])])
    assert (both.exit_code, "beside --stiffness" in both.output) == (BAD_INPUT, True)
