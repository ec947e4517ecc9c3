"""Fits whose model is the whole event, where contacts break again before the front stops."""

import dataclasses
import json
import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from reports import unfolded
from slopes import slopes_of

import slippulse_jax as sp
from slippulse_jax import plot
from slippulse_jax.base.status import NotConverged
from slippulse_jax.cli.fit import command
from slippulse_jax.inference.model import slider
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.models import front_for
from slippulse_jax.inference.model.slider import FirstFront, WholeEvent
from slippulse_jax.inference.result.record import as_request, from_request
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.plot.labels import AGAIN

HEIGHT = np.array([15.0, 20.0, 30.0, 40.0, 50.0, 60.0])


def study(b, error=0.01):
    """Lengths of whole events without scatter; b of the geometric mean of the heights."""
    stiffness = b / (2.6 * np.exp(np.log(HEIGHT).mean()))
    length = sp.precursor_lengths(sp.Slider(HEIGHT, stiffness, 0.3), event="full")
    return stiffness, sp.Measurements(height=HEIGHT, poisson=0.3, length=length, length_sigma=error * length)


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


@pytest.mark.ci
@pytest.mark.parametrize("b", [6.5, pytest.param(20.0, marks=pytest.mark.slow)])
def test_fits_of_whole_events_recover_the_stiffness(b):
    """Taken as fronts they give three quarters of it and less, and say so."""
    stiffness, m = study(b)
    whole, front = sp.fit(m, event="full"), sp.fit(m)
    assert whole.identifiability is Identifiability.IDENTIFIED
    assert whole.values["stiffness"] == pytest.approx(stiffness, rel=0.03)
    assert abs(whole.values["stiffness"] - stiffness) < whole.stderrs["stiffness"]
    assert front.identifiability is Identifiability.REBREAKS
    assert "\n  H larger by 1 % " in front.report(), "a value that the event may change is still one that inputs move"
    assert front.values["stiffness"] < 0.75 * stiffness
    assert front.values["stiffness"] < whole.intervals["stiffness"][0.95][0].low
    assert "length of the whole event" in whole.report(verbose=True)
    assert "of the first front alone" in front.report()
    assert "of the first front alone" not in whole.report()
    assert "uniform thresholds, whole events, the edge held still during the event, and " in unfolded(whole.report())
    assert re.search(r"\n  thresholds that scatter from contact to contact .* not computed\n", whole.report())
    for draw in (plot.fit_lengths, plot.length_versus_stiffness, partial(plot.fits.profile, name="stiffness")):
        assert AGAIN in legend(draw(front, ax=Figure().subplots()))
        assert AGAIN not in legend(draw(whole, ax=Figure().subplots()))


TALL = {
    "lengths": (
        {"correlation_length": 2.214167e-5, "young": 4.763938e8, "poisson": 0.0432006},
        [0.8075216, 28.754933, 34.339347, 1.9072965, 39.303689, 1.6771375],
        [0.0836515, 8.6940819, 10.9931085, 0.2878647, 13.191039, 0.2381639],
        [0.0014864, 0.0397841, 0.0504464, 0.0023742, 0.0605845, 0.0021792],
        ["length"] * 6,
    ),
    "counts": (
        {"correlation_length": 3.3290603788386396e-5, "young": 5.0332320e8, "poisson": 0.0035642},
        [14.510297, 53.81726, 3.7420065, 65.887145, 3.6074325, 15.528198, 18.019265, 1.8447254, 16.998531],
        [2.4315372, 16.4925488, 0.5659402643, 21.3392770284, 0.5326496606, 3.1049631, 3.8178347, 0.2156857, 3.5620946054],
        [0.0, 0.2655198, 0.0, 0.0, 0.0, 0.0533706, 0.0639366, 0.0052124, 0.0],
        ["at_least", "length", "whole", "whole", "whole", "length", "length", "length", "whole"],
    ),
}
"""Heights, lengths and errors in mm, H/λc up to 2000, b at most 2.5; and how each was measured."""


