"""Sweeps: what they compute, how it is labelled, and what they refuse."""

import json
import math
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import jax
import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

import slippulse_jax as sp
from slippulse_jax import plot
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.sweeps import outputs as table
from slippulse_jax.sweeps import run
from slippulse_jax.sweeps.request import INTERFACE, PARAMETERS, SLIDER, Request, make_axes

AXES = {"height": np.array([10.0, 25.0, 50.0]), "stiffness": np.array([0.003, 0.01, 0.03, 0.1]), "poisson": 0.3}


def test_values_are_those_of_the_functions_point_by_point():
    found = sp.sweep(
        **AXES, outputs=("length", "contacts_broken", "status", "nucleation_load", "length_eq25", "runaway_prestress")
    )
    assert found.length.dims == ("height", "stiffness")
    for h in found.height.values:
        for q in found.stiffness.values:
            point, slider = found.sel(height=h, stiffness=q), sp.Slider(h, q, 0.3)
            front = sp.first_precursor(slider, sites=60)
            assert float(point.length) == pytest.approx(float(front.length), abs=1e-10)
            assert int(point.contacts_broken) == int(front.contacts_broken)
            assert int(point.status) == int(front.status)
            assert float(point.nucleation_load) == pytest.approx(float(front.load), rel=1e-13)
            assert float(point.length_eq25) == pytest.approx(float(sp.theory.length_eq25(slider)), rel=1e-13)
            assert float(point.runaway_prestress) == pytest.approx(float(sp.theory.runaway_prestress(slider)), rel=1e-13)


def test_gradients_are_those_of_the_length():
    found = sp.sweep(**AXES, outputs="gradients")
    assert set(found.data_vars) == {"dlength_dheight", "dlength_dstiffness", "dlength_dpoisson"}
    slope = jax.grad(sp.precursor_length)(sp.Slider(25.0, 0.01, 0.3))
    for name in ("height", "stiffness", "poisson"):
        assert float(found[f"dlength_d{name}"].sel(height=25, stiffness=0.01)) == pytest.approx(
            float(getattr(slope, name)), rel=1e-10
        )


@pytest.mark.slow
def test_interface_parameters_are_axes_too():
    phi, slope = np.array([0.0, 0.3, 0.54]), np.array([0.0, 0.002])
    found = sp.sweep(
        height=25.0,
        stiffness=0.03,
        poisson=0.3,
        prestress=phi,
        threshold_slope=slope,
        outputs=("length", "nucleation_load", "status"),
    )
    assert found.length.dims == ("prestress", "threshold_slope")
    exact = sp.precursor_lengths(sp.Slider(25.0, 0.03, 0.3), interface=sp.Interface(phi[:, None], slope))
    np.testing.assert_array_equal(found.length, exact)
    assert np.isinf(found.length.sel(prestress=0.54, threshold_slope=0))
    load = float(lattice_modes(sp.Slider(25.0, 0.03, 0.3)).load)
    np.testing.assert_allclose(found.nucleation_load.sel(threshold_slope=0), (1 - phi) * load, rtol=1e-14)
    both = sp.sweep(height=25.0, stiffness=0.03, poisson=0.3, prestress=[0.0, 0.3], outputs=("gradients",))
    slope = jax.grad(lambda p: sp.precursor_length(sp.Slider(25.0, 0.03, 0.3), interface=sp.Interface(p)))(0.3)
    assert float(both.dlength_dprestress[1]) == pytest.approx(float(slope), rel=1e-10)


KEPT = np.array([0.0, 0.2, 0.6])
"""Shares of their strength that contacts keep."""


