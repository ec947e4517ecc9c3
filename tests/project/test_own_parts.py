"""What a stranger adds in one file, and no other: a body, a model of a length, a column. A rule is in `front/test_own_rule`."""

import functools
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from chains import ended
from reports import unfolded

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.response import of_matrix
from slippulse_jax.events.first import Relaxed
from slippulse_jax.inference.model.front import Front
from slippulse_jax.inference.model.inputs import Input
from slippulse_jax.inference.observables.observable import Observable
from slippulse_jax.inference.table.columns import Column

# --- a body ---------------------------------------------------------------------------------------------------------------

SITES = 80


class TwoRows(eqx.Module):
    """Two rows of springs on contacts, solved as a matrix: with the springs of a slider, it is one."""

    upper: jax.Array
    across: jax.Array
    stiffness: jax.Array

    def contacts(self, interface, sites):
        one, side = jnp.eye(sites), jnp.eye(sites, k=1)
        along = 2 * one - side - side.T - jnp.diag(one[0] + one[-1])
        of_upper, of_layer = self.upper * along + self.across * one, along + (self.across + self.stiffness) * one
        springs = jnp.block([[of_upper, -self.across * one], [-self.across * one, of_layer]])
        given = jnp.linalg.inv(springs[1:, 1:])
        pushed, layer = -given @ springs[1:, 0], slice(sites - 1, None)
        matrix, edge = self.stiffness * given[layer, layer][:, None], springs[0, 0] + springs[0, 1:] @ pushed
        site = jnp.arange(sites) * 1.0
        carried = jnp.zeros(sites) if interface is None else interface.prestress_at(site)
        return Relaxed(of_matrix(matrix, pushed[None, layer], edge), jnp.ones(sites), carried, self.stiffness, alike=True)


def two_rows(slider):
    return TwoRows(*(jnp.asarray(x) for x in (slider.K_L, slider.K_T, slider.stiffness)))


@pytest.mark.ci
@pytest.mark.parametrize("prestress", [0.0, 0.15])
def test_a_body_of_ones_own_is_taken_by_the_doors(prestress):
    """Lengths, their derivatives, and a series are those of the slider whose springs it has."""
    slider, interface = sp.Slider(25.0, 0.03, 0.3), sp.Interface(prestress)

    def length(stiffness):
        rows = two_rows(sp.Slider(25.0, 0.03, 0.3))
        return sp.precursor_length(eqx.tree_at(lambda x: x.stiffness, rows, stiffness), interface, sites=SITES)

    def expected(stiffness):
        return sp.precursor_length(ended(sp.Slider(25.0, stiffness, 0.3), SITES), interface)

    at = jnp.asarray(0.03)
    assert length(at) == pytest.approx(float(expected(at)), rel=1e-8)
    assert jax.grad(length)(at) == pytest.approx(float(jax.grad(expected)(at)), rel=1e-5)
    found = sp.series(two_rows(slider), interface=interface, events=6, sites=SITES)
    chain = sp.series(sp.chain(ended(slider, SITES), interface=interface), events=6)
    for name in ("load", "force_before", "force_after", "length", "site", "extent", "breaks"):
        np.testing.assert_allclose(getattr(found, name), getattr(chain, name), rtol=1e-7, err_msg=name)
    assert max(found.drift, found.energy_drift) < 1e-12


class Own(eqx.Module):
    """A body whose contacts are those of another; a chain has its own."""

    of: sp.Slider | sp.Block

    def contacts(self, interface, sites):
        if isinstance(self.of, sp.Block):
            return self.of.contacts(interface, sites)
        return sp.chain(self.of, sites=sites, interface=interface).contacts()


class Sliding(Own):
    """The same by way of the slider itself."""

    def contacts(self, interface, sites):
        return self.of.contacts(interface, sites)


SLIDER, BLOCK = sp.Slider(25.0, 0.03, 0.3), sp.Block(12.0, 0.03, 0.3, sp.Push(0.25, 0.1), friction=0.3)


BODIES = {"chain": Own(SLIDER), "slider": Sliding(SLIDER), "block": Own(BLOCK)}
IN_CI = {("slider", 33), ("chain", 60), ("block", 200)}