@pytest.mark.ci
@pytest.mark.parametrize("which", TALL)
def test_whole_events_of_several_tall_sliders(which):
    """The range went on to b = 5000 of the tallest, where events take seconds each, and one was given up."""
    material, height, length, sigma, kind = TALL[which]
    size = material["correlation_length"] * 1e3
    length = [round(x / size) * size if how == "whole" else x for x, how in zip(length, kind, strict=True)]
    columns = {"height": height, "length": length, "length_sigma": sigma}
    m = sp.Measurements.from_si(**{name: 1e-3 * np.array(x) for name, x in columns.items()}, kind=kind, **material)
    whole, front = sp.fit(m, event="full", intervals="profile"), sp.fit(m, intervals="profile")
    assert whole.identifiability in (Identifiability.IDENTIFIED, Identifiability.SKEWED)
    assert whole.regime.b.max() < 3.09
    assert whole.values["areal_stiffness"] == pytest.approx(front.values["areal_stiffness"], rel=1e-6), "nothing breaks again"
    f = sp.objective(m, event="full")
    assert float(f(f.start())) == pytest.approx(whole.deviance / 2, abs=0.01)


def test_a_point_without_a_value_does_not_end_a_fit(monkeypatch):
    """Events that are given up at some stiffnesses; and at all, which is an error."""
    for most, rejected in ((20.0, False), (0.0, True)):
        monkeypatch.setattr(
            slider,
            "_over_front",
            lambda place, most=most: np.where(np.exp(place[:, 1:2]) < most, 1.0, np.nan) + 0 * place[:, :1],
        )
        m = dataclasses.replace(study(1.0)[1], prestress=0.01 * np.ones(6))
        if rejected:
            with pytest.raises(NotConverged, match="no event of the range searched that could be followed"):
                sp.fit(m, event="full", intervals="profile")
            continue
        result = sp.fit(m, event="full", intervals="profile")
        assert np.isfinite(result.values["stiffness"])
        assert np.isnan(result.curves["stiffness"].deviance).sum() == 0
        assert np.isfinite(result.attainable).all()
        assert np.isfinite(result.fitted).all()


@pytest.mark.ci
def test_lengths_unlike_all_that_were_measured_come_from_lower_sliders():
    """To 1 % where b is up to 40; those like them are as exact as the model."""
    height, b = np.array([3000.0, 3000.0, 3000.0]), np.array([1.0, 4.0, 40.0])
    inputs = Inputs.of(height, b / (2.6 * height), 0.3)
    exact = WholeEvent().lengths(inputs)
    for target in (1, 2):
        m = sp.Measurements(height[:1], 0.3, exact[target : target + 1], 1.0)
        found = WholeEvent(m).lengths(inputs)
        assert found[target] == exact[target]
        np.testing.assert_allclose(found, exact, rtol=0.01)
    few = inputs.take(np.array([0, 1]))
    rough = sp.Measurements(height[:1], 0.3, exact[1:2], exact[1] / 4)  # within its errors b = 1 is like it
    assert exact[0] < exact[1] / slider.UNLIKE
    np.testing.assert_array_equal(WholeEvent(rough).lengths(few), exact[:2])


@pytest.mark.ci
@pytest.mark.parametrize(("prestress", "b"), [(0.4, 30.0), (0.45, 20.0)])
def test_events_that_a_prestress_carries_far_beyond_their_front_are_looked_at(prestress, b):
    """By more than the factor within which lengths are like those measured: the event is compared, not its front."""
    height = np.array([1600.0])
    inputs = Inputs.of(height, b / (2.6 * height), 0.3, prestress=prestress)
    exact = WholeEvent().lengths(inputs)
    assert exact > slider.UNLIKE * FirstFront().lengths(inputs)
    m = sp.Measurements(height, 0.3, exact, 1.0, prestress=prestress)
    assert WholeEvent(m).lengths(inputs) == exact


@pytest.mark.ci
def test_the_model_of_a_fit_against_the_cascade():
    """Within a thousandth up to b = 10, a few per cent at most beyond; and the front itself below the onset."""
    rng = np.random.default_rng(8)
    b = np.exp(rng.uniform(0, np.log(50), 60))
    height, poisson = np.exp(rng.uniform(np.log(15), np.log(60), 60)), rng.uniform(0.2, 0.4, 60)
    stiffness = b / (2 * (1 + poisson) * height)
    inputs = Inputs.of(height, stiffness, poisson)
    found = front_for("slider", "full").lengths(inputs)
    off = found / sp.precursor_lengths(sp.Slider(height, stiffness, poisson), event="full") - 1
    assert np.sqrt(np.mean(off[b < 10] ** 2)) < 2e-3
    assert np.sqrt(np.mean(off[b > 10] ** 2)) < 0.01
    assert np.abs(off).max() < 0.03
    early = inputs.take(b < 2.4)
    np.testing.assert_allclose(found[b < 2.4], front_for("slider", "domino").lengths(early), rtol=1e-12)
    slopes = [slopes_of(front_for("slider", event), early, ["log_stiffness"])["log_stiffness"] for event in ("full", "domino")]
    np.testing.assert_allclose(*slopes, rtol=1e-4)  # of the table by differences