@pytest.mark.ci
def test_what_contacts_keep_is_an_axis():
    """Beside a prestress: every output by the functions of one body, closed form and theory at (φ − r)/(1 − r)."""
    phi = np.array([0.3, 0.65])
    given = {"height": 25.0, "stiffness": 0.03, "poisson": 0.3, "prestress": phi, "residual_strength": KEPT}
    outputs = ("length", "contacts_broken", "status", "edge_stress", "nucleation_load", "exact_length", "exact_status",
               "length_macroscopic", "runaway_prestress", "gradients", "is_one_domino")  # fmt: skip
    found, slider = sp.sweep(**given, outputs=outputs), sp.Slider(25.0, 0.03, 0.3)
    assert found.length.dims == ("prestress", "residual_strength")
    assert found.residual_strength.attrs["symbol"] == "r"
    assert np.isinf(found.length).sum() == 2, "beyond the run-away prestress, which rises with what contacts keep"
    runaway = KEPT + (1 - KEPT) * float(sp.theory.runaway_prestress(slider))
    np.testing.assert_allclose(found.runaway_prestress[0], runaway, rtol=1e-14)
    assert ((phi[:, None] > runaway) == np.isinf(found.length)).all()
    assert float(found.nucleation_load.std("residual_strength").max()) < 1e-12
    for p in phi:
        for r in KEPT:
            point, interface = found.sel(prestress=p, residual_strength=r), sp.Interface(p, residual_strength=r)
            front = sp.first_precursor(slider, interface)
            assert (int(point.status), int(point.exact_status)) == (int(front.status),) * 2
            assert float(point.nucleation_load) == pytest.approx(float(front.load), rel=1e-13)
            relaxed = (p - r) / (1 - r)
            law = 25 * sp.theory.macroscopic_length(slider.b, 0.3, prestress=relaxed)
            assert float(point.length_macroscopic) == pytest.approx(float(law), rel=1e-9)
            if np.isfinite(front.length):
                assert float(point.length) == pytest.approx(float(front.length), abs=1e-10)
                assert float(point.exact_length) == pytest.approx(float(sp.exact_length(slider, interface)), rel=1e-11)
                assert int(point.contacts_broken) == int(front.contacts_broken)
                assert float(point.edge_stress) == pytest.approx(float(front.stress[0]), abs=1e-11)
                of_slider, of_interface = jax.grad(sp.precursor_length, (0, 1))(slider, interface)
                for name in (*SLIDER, *INTERFACE):
                    own = getattr(of_slider if name in SLIDER else of_interface, name)
                    assert float(point[f"dlength_d{name}"]) == pytest.approx(float(own), rel=1e-8), name


@pytest.mark.ci
def test_what_contacts_keep_beside_a_slope():
    """The recursion has both; the closed form has one, which each of several points may choose."""
    given = {"height": 100.0, "stiffness": 1 / 260, "poisson": 0.3, "threshold_slope": [0.002, 0.0], "residual_strength": 0.3}
    found, slider = sp.sweep(**given, outputs=("length", "gradients")), sp.Slider(100.0, 1 / 260, 0.3)
    assert float(found.length[0]) == pytest.approx(39.029304484, abs=1e-8), "of an independent recursion"
    slope = jax.grad(lambda r: sp.precursor_length(slider, sp.Interface(0.0, 0.002, r)))(0.3)
    assert float(found.dlength_dresidual_strength[0]) == pytest.approx(float(slope), rel=1e-8)
    one_each = given | {"residual_strength": [0.0, 0.3]}
    exact = sp.sweep(**one_each, points=True, outputs="exact_length").exact_length
    for length, interface in zip(exact, (sp.Interface(0.0, 0.002), sp.Interface(residual_strength=0.3)), strict=True):
        assert float(length) == pytest.approx(float(sp.exact_length(slider, interface)), rel=1e-11)
    with pytest.raises(ValueError, match="'exact_length' takes threshold_slope or residual_strength, not both"):
        sp.sweep(**one_each, outputs="exact_length")


@pytest.mark.ci
def test_blocks_whose_contacts_keep_something():
    given = {"height": 30.0, "stiffness": 0.02, "poisson": 0.3, "push_height": 0.3, "residual_strength": KEPT[1:]}
    found = sp.sweep(**given, outputs=("block_precursor_length", "exact_length"))
    block = sp.Block(30.0, 0.02, 0.3, sp.Push(0.3))
    with jax.enable_x64(True):
        for r, length in zip(KEPT[1:], found.block_precursor_length, strict=True):
            alone = sp.precursor_length(block, sp.Interface(residual_strength=r), event="full")
            assert float(length) == pytest.approx(float(alone), rel=1e-9)


def test_points_are_taken_together():
    h, q = np.array([10.0, 25.0, 50.0]), np.array([0.03, 0.01, 0.003])
    found = sp.sweep(height=h, stiffness=q, poisson=0.3, points=True, outputs="length")
    assert found.length.dims == ("point",)
    assert found.height.dims == ("point",)
    np.testing.assert_array_equal(found.length, sp.precursor_lengths(sp.Slider(h, q, 0.3)))


