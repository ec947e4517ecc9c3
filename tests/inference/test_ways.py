"""Every way of a result for every kind of table, with its units; and what a report says, word by word.

The words are those of `reports/NAME.txt`, with `#` for every number: numbers have tests of their own. Where a report was meant to
change, `SLIPPULSE_WRITE_REPORTS=1 pytest -m ci tests/inference/test_ways.py` writes them anew: read the difference.
"""

import io
import json
import os
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from reports import unfolded

import slippulse_jax as sp
from slippulse_jax.front.front import slip_and_stress
from slippulse_jax.inference.model.inputs import Inputs
from slippulse_jax.inference.model.slider import FirstFront
from slippulse_jax.inference.observables import EVERY

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "fit_examples"
TWO_EVENTS = (HERE / "tables/two_events.csv").read_text(encoding="utf-8").partition("\n")[2]
SEQUENCE = (EXAMPLES / "sequence/lengths.csv").read_text(encoding="utf-8")


def rows_of_sequence(*kept):
    """The bundled sequence with some of its rows."""
    comment, header, *rows = SEQUENCE.strip().split("\n")
    return read("\n".join([header, *(rows[i] for i in kept)]))


def read(text):
    return sp.Measurements.from_dataframe(pd.read_csv(io.StringIO(text)))


def observed(kind):
    """Lengths of two sliders of strength 2 MPa, with forces and displacements at nucleation, or slip and stress at gauges."""
    areal, contact, young, strength = 6e11, 1e-4, 3e9, 2e6
    height, ratio = np.array([25.0, 50.0]), areal * contact / young
    length = np.asarray(sp.exact_lengths(sp.Slider(height, ratio, 0.3)))
    given = {
        "height": height,
        "poisson": 0.3,
        "length": length,
        "length_sigma": 0.3,
        "correlation_length": contact,
        "young": young,
    }
    if kind == "gauges":
        place = np.array([2.0, 8.0, 20.0])
        fields = [
            slip_and_stress(sp.Slider(h, ratio, 0.3), np.zeros(()), np.asarray(x), 64)
            for h, x in zip(height, length, strict=True)
        ]
        slip, stress = (np.concatenate([np.asarray(one[i])[place.astype(int)] for one in fields]) for i in (0, 1))
        row, x = np.repeat([0, 1], 3), np.tile(place, 2) * contact
        unit = strength / areal
        return sp.Measurements(**given, gauges=sp.Gauges(row, x, slip * unit, 0.02 * unit, stress * strength, 0.02 * strength))
    inputs = Inputs.of(height, ratio, 0.3)
    force, displacement = (EVERY[name]().evaluate(FirstFront(), inputs)[0] for name in ("force", "displacement"))
    force, displacement = force * strength * contact, displacement * strength / areal
    return sp.Measurements(
        **given, force=force, force_sigma=0.02 * force, displacement=displacement, displacement_sigma=0.02 * displacement
    )


TABLES = {
    "lengths": (lambda: EXAMPLES / "pmma_block/lengths.csv", {}),
    "one length in λc": (lambda: EXAMPLES / "paper_printed_value/lengths.csv", {}),
    "counts": (lambda: EXAMPLES / "counts_and_run_throughs/lengths.csv", {}),
    "specimens": (lambda: EXAMPLES / "shared_stiffness/lengths.csv", {}),
    "at nucleation": (lambda: observed("nucleation"), {"free": ["stiffness", "strength"]}),
    "gauges": (lambda: observed("gauges"), {"free": ["stiffness", "strength"]}),
    "blocks": (lambda: EXAMPLES / "pushed_block/lengths.csv", {}),
    "sequence": (lambda: EXAMPLES / "sequence/lengths.csv", {}),
    "sequence of five": (lambda: rows_of_sequence(0, 1, 2, 3, 4), {}),
    "sequence of two": (lambda: rows_of_sequence(1, 5), {}),
    "spanning force": (lambda: rows_of_sequence(5), {"fixed": {"friction": 0.35}}),
    "largest forces": (lambda: read(TWO_EVENTS), {}),
    "no first event": (lambda: rows_of_sequence(1, 2, 3, 4, 5), {}),
}
"""Kinds of tables, and how they are fitted."""