@pytest.mark.ci
def test_the_model_of_a_fit_is_continuous_and_takes_a_prestress():
    b = np.geomspace(2.5, 60, 2001)
    lanes = np.stack([0 * b + 40, b / (2.6 * 40), 0 * b + 0.3, 0 * b, 0 * b])
    assert np.abs(np.diff(WholeEvent().over_front(lanes))).max() < 2e-3
    lane = np.array([[40.0], [0.2], [0.3], [0.13], [0.0]])
    slider, interface = sp.Slider(40.0, 0.2, 0.3), sp.Interface(prestress=0.13)
    whole, front = (sp.precursor_lengths(slider, interface, event=event) for event in ("full", "domino"))
    np.testing.assert_allclose(WholeEvent().over_front(lane), whole / front, rtol=0.01)


@pytest.mark.ci
def test_small_errors_get_the_steps_of_the_length_added():
    _, m = study(20.0, error=1e-3)
    result = sp.fit(m, event="full")
    assert result.between_contacts is not None
    assert (result.between_contacts > m.sigma).any()
    assert any("steps where the order of its breaks changes" in note for note in result.notes)


@pytest.mark.ci
def test_counts_of_whole_events_have_the_error_of_the_model():
    """An interpolated length cannot hold a count to a few per cent of a contact."""
    stiffness, m = study(20.0)
    counted = sp.Measurements(height=HEIGHT, poisson=0.3, length=np.ceil(m.length), kind=("whole",) * len(HEIGHT))
    result = sp.fit(counted, event="full")
    assert result.identifiability is not Identifiability.EQUAL
    assert (result.between_contacts > 0.05).any()
    (piece,) = result.intervals["stiffness"][0.95]
    assert piece.low < stiffness < piece.high


@pytest.mark.ci
def test_the_command_takes_it_and_a_request_repeats_it(tmp_path):
    _, m = study(6.5)
    rows = zip(m.height, m.length, m.sigma, strict=True)
    table = tmp_path / "lengths.csv"
    table.write_text("height,poisson,length,length_sigma\n" + "".join(f"{h:.6g},0.3,{x:.9g},{s:.9g}\n" for h, x, s in rows))
    found = CliRunner().invoke(command, [str(table), "--event", "full", "--intervals", "profile", "--json"])
    assert found.exit_code == 0, found.output
    content = json.loads(found.stdout)
    assert content["request"]["event"] == "full"
    assert from_request(content["request"])["event"] == "full"
    again = sp.fit(sp.read_measurements(table), **from_request(content["request"]))
    assert again.values["stiffness"] == pytest.approx(content["values"]["stiffness"], rel=1e-12)
    assert as_request(again.request) == content["request"]


@pytest.mark.ci
def test_what_a_fit_of_whole_events_does_not_take():
    _, m = study(6.5)
    with pytest.raises(ValueError, match=r"event = 'whole': must be one of 'domino', 'full', 'crack'"):
        sp.fit(m, event="whole")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=r"gauges, block_length and machine_stiffness need the model of one front"):
        sp.fit(dataclasses.replace(m, block_length=20 * m.height), event="full")


@pytest.mark.ci
def test_the_density_of_whole_events_is_traced():
    """Value and slope, compiled and mapped, from the table that the fit has; second derivatives are refused."""
    _, m = study(6.5)
    result = sp.fit(m, event="full", intervals="profile")
    at = result.problem(result.theta + 0.02, order=1)
    density = jax.value_and_grad(result.problem.traced)
    with jax.enable_x64(True):
        value, slope = jax.jit(jax.vmap(density))(jnp.asarray(result.theta + 0.02)[None])
    np.testing.assert_allclose(value, at.value, rtol=1e-9)
    np.testing.assert_allclose(slope, at.gradient, rtol=1e-6)
    with pytest.raises(TypeError, match="from a table, which has first derivatives only"), jax.enable_x64(True):
        jax.hessian(result.problem.traced)(jnp.asarray(result.theta))