@pytest.mark.ci
def test_dataset_says_what_it_is(tmp_path):
    found = sp.sweep(**AXES)
    assert found.length.attrs["units"] == "lambda_c"
    assert found.stiffness.attrs["equation"] == "cra41"
    assert found.status.attrs["flag_meanings"].split()[2] == "rebreak"
    request = json.loads(found.attrs["request"])
    assert request["parameters"]["poisson"] == {"value": 0.3}
    assert request["outputs"] == ["length", "status"]
    assert found.attrs["jax"] == jax.__version__
    found.to_netcdf(tmp_path / "sweep.nc", engine="h5netcdf")
    assert xr.load_dataset(tmp_path / "sweep.nc", engine="h5netcdf").identical(found)
    assert all(quantity.name for quantity in PARAMETERS.values())


@pytest.mark.ci
def test_bits_do_not_depend_on_chunks_order_or_company():
    rng = np.random.default_rng(3)
    h, q = rng.uniform(5, 60, 700), 10 ** rng.uniform(-4, 0, 700)
    asked = ("length", "dlength_dstiffness", "status", "length_envelope", "nucleation_load")
    whole = sp.sweep(height=h, stiffness=q, poisson=0.3, points=True, outputs=asked)
    order = rng.permutation(700)
    mixed = sp.sweep(height=h[order], stiffness=q[order], poisson=0.3, points=True, outputs=asked, chunk=97)
    for name in asked:
        np.testing.assert_array_equal(mixed[name], whole[name][order])
    alone = sp.sweep(height=h[5], stiffness=q[5], poisson=0.3, outputs=asked)
    assert all(float(alone[name]) == float(whole[name][5]) for name in asked)


@pytest.mark.ci
@pytest.mark.parametrize("chunk", [None, 5])
@pytest.mark.parametrize("points", [False, True])
def test_lazy_dataset_is_the_same_once_computed(points, chunk):
    many = np.linspace(0.02, 0.05, 12)
    given = {"height": np.linspace(10, 50, 12), "stiffness": many, "poisson": 0.3, "points": points}
    given["outputs"] = ("status", "length", "contacts_broken", "b")
    whole, lazy = sp.sweep(**given), sp.sweep(**given, lazy=True, chunk=chunk)
    assert all(column.chunks for column in lazy.data_vars.values())
    xr.testing.assert_identical(lazy.compute(), whole)
    one = {"height": 25.0, "stiffness": 0.03, "poisson": 0.3}
    xr.testing.assert_identical(sp.sweep(**one, lazy=True).compute(), sp.sweep(**one))