@pytest.mark.parametrize(
    ("body", "sites"),
    [
        pytest.param(body, sites, id=f"{name}-{sites}", marks=pytest.mark.ci if (name, sites) in IN_CI else pytest.mark.slow)
        for name, body in BODIES.items()
        for sites in (33, 60, 200)
    ],
)
def test_a_body_made_of_the_contacts_of_another(body, sites):
    """However many contacts: lengths, all derivatives and a series are those of the other."""
    names = "height", "stiffness", "poisson"

    def with_numbers(numbers, given):
        return eqx.tree_at(lambda x: [getattr(x, name) for name in names], given, list(numbers))

    def own(numbers):
        return sp.precursor_length(eqx.tree_at(lambda x: x.of, body, with_numbers(numbers, body.of)), sites=sites)

    def other(numbers):
        of = with_numbers(numbers, body.of)
        return sp.precursor_length(of, sites=sites) if isinstance(of, sp.Block) else sp.precursor_length(of)

    at = jnp.stack([jnp.asarray(getattr(body.of, name)) for name in names])
    np.testing.assert_allclose(jax.jit(own)(at), other(at), rtol=1e-11)
    np.testing.assert_allclose(jax.grad(own)(at), jax.grad(other)(at), rtol=1e-8)
    found = sp.series(body, events=3, sites=sites)
    record, its = (sp.first_precursor(x, sites=sites, event="full") for x in (body, body.of))
    for name in ("contacts_broken", "length", "load", "stress", "slip"):
        np.testing.assert_allclose(getattr(record, name), getattr(its, name), rtol=1e-11, atol=1e-12, err_msg=name)
    of = body.of if isinstance(body.of, sp.Block) else sp.chain(body.of, sites=sites)
    expected = sp.series(of, events=3, **({"sites": sites} if isinstance(of, sp.Block) else {}))
    for name in ("load", "force_after", "length", "site", "breaks", "stored"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-11, err_msg=name)


def test_what_breaks_do_to_a_long_chain_is_refused_with_its_memory():
    long = sp.chain(SLIDER, sites=5000)
    assert sp.equilibrium(long, long.relaxed(1.0)).status == Outcome.SOLVED
    of_own = Own(SLIDER)
    for door in (
        lambda: sp.rupture(long),
        lambda: sp.series(long, events=1),
        lambda: sp.series(of_own, sites=5000, events=1),
        lambda: sp.precursor_length(of_own, sites=5000),
        lambda: jax.vmap(lambda u: sp.rupture(long, long.relaxed(u)))(jnp.ones(2)),
    ):
        with pytest.raises(ValueError, match=r"a chain of 5000 sites: .* 0\.[12] GB; the most is 4096"):
            door()


ENDS = {
    "slider": sp.Slider(12.0, 0.1, 0.3, length=40),
    "chain": sp.chain(sp.Slider(12.0, 0.1, 0.3), sites=40),
    "block": sp.Block(12.0, 0.1, 0.3, length=40),
}


@pytest.mark.parametrize("name", [pytest.param(x, marks=[pytest.mark.ci] * (x != "chain")) for x in ENDS])
def test_a_body_that_ends_is_resolved_as_a_whole(name):
    """At every door that takes `sites`: fewer are refused, none given or more are all that there are."""
    body = ENDS[name]
    doors = [functools.partial(door, event="full") for door in (sp.precursor_length, sp.first_precursor)]
    doors += [] if name == "chain" else [functools.partial(sp.series, events=2)]  # a series refuses any sites of a chain
    for door in doors:
        with pytest.raises(ValueError, match=f"sites = 20: a {name} of 40 contacts needs all of them"):
            door(body, sites=20)
        all_of_them, *others = (
            getattr(found, "length", found) for found in (door(body), door(body, sites=40), door(body, sites=50))
        )
        assert np.isfinite(all_of_them).any()
        for other in others:
            np.testing.assert_allclose(other, all_of_them, rtol=1e-13)


def test_one_spring_pulls_a_body():
    for body in (sp.Slider(12.0, 0.1, 0.3, machine=2.0), sp.Block(12.0, 0.1, 0.3, machine=2.0)):
        with pytest.raises(ValueError, match="they are one spring"):
            sp.series(body, sp.Spring(2.0), sites=40, events=1)


@pytest.mark.ci
def test_a_series_of_a_slider_is_that_of_its_chain():
    interface = sp.Interface(0.1, 1e-3)
    found = sp.series(SLIDER, interface=interface, sites=60, events=4)
    expected = sp.series(sp.chain(SLIDER, sites=60, interface=interface), events=4)
    for name in ("load", "force_after", "length", "site", "breaks", "stored"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-11, err_msg=name)
    machine = sp.series(sp.Slider(25.0, 0.03, 0.3, machine=2.0), interface=interface, sites=60, events=4)
    spring = sp.series(SLIDER, sp.Spring(2.0), interface=interface, sites=60, events=4)
    for name in ("load", "length", "site", "breaks"):
        np.testing.assert_allclose(getattr(machine, name), getattr(spring, name), rtol=1e-9, err_msg=name)