def is_of_sequence(result):
    return result.main.noun == "force"


# --- the ways ---------------------------------------------------------------------------------------------------------------


def unit_of(heading):
    """Size in SI of a column by the end of its name; 1 without a unit."""
    units = {"mm": 1e-3, "um": 1e-6, "N": 1.0, "kN": 1e3, "N_per_m": 1.0, "MPa": 1e6}
    return next((size for unit, size in sorted(units.items(), key=lambda x: -len(x[0])) if heading.endswith(f"_{unit}")), 1.0)


def in_dataframe(result, *_):
    """Columns of values are those of the table, in its units; what is fitted stands beside them."""
    m, frame = result.measurements, result.to_dataframe()
    assert len(frame) == len(m)
    quantity = "force" if is_of_sequence(result) else "length"
    (own,) = (
        name
        for name in frame
        if re.fullmatch(rf"{quantity}(_[a-zA-Z_]+)?", name) and not re.search("sigma|fitted|att|resid", name)
    )
    value, error, fitted_ = (frame[own.replace(quantity, quantity + end, 1)] for end in ("", "_sigma", "_fitted"))
    stated = m.force if is_of_sequence(result) else m.length * m.metres
    width = m.or_zero("block_width") if is_of_sequence(result) and m.heading("force").endswith("_N") else 1.0
    np.testing.assert_allclose(value * unit_of(own), stated * width, rtol=1e-12)
    assert own == m.heading(quantity) or not m.columns  # arrays in SI are shown in mm
    plain = (error > 0) & (is_of_sequence(result) | (frame["kind"] == "length"))
    assert plain.any() == (result.main.noun != "count")
    np.testing.assert_allclose(((fitted_ - value) / error)[plain], frame["residual"][plain], rtol=1e-9, atol=1e-12)
    assert set(frame["outcome"]) <= {"arrested", "ran_through", "run_away"}


def in_html(result, *_):
    text = result._repr_html_()
    plain = unfolded(re.sub("<[^>]*>", " ", text))
    assert result.identifiability.value in plain
    for one in result.data:
        noun = result.observable(one.observable).noun
        count = sum(len(other.value) for other in result.data if result.observable(other.observable).noun == noun)
        assert re.search(rf"\b{count} {noun}s?\b", plain)
    for one in result.parameters.free:
        assert one.nuisance or one.unit in plain


def in_dict(result, *_):
    content = result.to_dict()
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["values"].keys() == content["units"].keys()
    for one in result.parameters.free:
        assert one.nuisance or content["units"][one.label] == one.unit
    for name, value in content["values"].items():
        assert value == result.values[name]


def saved(result, _, folder):
    result.save(folder / "fit.json")
    again = sp.load_fit(folder / "fit.json")
    assert again.report(verbose=True) == result.report(verbose=True)
    assert again.methods() == result.methods()
    pd.testing.assert_frame_equal(again.to_dataframe(), result.to_dataframe())


def in_words(result, *_):
    """The unit of every value stands behind it; places of forces are lengths, not forces."""
    report, methods = unfolded(result.report(verbose=True)), result.methods()
    for one in map(result.parameters.named, result.names):
        assert f"{one.symbol} = " in report
        assert re.search(rf"{re.escape(one.symbol)} = [^=]* {re.escape(one.unit)}", report) or not one.unit
        assert one.unit in methods or one.label not in result.given
    for text in (report, methods):
        assert not re.search(r"\bnan\b|\binf\b|None|Traceback|  #", text)
    unit = "N" if is_of_sequence(result) else result.measurements.unit[1]
    head = next(line for line in result.report().splitlines() if "(fit-meas)/σ" in line)
    assert f"fitted/{unit}" in head


