"""Whatever takes numbers looks at what it is given: units, masks, and what is no number, at every door."""

from decimal import Decimal
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slippulse_jax as sp

SLIDER = sp.Slider(25.0, 0.03, 0.3)
CHAIN = sp.chain(SLIDER, sites=8)
SI = {"height": 0.025, "correlation_length": 1e-5, "areal_stiffness": 2e10, "poisson": 0.3, "young": 3e9}
TABLE = {key: SI[key] for key in ("height", "correlation_length", "poisson", "young")} | {"length": 0.014, "length_sigma": 5e-4}
FORCES = {"block_length": 0.075, "push_height": 0.004, "force": 2e4, "force_sigma": 2e2, "normal_load": 1e5}
KNOWN = sp.Knowledge.lognormal(2e10, 0.3, in_si=True, nodes=5)
DESIGN = {"height": [0.025, 0.05], "sigma": 5e-4, "correlation_length": 1e-5, "young": 3e9}
READ = {"position": 3e-3, "slip": 1e-6, "slip_sigma": 1e-7, "stress": 1e5, "stress_sigma": 1e3}
UNITS = {"height": "m", "correlation_length": "m", "young": "Pa", "areal_stiffness": "Pa/m", "stiffness": "Pa/m", "length": "m", "length_sigma": "m",
         "block_length": "m", "push_height": "m", "force": "N/m", "force_sigma": "N/m", "normal_load": "N/m", "sigma": "m",
         "push_width": "m", "machine_stiffness": "N/m^2", "position": "m", "slip": "m", "slip_sigma": "m", "stress": "Pa",
         "stress_sigma": "Pa"}  # fmt: skip


IN_SI = {
    "Slider.from_material": (sp.Slider.from_material, SI),
    "Block.from_material": (
        sp.Block.from_material,
        SI | {"push_height": 4e-3, "push_width": 2e-3, "length": 0.075, "machine_stiffness": 1e9},
    ),
    "Measurements.from_si": (sp.Measurements.from_si, TABLE | FORCES),
    "design": (lambda **given: sp.design(KNOWN, **given), DESIGN),
    "Gauges": (lambda **given: sp.Gauges([0], **given), READ),
    "Knowledge.lognormal": (
        lambda stiffness: sp.Knowledge.lognormal(stiffness, 0.3, in_si=True, nodes=5),
        {"stiffness": 2e10},
    ),
}
"""Doors that take SI units, and usual arguments."""
DOORS_IN_SI = [(door, name) for door, (_, usual) in IN_SI.items() for name in usual if name in UNITS]


def through(door, name, x):
    """What a door gives if one argument is `x`."""
    make, usual = IN_SI[door]
    return make(**usual | {name: x})


