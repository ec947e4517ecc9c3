"""Pictures of a fit say what was fitted, in the unit of the table, and by the name of the specimen."""

import io

import numpy as np
import pandas as pd
import pytest

from slippulse_jax import Measurements, fit, plot
from slippulse_jax.inference.model import lengths
from slippulse_jax.inference.parameters import Inputs

HEIGHTS = (2.5, 5.0, 7.5)


def lengths_of(height, stiffness):
    """ℓ* in λc of sliders whose fields broadcast."""
    inputs = Inputs.of(height, stiffness, 0.3)
    return lengths(inputs.ravel()).value.reshape(inputs.poisson.shape)


def texts(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def table(unit, *, height=HEIGHTS, correlation_length=1e-5, **columns):
    """Lengths over three heights in some unit."""
    size, height = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}[unit], np.array(height)
    length = lengths_of(height * size / correlation_length, 0.3 / (height[0] * size / correlation_length))
    length *= correlation_length / size
    made = {f"height_{unit}": height, f"length_{unit}": length, f"length_sigma_{unit}": 0.01 * length, "poisson": 0.3}
    return pd.DataFrame(made | {"correlation_length_m": correlation_length, "young_GPa": 3.0} | columns)


@pytest.mark.parametrize(("unit", "correlation_length"), [("m", 1e-2), ("cm", 1e-4), ("mm", 1e-5), ("um", 1e-5)])
def test_every_length_is_in_the_unit_of_the_table(unit, correlation_length):
    heights = [2500.0, 5000.0, 7500.0] if unit == "um" else HEIGHTS
    made = table(unit, height=heights, correlation_length=correlation_length)
    left, right, below = plot.fit(fit(made, "areal_stiffness")).axes
    printed = {"um": "µm"}.get(unit, unit)
    assert texts(right)[:3] == [f"$H$ = {height:g} {printed}" for height in heights]
    assert below.get_xlabel() == f"height, $H$ ({printed})"
    assert left.get_ylabel() == f"precursor length, $\\ell$ ({printed})"
    (points,) = left.containers
    np.testing.assert_allclose(points[0].get_xdata(), heights)


def test_lengths_without_a_unit_are_in_correlation_lengths():
    height = np.array([20.0, 40.0, 80.0])
    m = Measurements(height=height, poisson=0.3, length=lengths_of(height, 0.01), length_sigma=0.3)
    _, right, below = plot.fit(fit(m)).axes
    assert texts(right)[:3] == [rf"$H/\lambda_c$ = {h:g}" for h in height]
    assert below.get_xlabel() == r"height, $H/\lambda_c$"


def test_heights_of_the_push_are_in_the_unit_of_the_table():
    cm = io.StringIO("height_cm,push_height_cm,length_cm,length_sigma_cm,poisson,correlation_length_um,young_GPa\n"
                     "4,1.0,1.6,0.05,0.3,100,3\n4,1.5,1.9,0.05,0.3,100,3\n")  # fmt: skip
    _, right, below = plot.fit(fit(pd.read_csv(cm), "areal_stiffness")).axes
    assert texts(right)[:2] == ["$h$ = 1 cm", "$h$ = 1.5 cm"]
    assert below.get_xlabel() == "height of the push, $h$ (cm)"