@pytest.mark.slow
def test_every_output_can_be_chosen_and_every_set_names_outputs():
    """A function of several outputs computes exactly those that name it in the table."""
    given = {"height": 60.0, "stiffness": 4e-3, "poisson": 0.3, "width": 0.5, "push_height": 0.5}
    axes = make_axes(given | dict.fromkeys(INTERFACE, 0))
    request = Request(axes, tuple(table.OUTPUTS))
    for function in {output.function for output in table.OUTPUTS.values()}:
        names = {name for name, output in table.OUTPUTS.items() if output.function is function}
        values = function(request, request.columns(()))
        found = values if isinstance(values, dict) else dict.fromkeys(names, values)
        assert set(found) == names
        assert isinstance(values, dict) or len(names) == 1
        assert all(one.shape == (1,) for one in found.values())
    for members in table.SETS.values():
        assert set(members) <= set(table.OUTPUTS)
    everything = {*SLIDER, *INTERFACE}
    assert "dlength_dprestress" in table.choose("gradients", everything)
    assert "dlength_dprestress" not in table.choose("gradients", {"height", "stiffness", "poisson"})
    assert "dlength_dresidual_strength" not in table.choose("gradients", everything - {"residual_strength"})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"height": [25.0, 0.5]}, r"Slider.height = 0.5 at index 1: must exceed 1"),
        ({"stiffness": [[0.1]]}, r"stiffness has shape \(1, 1\): must be a number or a one-dimensional array"),
        ({"stiffness": []}, r"stiffness has shape \(0,\)"),
        ({"prestress": 1.5}, "Interface.prestress = 1.5"),
        ({"outputs": "lenght"}, "output 'lenght': must be one of length,"),
        ({"outputs": ()}, "at least one output"),
        ({"prestress": 0.1, "outputs": "length_eq25"}, "'length_eq25' takes no account of prestress"),
        ({"outputs": "smooth_length"}, "needs width"),
        ({"outputs": "dlength_dprestress"}, "needs prestress: give it, 0 for instance"),
        ({"residual_strength": [0.5, 1.0]}, r"Interface.residual_strength = 1 at index 1: must lie in \[0, 1\)"),
        ({"residual_strength": 0.1, "outputs": "length_eq25"}, "'length_eq25' takes no account of residual_strength"),
        ({"prestress": 0.1, "outputs": "dlength_dresidual_strength"}, "needs residual_strength: give it, 0 for instance"),
        (
            {"threshold_slope": 0.001, "residual_strength": 0.2, "outputs": "exact_status"},
            "'exact_status' takes threshold_slope or residual_strength, not both: ask for length and status",
        ),
        ({"outputs": "exact_length", "right": "free", "sites": 100}, "'exact_length' is for a semi-infinite chain"),
        ({"right": "free"}, "needs a length"),
        ({"points": True}, "points are given as arrays of one length, got no array"),
        ({"points": True, "height": [10.0, 20.0], "stiffness": [0.1]}, "arrays of one length"),
        ({"chunk": 0}, "chunk = 0"),
        ({"share": (2, 2)}, "share 2 of 2: shares count from 0"),
        ({"share": (0, 2)}, "give it a store"),
        ({"share": (0, 2), "client": object()}, "share is for processes without a scheduler"),
        ({"lazy": True, "store": "s"}, "lazy = True takes no store and no client"),
    ],
)
def test_refusals_come_before_any_work(given, message, monkeypatch):
    monkeypatch.setattr("slippulse_jax.sweeps.run.evaluate", None)
    with pytest.raises(ValueError, match=message):
        sp.sweep(**{"height": 25.0, "stiffness": 0.03, "poisson": 0.3, **given})


@pytest.mark.parametrize("client", [7, ["tcp://node0:8786"], ThreadPoolExecutor(1), sp.sweep])
def test_what_is_no_client_is_named(client):
    with pytest.raises(TypeError, match=r"client is \w+: must be a distributed.Client, or an address"):
        sp.sweep(height=[10.0, 20.0], stiffness=0.03, poisson=0.3, client=client)


def test_an_address_is_taken_for_the_client_that_it_leads_to(monkeypatch):
    asked = []
    monkeypatch.setattr(run, "connected", lambda address: nullcontext(asked.append(address)))
    found = sp.sweep(height=[10.0, 20.0], stiffness=0.03, poisson=0.3, outputs="length", client="tcp://node0:8786")
    assert asked == ["tcp://node0:8786"]
    assert found.length.shape == (2,)


def test_a_sweep_with_a_client_shows_a_bar(monkeypatch, capsys):
    monkeypatch.setattr(run, "_on_workers", lambda client, compute, chunks: map(compute, chunks))
    chunks = [(slice(0, 4),), (slice(4, 8),)]
    assert len(list(run._run(lambda region: (region, {}, set()), chunks, object(), True))) == 2
    assert "sweep: 100%" in capsys.readouterr().err


def test_request_of_a_hundred_million_points_is_small():
    given = {
        "height": np.linspace(10, 50, 1000),
        "stiffness": np.geomspace(1e-3, 0.03, 1000),
        "poisson": np.linspace(0.1, 0.45, 100),
    }
    request = Request(make_axes(given), ("length",))
    assert math.prod(request.shape) == 10**8
    columns = request.columns((slice(987, 988), slice(653, 655), slice(30, 33)))
    np.testing.assert_array_equal(columns["poisson"], np.tile(given["poisson"][30:33], 2))
    np.testing.assert_array_equal(columns["stiffness"], np.repeat(given["stiffness"][653:655], 3))
    assert (columns["height"] == given["height"][987]).all()
    assert len(json.dumps(request.describe())) < 1000