def test_what_has_no_contacts_is_no_body():
    for door in (sp.precursor_length, sp.first_precursor, functools.partial(sp.series, events=1)):
        with pytest.raises(TypeError, match="body is float: must be Slider or Block"):
            door(3.0, sites=10)
    with pytest.raises(ValueError, match="sites = None"):
        sp.precursor_length(two_rows(sp.Slider(25.0, 0.03, 0.3)))


# --- a model of a length, and a column ------------------------------------------------------------------------------------


class PartOfHeight(Front):
    """Lengths by Eq. (25) of a part of the height, which the table states in a column of its own."""

    name = "first precursor by Eq. (25)"
    columns = ("part_of_height",)
    inputs = {"log_part": Input("part of the height", np.log(0.1), 0.0, "must lie in 0.1 to 1")}

    def stated(self, m):
        return {"log_part": np.log(np.array(m.other["part_of_height"], float))}

    def length(self, inputs, relaxed):
        height = jnp.exp(inputs.log_height + inputs.get("log_part"))
        return sp.theory.length_eq25(sp.Slider(height, jnp.exp(inputs.log_stiffness), inputs.poisson))


HEIGHT, PART = np.array([20.0, 30.0, 45.0, 60.0, 80.0]), np.array([0.8, 0.9, 0.6, 1.0, 0.7])
LENGTH = np.array(jax.vmap(sp.theory.length_eq25)(sp.Slider(HEIGHT * PART, np.full(5, 7e-3), np.full(5, 0.3))))


def table(part=PART):
    """Exact lengths by that model, with errors of 3 %."""
    return sp.Measurements(HEIGHT, 0.3, LENGTH, 0.03 * LENGTH, other={"part_of_height": [f"{x}" for x in part]})


@pytest.mark.ci
def test_a_model_of_ones_own_with_a_column_of_its_own_is_fitted():
    """The stiffness comes back, with the error of a linear fit; the report says what was fitted."""
    found = sp.fit(table(), event=PartOfHeight())
    assert found.values["stiffness"] == pytest.approx(7e-3, rel=1e-6)
    assert found.identifiability.name == "IDENTIFIED"
    step = 1e-5
    up, down = (
        np.array(
            jax.vmap(sp.theory.length_eq25)(sp.Slider(HEIGHT * PART, np.full(5, 7e-3 * np.exp(side * step)), np.full(5, 0.3)))
        )
        for side in (1, -1)
    )
    slope = (up - down) / (2 * step) / (0.03 * LENGTH)
    assert found.stderrs["stiffness"] == pytest.approx(7e-3 / np.sqrt((slope**2).sum()), rel=1e-4)
    assert "kept but not used" not in found.report()
    assert "first precursor by Eq. (25)" in found.methods() or found.parameters.front.name in found.report(verbose=True)
    assert (found.parameters.front.status(found.parameters.inputs.at(found.theta)) == Outcome.ARRESTED).all()
    density = sp.objective(table(), event=PartOfHeight())
    theta = {"stiffness": jnp.asarray(np.log(7e-3))}
    assert abs(float(jax.grad(density)(theta)["stiffness"])) < 1e-6


def test_what_the_model_needs_is_named():
    with pytest.raises(ValueError, match="the model reads the column part_of_height, which is not there"):
        sp.fit(sp.Measurements(HEIGHT, 0.3, LENGTH, 0.03 * LENGTH), event=PartOfHeight())
    with pytest.raises(TypeError, match="has neither a length nor values"):
        sp.fit(table(), event=Front())
    with pytest.raises(TypeError, match=r"give PartOfHeight\(\), a model, and not its class"):
        sp.fit(table(), event=PartOfHeight)
    with pytest.raises(ValueError, match="a model of one's own, which no file can hold"):
        sp.fit(table(), event=PartOfHeight()).save("nowhere.json")
    with pytest.raises(ValueError, match=r"means part of the height = 2 .*: must lie in 0.1 to 1"):
        sp.fit(table(np.full(5, 2.0)), event=PartOfHeight())


# --- an observable --------------------------------------------------------------------------------------------------------


class EdgeStress(Observable):
    """Stress at the pushed edge after the event."""

    name, noun = "edge_stress", "edge stress"
    column = Column("edge_stress", "MPa")
    acts: ClassVar = {"strength": 1.0}

    def predict(self, model, inputs, relaxed):
        _, stress = model.fields(inputs, jnp.maximum(model.length(inputs, relaxed), 1), 128)
        return stress[0]


STRENGTH, AREAL = 2e6, 1e10