PLAIN = {
    "Slider.height": lambda x: sp.Slider(x, 0.03, 0.3),
    "Slider.stiffness": lambda x: sp.Slider(25.0, x, 0.3),
    "Slider.poisson": lambda x: sp.Slider(25.0, 0.03, x),
    "Block.height": lambda x: sp.Block(x, 0.03, 0.3),
    "Block.length": lambda x: sp.Block(25.0, 0.03, 0.3, length=x),
    "Block.friction": lambda x: sp.Block(25.0, 0.03, 0.3, friction=x),
    "Block.normal_stiffness": lambda x: sp.Block(25.0, 0.03, 0.3, normal_stiffness=x),
    "Block.machine": lambda x: sp.Block(25.0, 0.03, 0.3, machine=x),
    "Push.height": lambda x: sp.Push(x),
    "Push.width": lambda x: sp.Push(0.5, x),
    "Interface.prestress": lambda x: sp.Interface(x),
    "Interface.threshold_slope": lambda x: sp.Interface(0.0, x),
    "Profile.threshold": lambda x: sp.Profile(x),
    "Profile.prestress": lambda x: sp.Profile([1.0, 1.0], x),
    "SmoothBreak.width": lambda x: sp.SmoothBreak(x),
    "Ageing.newborn": lambda x: sp.Ageing(x, 1.0),
    "Ageing.scale": lambda x: sp.Ageing(0.3, x),
    "CrackLike.friction": lambda x: sp.exact_length(SLIDER, rule=sp.CrackLike(x)),
    "Slider.length": lambda x: sp.Slider(25.0, 0.03, 0.3, length=x),
    "Slider.machine": lambda x: sp.Slider(25.0, 0.03, 0.3, machine=x),
    "contact": lambda x: sp.chain(SLIDER, sites=8, contact=x),
    "Steps.size": lambda x: sp.series(CHAIN, sp.Steps(x), events=1),
    "Spring.stiffness": lambda x: sp.series(CHAIN, sp.Spring(x), events=1),
    "until": lambda x: sp.series(CHAIN, events=1, until=x),
    "load": lambda x: CHAIN.relaxed(x),
    "damping": lambda x: sp.simulate_inertial(CHAIN, duration=1.0, damping=x),
    "b": lambda x: sp.theory.macroscopic_length(x, 0.3),
    "poisson": lambda x: sp.theory.length_ceiling(x),
    "column height": lambda x: sp.Measurements(x, 0.3, 14.0),
    "column length": lambda x: sp.Measurements(25.0, 0.3, x),
    "column friction": lambda x: sp.Measurements(25.0, 0.3, 14.0, push_height=4.0, friction=x),
    "height": lambda x: sp.sweep(height=x, stiffness=0.03, poisson=0.3),
    "prestress": lambda x: sp.sweep(height=25.0, stiffness=0.03, poisson=0.3, prestress=x),
    "push_height": lambda x: sp.sweep(height=25.0, stiffness=0.03, poisson=0.3, push_height=x),
    "design: height": lambda x: sp.design(sp.Knowledge.lognormal(0.01, 0.3), height=x, sigma=0.5),
    "Knowledge.log_stiffness": lambda x: sp.Knowledge(x),
    "Knowledge.weight": lambda x: sp.Knowledge([-4.0, -4.0], x),
    "log_sd": lambda x: sp.Knowledge.lognormal(0.01, x),
    "parameter young: value": lambda x: sp.Parameter("young", value=x),
    "parameter young: prior": lambda x: sp.Parameter("young", prior=(x, 1e8)),
    "parameter young: bounds": lambda x: sp.Parameter("young", bounds=(x, 1e10)),
    "parameter stiffness: bounds": lambda x: sp.fit(sp.Measurements(25.0, 0.3, 14.0, 0.5), bounds=(x, 1.0)),
    "parameter poisson: value": lambda x: sp.fit(sp.Measurements(25.0, 0.3, 14.0, 0.5), fixed={"poisson": x}),
    "stiffness": lambda x: sp.recover_profile(sp.Measurements([20.0, 25.0], 0.3, [12.0, 14.0], 0.5), stiffness=x),
}  # fmt: skip
"""Doors of ratios, and of lengths in λc, by the argument that a message names."""
ODD = {
    "masked": np.ma.masked_array([25.0, 25.0], [0, 1]),
    "masked number": np.ma.masked_array(25.0, True),
    "list of masked": [25.0, np.ma.masked],
    "complex": np.array([25.0 + 1j, 25.0]),
    "complex of JAX": jnp.array([25.0 + 1j]),
    "dates": np.array(["2026-11-28", "2026-11-29"], "M8[D]"),
    "times": np.array([25, 26], "m8[s]"),
    "records": np.array([(25.0,), (26.0,)], [("height", float)]),
    "booleans": np.array([True, False]),
    "boolean": True,
    "boolean among numbers": [25.0, True],
    "booleans among numbers": [np.True_, 25.0],
    "booleans of JAX": jnp.array([True, False]),
    "text": "2_5",
    "texts": ["2_5", "25"],
    "digits of full width": ["２５"],
    "ragged": [[25.0], [25.0, 26.0]],
    "too large for a float": 10**400,
    "one of them too large": [25.0, 10**400],
    "object": object(),
}


def of_pint():
    import pint

    registry = pint.UnitRegistry()
    return lambda x, unit: registry.Quantity(np.asarray(x), unit)


def of_xarray():
    import xarray as xr

    make = of_pint()
    return lambda x, unit: xr.DataArray(make(x, unit))


def of_astropy():
    from astropy import units

    return lambda x, unit: units.Quantity(np.asarray(x), unit)


def of_unxt():
    import unxt

    return lambda x, unit: unxt.Quantity(jnp.asarray(x), unit)


MAKERS = [of_pint, of_xarray, pytest.param(of_astropy, marks=pytest.mark.ci), pytest.param(of_unxt, marks=pytest.mark.ci)]
LARGER = {"m": ("km", 1e3), "Pa": ("GPa", 1e9), "Pa/m": ("GPa/mm", 1e12), "N/m": ("kN/mm", 1e6), "N/m^2": ("N/mm^2", 1e6)}