def test_pictures():
    lines = sp.sweep(**AXES, outputs="length")
    ax = Figure().subplots()
    assert plot.sweep(lines, ax=ax) is ax
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["10", "25", "50"]
    assert ax.get_xscale() == "log"
    assert ax.get_ylabel() == r"precursor length, $\ell/\lambda_c$"
    map_of = sp.sweep(height=np.linspace(10, 50, 9), stiffness=np.linspace(0.01, 0.05, 10), poisson=0.3, outputs="length")
    ax = Figure().subplots()
    plot.sweep(map_of, ax=ax)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("height, $H/\\lambda_c$", "contact stiffness, $k/K$")
    assert ax.get_title() == "$\\nu$ = 0.3"
    with pytest.raises(ValueError, match=r"one or two axes of several values, not 0 \(none\): sweep several"):
        plot.sweep(map_of.isel(height=0, stiffness=0))
    cube = map_of[["length"]].expand_dims(prestress=[1 / 3, 0.5])
    with pytest.raises(
        ValueError, match=r"not 3 \(prestress, .*\): select one value of the others first, such as \.sel"
    ) as refused:
        plot.sweep(cube)
    selected = eval(f"cube{str(refused.value).partition('such as ')[2]}", {"cube": cube})
    assert plot.sweep(selected, ax=Figure().subplots()).get_title().endswith("$\\varphi/\\sigma_s$ = 0.3333")
    with pytest.raises(ValueError, match=r"not 1 \(point\): leave out points=True"):
        plot.sweep(map_of.stack(point=["height", "stiffness"]))
    assert map_of.length.sel(height=20).plot()


def test_one_output_of_a_sweep_is_drawn_alone():
    """As xarray's users select it: ``found.length``, with the values of the axes that it was selected at."""
    found = sp.sweep(height=[10.0, 20.0, 30.0], stiffness=[0.02, 0.03], poisson=[0.2, 0.3], outputs="length")
    chosen = found.sel(poisson=0.3)
    alone, whole = (plot.sweep(one, ax=Figure().subplots()) for one in (chosen.length, chosen))
    for own, other in zip(alone.lines, whole.lines, strict=True):
        np.testing.assert_array_equal(own.get_xydata(), other.get_xydata())
    assert (alone.get_ylabel(), alone.get_title()) == (whole.get_ylabel(), whole.get_title())
    assert alone.lines


@pytest.mark.slow
def test_pictures_mark_where_the_edge_breaks_again():
    """The dashed part of a line begins at its last point before; maps are hatched. Sweeps without a status are not marked."""
    stiffness = np.geomspace(0.01, 0.3, 12)
    found = sp.sweep(height=[10.0, 25.0], stiffness=stiffness, poisson=0.3, outputs=("length", "status"))
    ax = Figure().subplots()
    plot.sweep(found, ax=ax)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["10", "25", "edge breaks\nagain"]
    (dashed,) = (line for line in ax.lines if line.get_linestyle() == "--")
    first = np.flatnonzero(found.status.sel(height=25) == Outcome.REBREAK)[0]
    assert np.flatnonzero(np.isfinite(dashed.get_ydata()))[0] == first - 1
    over = sp.sweep(height=np.linspace(10, 50, 9), stiffness=stiffness, poisson=0.3, outputs=("exact_length", "exact_status"))
    ax = Figure().subplots()
    plot.sweep(over, ax=ax)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["edge breaks again"]
    ax = Figure().subplots()
    plot.sweep(over[["exact_length"]], ax=ax)
    assert ax.get_legend() is None


def test_numbers_of_the_slider():
    found = sp.sweep(**AXES, outputs=("b", "slow_decay_length"))
    slider = sp.Slider(25.0, 0.01, 0.3)
    assert float(found.b.sel(height=25, stiffness=0.01)) == pytest.approx(float(slider.b), rel=1e-14)
    assert float(found.slow_decay_length.sel(height=25, stiffness=0.01)) == pytest.approx(1 / float(slider.kappa_2), rel=1e-13)


