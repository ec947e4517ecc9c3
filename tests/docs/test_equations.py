"""Every equation of the paper has a function that computes it and a test that checks it; and some of those tests."""

import functools
from pathlib import Path

import equations
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax.front.front import front_fields

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module", autouse=True)
def read_once():
    """The index reads every file of the package and of the tests: once is enough."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(equations, "index", functools.cache(equations.index))
        yield


@pytest.mark.ci
def test_no_equation_is_missing():
    assert len(equations.ORDER) == 67  # 65 labels on 66 printed equations, and the two lattice equations without a number
    assert equations.missing() == []


@pytest.mark.ci
def test_page_is_up_to_date():
    assert equations.page() == (DOCS / "reference" / "equations.md").read_text(encoding="utf-8")


def test_numbers_run_as_printed():
    numbers = [n for row in equations.equations().values() for n in row["number"].split(", ") if n]
    assert sorted(map(int, numbers)) == list(range(1, 67))


@pytest.mark.ci
def test_the_index_notices_what_is_missing(monkeypatch):
    found = equations.index()
    for computed, tested, complaint in (([], ["t"], "cra44: no function"), (["f"], [], "cra44: no test")):
        monkeypatch.setattr(equations, "index", lambda c=computed, t=tested: found | {"cra44": (c, t)})
        (only,) = equations.missing()
        assert only.startswith(complaint)


def test_labels_are_read_as_they_are_written():
    assert equations.named("see label" + "s cra26, cra34–cra36 and cra44; cra58 is not meant") == [
        "cra26", "cra34", "cra35", "cra36", "cra44"
    ]  # fmt: skip
    assert equations.named("eliminating from cra48–cra50") == []


def test_springs_from_the_material():
    """Labels cra03, cra04, cra05: stiffnesses of a block of elastic material, in N/m."""
    E, nu, H, lc, areal = 3e9, 0.3, 0.05, 1e-5, 2e10
    slider = sp.Slider.from_material(height=H, correlation_length=lc, areal_stiffness=areal, poisson=nu, young=E)
    K = E * lc
    # an upper block is λc long, H high and λc thick: a rod of section Hλc, stretched over λc
    np.testing.assert_allclose(slider.K_L * K, E * (H * lc) / lc, rtol=1e-14)
    # sheared over H: G λc λc/H, with G = E/2(1+ν)
    np.testing.assert_allclose(slider.K_T * K, E / (2 * (1 + nu)) * lc * lc / H, rtol=1e-14)
    np.testing.assert_allclose(slider.stiffness * K, areal * lc**2, rtol=1e-14)


def test_dimensionless_numbers_of_the_appendix():
    """Labels cra41, cra42."""
    slider = sp.Slider(25.0, 0.03, 0.3)
    h, q = 1 / slider.height, slider.stiffness
    np.testing.assert_allclose(slider.b, 2 * (1 + slider.poisson) * q / h, rtol=1e-14)
    np.testing.assert_allclose(slider.epsilon, slider.kappa_T**2 / slider.kappa**2, rtol=1e-14)
    np.testing.assert_allclose(slider.epsilon, h / (1 + slider.b), rtol=1e-14)
    np.testing.assert_allclose(slider.kappa_T**2, h * q / slider.b, rtol=1e-14)
    np.testing.assert_allclose(slider.kappa**2, q * (1 + slider.b) / slider.b, rtol=1e-14)
    np.testing.assert_allclose(1 - slider.beta, slider.b / (1 + slider.b), rtol=1e-14)


@pytest.mark.ci
def test_lattice_is_in_balance_with_the_stresses_of_the_paper():
    """Labels discr1, discr2, cra06, cra07: of the first precursor at arrest, site by site."""
    slider = sp.Slider(25.0, 0.03, 0.3)
    front = sp.first_precursor(slider)
    fields = front_fields(slider, position=front.contacts_broken, sites=front.pinning.size)
    ut, u, ub = (np.asarray(x) for x in (fields.upper, fields.layer, front.pinning))
    bend = lambda x: x[2:] + x[:-2] - 2 * x[1:-1]  # noqa: E731
    KL, KT, k = float(slider.K_L), float(slider.K_T), float(slider.stiffness)
    np.testing.assert_allclose(KL * bend(ut), KT * (ut - u)[1:-1], atol=1e-13)
    np.testing.assert_allclose(bend(u), (k * (u - ub) + KT * (u - ut))[1:-1], atol=1e-13)
    # what a block of the layer is driven and held by differ by what its neighbours pass on
    driving = np.asarray(slider.driving_stress(ut, u))
    np.testing.assert_allclose(bend(u), k * (np.asarray(fields.stress) - driving)[1:-1], atol=1e-13)