@pytest.fixture
def double():
    with jax.enable_x64(True):
        yield


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("maker", MAKERS)
def test_quantities_are_converted_where_a_door_is_in_si(maker):
    make = maker()
    for door, name in DOORS_IN_SI:
        value, (unit, size) = np.asarray(IN_SI[door][1][name]), LARGER[UNITS[name]]
        assert_alike(through(door, name, make(value / size, unit)), through(door, name, value))
        with pytest.raises((TypeError, ValueError), match=rf"(?s){name}.*must be .*\(.*onvert"):
            through(door, name, make(value, "s"))


def assert_alike(found, expected):
    """Equal numbers in whatever a door gives."""
    both = [[one] if isinstance(one, jax.Array) else [*vars(one).values()] for one in (found, expected)]
    compared = 0
    for x, y in zip(*both, strict=True):
        if isinstance(x, np.ndarray | jax.Array) and x.dtype.kind == "f":
            np.testing.assert_allclose(x, y, rtol=1e-12)
            compared += 1
    assert compared


@pytest.mark.parametrize("maker", MAKERS)
def test_quantities_are_refused_where_a_number_has_no_unit(maker):
    quantity = maker()(25.0, "mm")
    for name, door in PLAIN.items():
        with pytest.raises((TypeError, ValueError), match=name):
            door(quantity)


def test_several_quantities_in_a_list():
    make = of_pint()
    heights = [make(25.0, "mm"), make(7.0, "cm")]
    np.testing.assert_allclose(through("Slider.from_material", "height", heights).height, [2500, 7000])
    with pytest.raises(TypeError, match=r"Slider.height = 25.0 millimeter: must be a number without a unit; from_material"):
        sp.Slider(heights, 0.03, 0.3)
    assert float(sp.Slider([make(25.0, ""), 30.0], 0.03, 0.3).height[0]) == 25


@pytest.mark.parametrize("odd", ODD)
def test_what_is_no_number_is_refused_by_name(odd):
    for name, door in PLAIN.items():
        with pytest.raises((TypeError, ValueError), match=name):
            door(ODD[odd])
    for door, name in DOORS_IN_SI:
        with pytest.raises((TypeError, ValueError), match=name):
            through(door, name, ODD[odd])


@pytest.mark.parametrize("x", [Fraction(3, 10), Decimal("0.3"), 10**400, -(10**400)])
@pytest.mark.parametrize("key", ["value", "prior", "bounds"])
def test_numbers_that_numpy_does_not_take_are_none_of_a_parameter(key, x):
    with pytest.raises(ValueError, match=f"parameter poisson: {key} = .*: must be "):
        sp.Parameter("poisson", **{key: x if key == "value" else (x, 1.0)})


def test_a_block_takes_one_number_each():
    doors = {
        "Block.length": lambda x: sp.Block(25.0, 0.03, 0.3, length=x),
        "Block.height": lambda x: sp.Block(x, 0.03, 0.3),
        "Block.friction": lambda x: sp.Block(25.0, 0.03, 0.3, friction=x),
        "Block.machine": lambda x: sp.Block(25.0, 0.03, 0.3, machine=x),
        "Push.height": lambda x: sp.Push(x),
        "Push.width": lambda x: sp.Push(0.5, x),
    }
    for name, door in doors.items():
        for x in ([0.2, 0.3] if name.startswith("Push") else [40, 60], jnp.array([40.0])):
            with pytest.raises(ValueError, match=rf"{name} has shape \({len(x)},\): one block at a time; use jax.vmap"):
                door(x)


def test_arrays_of_pandas_and_xarray_are_taken_as_before():
    import pandas as pd
    import xarray as xr

    for one in (pd.Series([25, 30]), pd.Series([25, 30], dtype="Int64"), xr.DataArray([25.0, 30.0], attrs={"units": "mm"})):
        for found in (
            sp.Slider(one, 0.03, 0.3),
            sp.sweep(height=one, stiffness=0.03, poisson=0.3),
            sp.Measurements(one, 0.3, 12.0),
        ):
            np.testing.assert_array_equal(found.height, [25.0, 30.0])
    assert sp.Slider(jnp.ones(2, jnp.bfloat16) * 25, 0.03, 0.3).height.dtype == np.float32