@pytest.mark.ci
def test_an_interface_gives_the_numbers_that_are_not_swept():
    axes = {"height": [10.0, 25.0], "stiffness": 0.03, "poisson": 0.3, "outputs": ["length", "status"]}
    fixed = sp.sweep(**axes, interface=sp.Interface(prestress=0.1, threshold_slope=0.002))
    assert fixed.identical(sp.sweep(**axes, prestress=0.1, threshold_slope=0.002))
    swept = sp.sweep(**axes, interface=sp.Interface(threshold_slope=0.002), prestress=[0.0, 0.1])
    np.testing.assert_array_equal(swept.length.sel(prestress=0.1), fixed.length)
    swept = sp.sweep(**axes, interface=sp.Interface(0.1, 0.002), residual_strength=[0.0, 0.2])
    np.testing.assert_allclose(swept.length.sel(residual_strength=0), fixed.length, rtol=1e-13)
    fixed = sp.sweep(**axes, interface=sp.Interface(0.1, 0.002, 0.2))
    np.testing.assert_array_equal(swept.length.sel(residual_strength=0.2), fixed.length)


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"interface": sp.Interface(0.1), "prestress": [0.0]}, ValueError, "prestress is given twice: in the interface and as"),
        ({"interface": sp.Interface(0, 0, 0.1), "residual_strength": 0.2}, ValueError, "residual_strength is given twice"),
        ({"interface": sp.Interface([0.1, 0.2])}, ValueError, r"interface has shape \(2,\): must be one"),
        ({"interface": sp.Profile([1.0, 1.1])}, TypeError, "for the Profile of one slider use"),
    ],
)
def test_an_interface_that_does_not_fit_is_refused(given, error, message):
    with pytest.raises(error, match=message):
        sp.sweep(height=10.0, stiffness=0.03, poisson=0.3, **given)


@pytest.mark.slow
@pytest.mark.parametrize("pushes", [[0.25, 0.7], [0.3, 0.5]])
def test_blocks_over_the_height_of_the_push(pushes):
    """Short blocks contact by contact, tall ones from coarser contacts, one whose event passes the first contacts looked at."""
    heights = [60.0, 250.0, 900.0]
    given = {"height": heights, "stiffness": 4e-3, "poisson": 0.3, "push_height": pushes, "prestress": 0.1}
    found = sp.sweep(**given, outputs=("block_precursor_length", "exact_length"))
    assert found.block_precursor_length.dims == ("height", "push_height")
    interface = sp.Interface(prestress=0.1)
    with jax.enable_x64(True):
        for h in heights:
            for at in pushes:
                alone = float(sp.precursor_length(sp.Block(h, 4e-3, 0.3, sp.Push(at)), interface, event="full"))
                assert float(found.block_precursor_length.sel(height=h, push_height=at)) == pytest.approx(alone, rel=1e-9)


@pytest.mark.slow
def test_blocks_pushed_by_a_force_on_a_patch():
    found = sp.sweep(height=60.0, stiffness=4e-3, poisson=0.3, push_height=0.5, push_width=[0.1, 0.2], push_control="force",
                     outputs="block_precursor_length")  # fmt: skip
    block = sp.Block(60.0, 4e-3, 0.3, sp.Push(0.5, 0.2, "force"))
    with jax.enable_x64(True):
        assert float(found.block_precursor_length[1]) == pytest.approx(
            float(sp.precursor_length(block, event="full")), rel=1e-9
        )


@pytest.mark.ci
def test_blocks_do_not_depend_on_their_company(tmp_path):
    given = {"height": [40.0, 60.0, 80.0], "stiffness": 4e-3, "poisson": 0.3, "push_height": [0.25, 0.5]}
    whole = sp.sweep(**given, outputs="block_precursor_length")
    stored = sp.sweep(**given, outputs="block_precursor_length", store=tmp_path / "store", chunk=1)
    np.testing.assert_array_equal(stored.block_precursor_length, whole.block_precursor_length)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "'block_precursor_length' needs push_height"),
        ({"push_height": 1.2}, "push_height = 1.2: must lie in"),
        ({"push_height": [0.5, 0.1], "push_width": [0.1, 0.3]}, "Push.width = 0.3 about height = 0.1: reaches from -0.05"),
        ({"friction": 0.3}, "friction describes a block: give push_height too"),
        ({"push_height": 0.5, "friction": -0.1}, "friction = -0.1: must be 0 or more"),
        ({"push_height": 0.5, "contact_law": "multicontact"}, "contact_law = 'multicontact': .* give friction too"),
        ({"push_height": 0.5, "push_control": "speed"}, "Push.control = 'speed'"),
        ({"push_height": 0.5, "outputs": "length"}, "no output takes account of push_height: ask for block_precursor_length"),
        ({"push_height": 0.5, "right": "free", "sites": 90}, "is for a semi-infinite chain"),
    ],
)
def test_blocks_that_cannot_be_swept(given, message):
    with pytest.raises(ValueError, match=message):
        sp.sweep(**{"height": 25.0, "stiffness": 0.03, "poisson": 0.3, "outputs": "block_precursor_length", **given})