@pytest.fixture(scope="module")
def edges():
    """Lengths and edge stresses of six heights, with 1 % and 3 % of noise, by the record of each front."""
    random, height = np.random.default_rng(0), np.arange(25.0, 80, 10)
    slider = sp.Slider.from_material(
        height=1e-3 * height, correlation_length=1e-3, areal_stiffness=AREAL, young=3e9, poisson=0.3
    )
    length = np.asarray(sp.precursor_length(slider))
    numbers = zip(*(np.broadcast_to(x, height.shape) for x in (slider.height, slider.stiffness)), strict=True)
    edge = STRENGTH * np.array([float(sp.first_precursor(sp.Slider(h, k, 0.3)).stress[0]) for h, k in numbers])
    noise = 1 + np.array([[0.01], [0.03]]) * random.standard_normal((2, 6))
    columns = {
        "height_mm": height,
        "correlation_length_um": 1000,
        "poisson": 0.3,
        "young_GPa": 3,
        "length_mm": length * noise[0],
    }
    columns |= {"length_sigma_mm": 0.01 * length, "edge_stress_MPa": edge * noise[1] * 1e-6}
    return pd.DataFrame(columns | {"edge_stress_sigma_MPa": 0.03e-6 * np.array(edge)})


@pytest.mark.ci
def test_an_observable_of_ones_own_is_in_the_fit_and_wherever_it_is_shown(edges):
    """Its column, its line in the report and the DataFrame, its picture; the objective is half the deviance."""
    found = sp.fit(edges, ["stiffness", "strength"], observables=[EdgeStress()], intervals="profile")
    for name, truth in (("areal_stiffness", AREAL), ("strength", STRENGTH)):
        assert abs(found.values[name] - truth) < 3 * found.stderrs[name]
    assert 0.01 < found.stderrs["strength"] / STRENGTH < 0.03
    report = found.report()
    assert "From 6 lengths and 6 edge stresses of" in unfolded(report)
    assert "edge stress  6 readings, chi-squared" in report
    assert "not used" not in report
    frame = found.to_dataframe()
    np.testing.assert_allclose(frame.edge_stress_MPa, edges.edge_stress_MPa)
    off = (frame.edge_stress_fitted_MPa - frame.edge_stress_MPa) / frame.edge_stress_sigma_MPa
    np.testing.assert_allclose(off, frame.edge_stress_residual, rtol=1e-9)
    ax = sp.plot.observable(found, "edge_stress")
    assert ax.get_ylabel() == "edge stress (MPa)"
    with jax.enable_x64(True):
        f = sp.objective(edges, ["stiffness", "strength"], observables=[EdgeStress()])
        best = dict(zip(f.names, found.theta, strict=True))
        assert 2 * float(f(best)) == pytest.approx(found.deviance, rel=1e-6)
        assert max(abs(float(x)) for x in jax.grad(f)(best).values()) < 1e-2
        assert np.isfinite(jax.vmap(lambda x: f({**best, "strength": x}))(found.theta[1] + jnp.array([-0.1, 0.1]))).all()
    assert found.bootstrap(20).theta.shape == (20, 2)


@pytest.mark.parametrize(
    ("changed", "given", "message"),
    [
        ({}, {"free": "stiffness"}, r"column edge_stress_MPa: what it states scales with σ_s: fit strength too"),
        (
            {"edge_stress_sigma_MPa": None},
            {},
            r"row 0, column edge_stress_sigma_MPa: missing: the value beside it has no standard",
        ),
        ({"edge_stress_MPa": None}, {}, r"table has no column edge_stress_MPa, or no value in it"),
        ({"edge_stress_MPa": "much"}, {}, r"row 0, column edge_stress_MPa: 'much': must be a number"),
        ({"edge_stress_sigma_MPa": 0.0}, {}, r"row 0, column edge_stress_sigma_MPa: 0.0: the standard error must be positive"),
        ({}, {"observables": [EdgeStress]}, r"give instances of Observable"),
        ({}, {"observables": [EdgeStress(), EdgeStress()]}, r"the name 'edge_stress' is taken"),
    ],
)
def test_an_observable_without_its_data_is_refused(edges, changed, given, message):
    for name, x in changed.items():
        edges = edges.drop(columns=name) if x is None else edges.assign(**{name: x})
    given = {"free": ["stiffness", "strength"], "observables": [EdgeStress()]} | given
    with pytest.raises((ValueError, TypeError), match=message):
        sp.fit(edges, **given)


def test_a_fit_with_an_observable_of_ones_own_is_in_no_file(edges, tmp_path):
    found = sp.fit(edges, ["stiffness", "strength"], observables=[EdgeStress()], intervals="profile")
    with pytest.raises(ValueError, match="observables of one's own, which no file can hold"):
        found.save(tmp_path / "fit.json")
