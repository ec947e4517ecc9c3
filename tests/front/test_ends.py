"""Finite blocks and drives that give way: the recursion, against chains solved as matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import SITES, ended, long_series
from oracles import dense_chain

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.events.series import Spring
from slippulse_jax.front.front import front_fields
from slippulse_jax.lengths import arrests

MACHINES = (0.1, 1.0, 10.0, 1e3)
FIG2 = sp.Slider(25.0, 0.03, 0.3)


@pytest.mark.ci
@pytest.mark.parametrize("right", ["free", "clamped", "semi-infinite"])
def test_against_dense_chains(right):
    """Count, length, load, edge stress and outcome for every machine, on chains of 20 to 400 sites and on endless ones."""
    rng = np.random.default_rng(7)
    n = 24
    sliders = sp.Slider(rng.uniform(3, 60, n), 10 ** rng.uniform(-3.5, -0.5, n), rng.uniform(0, 0.49, n))
    sites = rng.choice([20, 60, 160, 400], n, p=[0.3, 0.3, 0.3, 0.1])
    machine = np.resize(MACHINES, n)
    sliders = ended(sliders, sites, right, machine)
    got = arrests(sliders)
    with jax.enable_x64(True):
        load = jax.vmap(lambda slider: lattice_modes(slider).load)(jax.tree.map(jnp.asarray, sliders))
    for i, slider in enumerate(zip(sliders.height, sliders.stiffness, sliders.poisson, strict=True)):
        many = 140 if right == "semi-infinite" else int(sites[i])
        count, length, U0, behind = dense_chain.first_precursor(*slider, many, right, machine[i])
        assert got.contacts_broken[i] == count, slider
        assert load[i] == pytest.approx(U0, rel=1e-9)
        if behind is None:
            assert got.status[i] == Outcome.RAN_THROUGH
            assert np.isinf(got.length[i])
            continue
        assert abs(got.length[i] - length) <= 1e-9, slider
        if count > 1:
            assert abs(got.edge_stress[i] - behind[0]) <= 1e-9
    if right != "semi-infinite":
        in_bulk = sp.precursor_lengths(sliders)
        np.testing.assert_allclose(in_bulk, got.length, rtol=1e-9)
    assert (got.status == Outcome.ARRESTED).any()
    if right == "free":
        assert (got.status == Outcome.RAN_THROUGH).any()


def test_a_machine_of_infinite_stiffness_imposes_the_displacement():
    """The same bits as without one, also where some lanes of a batch have a machine."""
    assert float(sp.precursor_length(ended(FIG2, machine=np.inf))) == float(sp.precursor_length(FIG2))
    with jax.enable_x64(True):
        rigid, none = lattice_modes(ended(FIG2, machine=np.inf)), lattice_modes(FIG2)
    for a, b in zip(jax.tree.leaves(rigid), jax.tree.leaves(none), strict=True):
        np.testing.assert_array_equal(a, b)
    lengths = sp.precursor_lengths(ended(FIG2, machine=[np.inf, 1e3, 30.0, 3.0]))
    assert (np.diff(lengths) > 0).all(), "the softer the drive, the longer the front"
    assert lengths[0] == pytest.approx(float(sp.precursor_lengths(FIG2)), rel=1e-14)


@pytest.mark.ci
@pytest.mark.parametrize("right", ["free", pytest.param("clamped", marks=pytest.mark.slow)])
def test_bulk_lengths_on_prestressed_interfaces_with_gradients(right):
    """The loop over lanes against the general recursion, beyond run-away too, where an end decides what becomes of the front."""
    rng = np.random.default_rng(3)
    n = 400
    sliders = sp.Slider(rng.uniform(3, 60, n), 10 ** rng.uniform(-3.5, -0.5, n), rng.uniform(0, 0.49, n))
    interface = sp.Interface(rng.choice([0, 0.3, 0.7], n), rng.choice([0, -1e-3, 1e-3], n))
    ends = {"sites": rng.uniform(20, 200, n), "machine": 10 ** rng.uniform(-1, 3, n)}
    general = arrests(ended(sliders, right=right, **ends), interface)
    length = sp.precursor_lengths(ended(sliders, right=right, **ends), interface)
    np.testing.assert_allclose(length, general.length, rtol=1e-9, atol=1e-10)
    assert np.isin([Outcome.ARRESTED, Outcome.RAN_THROUGH, Outcome.NO_DOMINO], general.status).all()
    endless = sp.precursor_lengths(ended(sliders, machine=ends["machine"]), interface)
    expected = arrests(ended(sliders, machine=ends["machine"]), interface).length
    np.testing.assert_allclose(endless, expected, rtol=1e-9, atol=1e-10)


@pytest.mark.ci
def test_fields_under_a_drive_are_those_of_the_chain_with_that_spring():
    """Nucleation and arrest, against the dense program; and the force of the drive is what its spring transmits."""
    sites, machine = 60, 10.0
    with jax.enable_x64(True):
        front = sp.first_precursor(ended(FIG2, sites, "clamped", machine=machine))
        assert front.stress.shape == (sites,)
        every = [(front_fields(front.body, position=s, sites=sites), jnp.where(jnp.arange(sites) < s, front.front_stress, 0))
                 for s in (0, front.contacts_broken)]  # fmt: skip
    dense = dense_chain.DenseChain.uniform((25.0, 0.03, 0.3), np.ones(sites), 0.0, "clamped", spring=machine)
    for fields, pinning in every:
        upper, layer = dense.at(np.asarray(pinning), float(front.load)).fields()
        np.testing.assert_allclose(fields.upper, upper, atol=1e-10)
        np.testing.assert_allclose(fields.layer, layer, atol=1e-10)
    assert dense.at(np.zeros(sites), float(front.load)).stress()[0] == pytest.approx(1, rel=1e-12)


@pytest.mark.ci
def test_the_machine_stays_while_the_front_runs():
    """The first event of a series under the same spring breaks the same contacts."""
    with jax.enable_x64(True):
        event = long_series(sp.chain(ended(FIG2, SITES)), Spring(10.0))
        front = sp.first_precursor(ended(FIG2, SITES, machine=10.0))
    assert int(event.extent[0]) == int(front.contacts_broken)


@pytest.mark.slow
@pytest.mark.parametrize("right", [pytest.param("free", marks=pytest.mark.slow), "clamped"])
def test_derivatives_in_the_number_of_sites_and_the_machine(right):
    """Against central differences, by the traced length and in bulk; both are smooth between whole counts."""
    with jax.enable_x64(True):

        def length(numbers):
            height, stiffness, poisson, sites, machine = numbers
            return sp.precursor_length(ended(sp.Slider(height, stiffness, poisson), sites, right, machine=machine))

        at = jnp.array([25.0, 0.03, 0.3, 90.3, 20.0])
        slope = jax.jit(jax.jacfwd(length))(at)
        step = 1e-5 * at
        moved = at[None] + jnp.concatenate([jnp.diag(step), -jnp.diag(step)])
        up, down = jax.jit(jax.vmap(length))(moved).reshape(2, -1)
    np.testing.assert_allclose(slope, (up - down) / (2 * step), rtol=1e-6, atol=1e-9)
    found = sp.precursor_lengths(ended(sp.Slider(*at[:3]), at[3], right, machine=at[4]), derivatives=1)
    np.testing.assert_allclose(jax.tree.leaves(found.slider), slope, rtol=1e-9)


@pytest.mark.ci
def test_the_formulas_hold_between_whole_numbers_of_sites():
    """At whole N they are the chain's, and in between the length is continuous while the front stops well before the end."""
    sites = np.linspace(70, 74, 401)
    length = sp.precursor_lengths(ended(FIG2, sites))
    whole = [float(sp.precursor_length(ended(FIG2, n))) for n in range(70, 75)]
    np.testing.assert_allclose(length[::100], whole, rtol=1e-6)
    assert np.abs(np.diff(length)).max() < 0.02 * (length.max() - length.min()), "no jump"
    contacts = ended(FIG2, np.array([9.5, 9.51, 10.0, 10.5])).sites
    assert contacts is not None
    assert contacts.tolist() == [9, 10, 10, 10]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"machine": 0.0}, "Slider.machine = 0: must be positive"),
        ({"machine": [3.0, -1.0]}, r"Slider.machine = -1 at index 1: must be positive"),
        ({"length": [30.0, np.nan]}, r"Slider.length = nan at index 1: at least two"),
        ({"length": 1.9}, "Slider.length = 1.9: at least two"),
        ({"length": 30.0, "right": "semi-infinite"}, "right = 'semi-infinite': a slider with this end has no length"),
        ({"right": "clamped"}, "right = 'clamped': a slider with this end needs a length"),
        ({"length": 30.0, "right": "open"}, "right = 'open': must be one of 'semi-infinite', 'free', 'clamped'"),
        ({"length": [30.0, 40.0, 50.0], "machine": [1.0, 2.0]}, r"length \(3,\), machine \(2,\)"),
    ],
)
def test_bad_ends_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        sp.Slider(25.0, 0.03, 0.3, **options)


@pytest.mark.parametrize("end", [{"length": 60}, {"machine": 3.0}])
@pytest.mark.parametrize(
    ("owner", "door"),
    [
        ("exact_length", sp.exact_length),
        ("exact_lengths", sp.exact_lengths),
        ("exact_front", sp.exact_front),
        ("sensitivity", lambda slider: sp.sensitivity(slider, sites=60)),
        ("this formula", sp.theory.length_eq25),
        ("this formula", sp.theory.length_continuum),
    ],
)
def test_formulas_of_endless_sliders_refuse_one_that_ends(owner, door, end):
    with pytest.raises(ValueError, match=rf"Slider\.{[*end][0]} = .*: {owner} is of semi-infinite sliders"):
        door(sp.Slider(25.0, 0.03, 0.3, **end))
