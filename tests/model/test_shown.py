"""What a notebook shows of an object: numbers, in a line and as a table; nothing breaks where JAX traces them."""

import io
import sys

import jax
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.base.shown import html, short

SLIDER = sp.Slider(25.0, 0.03, 0.3)


def shown():
    lengths = sp.Measurements(height=[20, 40, 60], poisson=0.3, length=[15.0, 33.5, 52], length_sigma=0.5)
    result = sp.fit(lengths)
    known = sp.Knowledge.from_fit(result)
    return {
        "Slider(height=25, stiffness=0.03, poisson=0.3)": SLIDER,
        "Block(height=20, stiffness=0.01, poisson=0.3, push=Push(height=0.25))": sp.Block(20.0, 0.01, 0.3, sp.Push(0.25)),
        "FirstPrecursor(body=Slider(height=25, stiffness=0.03, poisson=0.3), contacts_broken=26, length=25.78": sp.first_precursor(SLIDER),
        "Catalogue(number=3, load=[3, 3.5, 4], length=[7.10": sp.series(sp.chain(sp.Slider(5.0, 0.1, 0.3), sites=30), sp.Steps(0.5), events=3),
        "Measurements(3 of measurements: heights [20, 40, 60] λc, lengths [15, 33.5, 52] λc)": lengths,
        "FitResult(IDENTIFIED: stiffness = ": result,
        "Design(2 candidates, best ": sp.design(known, height=[20.0, 50.0], poisson=0.3, sigma=0.5),
    }  # fmt: skip


def test_every_object_has_a_line_and_a_table():
    for line, thing in shown().items():
        assert repr(thing).startswith(line)
        page = thing._repr_html_()
        assert page.count("<table>") == page.count("</table>") == 1
        assert page.count("<tr>") > 1
        for text in (repr(thing), page):
            assert "f32[" not in text
            assert "f64[" not in text
            assert "Array(" not in text


@pytest.mark.ci
def test_batches_and_traced_values():
    assert repr(sp.Slider([[10.0], [25.0]], 0.03, 0.3)) == "Slider(height=[[10], [25]], stiffness=0.03, poisson=0.3)"
    assert "<100 from 10 to 60>" in repr(sp.Slider(np.linspace(10, 60, 100), 0.03, 0.3))
    assert short(np.array([1.0, np.nan])) == "[1, nan]"
    many = jax.vmap(lambda height: sp.first_precursor(sp.Slider(height, 0.03, 0.3), sites=64))(
        np.array([10.0, 25.0], np.float32)
    )
    assert "contacts_broken=[10, 26]" in repr(many)
    assert "[10, 26]" in many._repr_html_()

    def traced(height):
        slider = sp.Slider(height, 0.03, 0.3)
        assert "float" in repr(slider)
        assert "float" in slider._repr_html_()
        return height

    jax.jit(traced)(25.0)


def test_text_is_escaped_and_long_tables_are_cut():
    page = html("<b>", [("<i>",)] * 30, ("<u>",), "a & b")
    assert "&lt;i&gt;" in page
    assert "… 10 more" in page
    assert "<u>" not in page
    assert "a &amp; b" in page


def test_the_table_of_a_rejected_fit_says_why():
    m = sp.Measurements(height=[20, 40, 60], poisson=0.3, length=[15.0, 15, 49], length_sigma=0.1)
    assert "does not describe" in sp.fit(m)._repr_html_()


def test_a_terminal_sees_a_fit_begin(monkeypatch):
    """Before the first length, which the first fit compiles for some seconds."""

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    def look(*_, **options):
        assert "fit (the first compiles): 0.00 lengths" in terminal.getvalue()
        raise InterruptedError

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr("slippulse_jax.inference.fit._explore", look)
    with pytest.raises(InterruptedError):
        sp.fit(sp.Measurements(height=20, poisson=0.3, length=15.0, length_sigma=0.5))