def objective(result, *_):
    """Its value and slope beside the best fit are those of the fit."""
    import jax

    theta = result.theta + 1e-3 * (result.parameters.high - result.parameters.low)
    with jax.enable_x64(True):
        value, slope = jax.jit(jax.value_and_grad(result.problem.traced))(theta)
    found = result.problem(theta, order=1)
    assert float(value) == pytest.approx(found.value[0], rel=1e-9, abs=1e-9)
    np.testing.assert_allclose(slope, found.gradient[0], rtol=1e-6, atol=1e-6)


def drawn_again(result, *_):
    """Fits of drawn data, by which parameters are as many as in the fit."""
    samples = result.bootstrap(4)
    assert samples.theta.shape[-1] == result.problem.p
    assert np.isfinite(samples.theta).all()


LABEL = re.compile(r"\(.+\)|/|\$|deviance")
"""What a label of an axis has: a unit, a ratio, or a symbol."""


def pictures(result, *_):
    """Every picture of a fit, with a unit on every axis, or a reason why there is none."""
    names = result.names
    of_one = [
        sp.plot.residuals,
        sp.plot.fit_lengths,
        sp.plot.fit_sequence,
        sp.plot.sequence_events,
        sp.plot.length_versus_stiffness,
    ]
    drawn, refused = [], {}
    for draw in (sp.plot.fit, sp.plot.fit_profiles, sp.plot.corner, sp.plot.gauges, *of_one):
        try:
            drawn.append((draw.__name__, draw(result)))
        except ValueError as error:
            refused[draw.__name__] = str(error)
    drawn += [(f"profile {name}", sp.plot.profile(result, name)) for name in names]
    drawn += [(f"observable {one.observable}", sp.plot.observable(result, one.observable)) for one in result.data]
    for name, picture in drawn:
        for panel in getattr(picture, "axes", None) if hasattr(picture, "savefig") else [picture]:
            if panel.get_visible():
                for axis in (panel.xaxis, panel.yaxis):  # panels of a figure may share one
                    label = axis.get_label_text()
                    assert LABEL.search(label) or (hasattr(picture, "savefig") and not label), (name, label)
    of_lengths, of_forces = {"fit_lengths", "length_versus_stiffness"}, {"fit_sequence", "sequence_events"}
    without = (of_lengths if is_of_sequence(result) else of_forces) | (
        {"gauges"} if result.measurements.gauges is None else set()
    )
    assert without <= {*refused} <= without | {"length_versus_stiffness"}, refused


def in_its_words(result, name, _):
    """Report and sentences for a paper, with # for every number; changes, the largest first, in the order of the alphabet."""
    box, _, rest = result.report(verbose=True).replace(f"{EXAMPLES}/", "").partition("┘")
    rows = [*unfolded(box).split(". "), *rest.splitlines(), "", *result.methods().split(". ")]
    rows = [NUMBER.sub("#", unfolded(row).strip()).replace("# # #", "# ± #") for row in rows]
    first = next((i for i, row in enumerate(rows) if row.startswith("What else")), 0) + 1
    last = rows.index("", first)
    text = "\n".join([*rows[:first], *sorted(rows[first:last]), *rows[last:]]) + "\n"
    path = HERE / "reports" / f"{name.replace(' ', '_').replace('λc', 'lc')}.txt"
    if os.environ.get("SLIPPULSE_WRITE_REPORTS"):
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    assert text == path.read_text(encoding="utf-8")


NUMBER = re.compile(r"(?<![\w/])[+-]?\d+([.,]\d+)*(e[+-]?\d+|⁻?[⁰¹²³⁴⁵⁶⁷⁸⁹]+)?|(?<=\))e-?\d+")


@pytest.mark.ci
@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.slow if "five" in name else ()) for name in TABLES])
@pytest.mark.filterwarnings("ignore::slippulse_jax.inference.table.measurements.MeasurementWarning")
def test_every_way_of_every_table(name, tmp_path):
    table, options = TABLES[name]
    result = sp.fit(table(), **options)
    for way in (in_dataframe, in_html, in_dict, saved, in_words, objective, drawn_again, pictures, in_its_words):
        way(result, name, tmp_path)
