"""A block under two-dimensional elasticity: against a sparse finite-element program, closed forms, and the slider as a waveguide."""

import functools
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import ended
from oracles.dense_chain import crossing
from oracles.finite_elements import WholeBlock, break_all, events_of, rectangle
from scipy.optimize import brentq

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.blocks import elements, size
from slippulse_jax.blocks import event as blocks
from slippulse_jax.blocks import guide as waveguide
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.events import series
from slippulse_jax.events.first import Relaxed, first_event, length_of, record, smooth_length
from slippulse_jax.events.series import Adiabatic, Loading, Spring, Steps, of_contacts

PUSHES = [sp.Push(0.25), sp.Push(0.4, 0.2), sp.Push(0.4, 0.2, "force"), sp.Push()]
NAMES = ["top", "patch", "force", "side"]
EACH = [
    pytest.param(push, id=name, marks=[] if name == "patch" else pytest.mark.slow)
    for push, name in zip(PUSHES, NAMES, strict=True)
]
KINDS = ["domino", "full"]


def at_b(height, b, push, poisson=0.3, **more):
    return sp.Block(height, b / (2 * (1 + poisson) * height), poisson, push, **more)


@functools.partial(jax.jit, static_argnums=1)
def response(block, sites):
    return waveguide.response(blocks.guide_of(block), block.stiffness, sites)


# --- the slider is the case n = 2 ---------------------------------------------------------------------------------------


def slider_guide(slider, length=None):
    """Columns (u_t, u) of the middles of the bonds: a slab is a site, with half a bond on either side of it."""
    K_L, K_T, one = (jnp.asarray(x) for x in (slider.K_L, slider.K_T, 1.0))
    half, across = 2 * jnp.diag(jnp.stack([K_L, one])), K_T * jnp.array([[1.0, -1.0], [-1.0, 1.0]])
    site = jnp.linalg.inv(2 * half + across)
    passed, reading = half @ site @ half, (site @ half)[1:]
    slab = waveguide.Slab(half - passed, -passed, half - passed, reading, reading, site[1:, 1:])
    first = waveguide.Slab(half + across, -half, half, jnp.array([[0.0, 1.0]]), jnp.zeros((1, 2)), jnp.zeros((1, 1)))
    edge = waveguide.edge(jax.tree.map(lambda x: x[None], first), jnp.array([1.0, 0.0]), jnp.zeros(2))
    springs = 1 / jnp.asarray(slider.stiffness).reshape(1, 1), jnp.ones((1, 1))
    return waveguide.guide(edge, slab, (springs, springs), (0, 1), length)


@jax.jit
def slider_as_a_waveguide(slider):
    """Its response at 80 contacts, its modes with the edge driven, and the first event."""
    found, modes = waveguide.response(slider_guide(slider), slider.stiffness, 80), lattice_modes(slider)
    driven = jax.vmap(modes.profile)(jnp.arange(80.0)) @ modes.drive / modes.load
    return found, modes, driven, first_event(Relaxed(found, jnp.ones(80), jnp.zeros(80)))


@pytest.mark.ci
@pytest.mark.parametrize(
    ("height", "stiffness", "count", "length"),
    [
        (25, 0.03, 26, 25.789),
        *(
            pytest.param(*one, marks=pytest.mark.ci)
            for one in ((10, 0.03, 10, 9.724), (50, 0.03, 52, 51.392), (25, 0.01, 22, 21.637), (25, 0.003, 16, 15.023))
        ),
    ],
)
def test_the_slider_is_a_waveguide_of_two_freedoms(height, stiffness, count, length):
    slider = sp.Slider(float(height), stiffness, 0.3)
    found, modes, driven, (ended, start) = slider_as_a_waveguide(slider)
    np.testing.assert_allclose(found.push[0], driven, rtol=0, atol=1e-12)
    assert int(start.first) == 0
    assert float(start.load) == pytest.approx(float(modes.load), rel=1e-13)
    assert int(ended.broken.sum()) == int(ended.breaks) == count
    stress, overload = ended.stress, ended.overload
    line = count - 1 + overload[count - 1] / (overload[count - 1] - stress[count] + 1)
    assert float(ended.length(stress - 1, 79)) == pytest.approx(float(line), rel=1e-14)
    reached = float(ended.length(stress - 1, 79, alike=True))
    assert reached == pytest.approx(crossing(np.append(overload[:count], stress[count] - 1)), rel=1e-12)
    assert reached == pytest.approx(float(sp.precursor_length(slider)), abs=1e-9)
    assert reached == pytest.approx(length, abs=6e-4)


# --- an independent program ---------------------------------------------------------------------------------------------


@pytest.mark.ci
def test_element_is_that_of_closed_integrals():
    for width, height, poisson in [(0.5, 0.7, 0.3), (0.5, 40.0, 0.0), (0.5, 0.05, -0.4), (1.0, 1.0, 0.49)]:
        found = elements.element(width, jnp.asarray(height), jnp.asarray(poisson))
        np.testing.assert_allclose(found, rectangle(width, height, poisson), atol=1e-13 * max(height, 1 / height))


def whole(block, contacts, reach=None):
    displaced, force = (np.zeros(2 * elements.heights(block).size) for _ in range(2))
    kept = elements.freedoms(block, displaced.size // 2)
    displaced[kept], force[kept] = map(np.asarray, elements.loaded(block))
    normal = None if block.normal_stiffness is None else float(block.normal_stiffness)
    nu, young = map(float, block.plane_constants)
    corner, other = elements.widths()
    found = WholeBlock(
        np.asarray(elements.heights(block)), [corner] + [other] * (contacts - 1), float(block.stiffness) / young, nu,
        displaced[0::2] > 0, force[0::2] if block.push.control == "force" else None, reach, normal, block.top,
    )  # fmt: skip
    if block.push.control == "force":
        found.push, found.push_across = found.push / young, found.push_across / young
    return found


@pytest.mark.ci
@pytest.mark.parametrize("push", EACH)
def test_response_is_that_of_a_long_block(push):
    """The long block ends at 40 H, where nothing of the push is left."""
    block = sp.Block(4.0, 0.08, 0.3, push)
    dense = whole(block, 160, reach=48)
    found = response(block, 48)
    np.testing.assert_allclose(found.push[0], dense.push, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.matrix[:, 0], dense.matrix, rtol=0, atol=1e-10)
    for event in KINDS:
        order, stress, *_ = break_all(dense.push, dense.matrix, once=event == "domino")
        record = sp.first_precursor(block, sites=48, event=event)
        assert int(record.breaks) == len(order)
        assert int(record.first) == order[0]
        np.testing.assert_allclose(record.stress, stress, rtol=0, atol=1e-9)


@pytest.mark.ci
@pytest.mark.parametrize("blocks", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_random_blocks_break_in_the_same_order(blocks):
    rng = np.random.default_rng(7)
    for _ in range(blocks):
        height, poisson = rng.uniform(3, 5), rng.uniform(0, 0.45)
        push = [sp.Push(rng.uniform(0.1, 0.7)), sp.Push(rng.uniform(0.3, 0.7), rng.uniform(0.05, 0.3))][rng.integers(2)]
        block = at_b(height, np.exp(rng.uniform(np.log(0.3), np.log(20))), push, poisson)
        dense = whole(block, int(12 * height))
        found = response(block, 64)
        push, matrix = np.asarray(found.push[0]), np.asarray(found.matrix[:, 0])
        for event in KINDS:
            once = event == "domino"
            order, *_ = break_all(dense.push, dense.matrix, once)
            again, *_, length = break_all(push, matrix, once)
            assert again == order
            record = sp.first_precursor(block, sites=64, event=event)
            assert (int(record.breaks), int(record.contacts_broken)) == (len(order), len(set(order)))
            assert float(record.length) == pytest.approx(length, abs=1e-9)


@pytest.mark.ci
def test_the_curve_leaves_out_contacts_that_broke_before_those_to_their_left():
    """Contact 2 breaks third, or first: then its overload does not lie on the curve of those ahead of it."""
    lengths = []
    for b, first in ((0.7784, [1, 0, 2]), (0.7843, [2, 1, 0])):
        block = at_b(10.0, b, sp.Push(0.4, 0.2))
        found = response(block, 64)
        order, *_, length = break_all(np.asarray(found.push[0]), np.asarray(found.matrix[:, 0]), once=True)
        assert order == [*first, 3, 4, 5, 6]
        lengths.append(float(sp.precursor_length(block, sites=64)))
        assert lengths[-1] == pytest.approx(length, abs=1e-9)
    assert abs(np.diff(lengths)[0]) < 0.005


@pytest.mark.ci
def test_a_front_behind_which_a_contact_is_overloaded():
    """It breaks no contact twice, and says that the event goes farther."""
    block = at_b(20.0, 25.0, sp.Push(0.4, 0.2))
    dense = whole(block, 240, reach=64)
    (order, stress, *_), (every, *_) = (break_all(dense.push, dense.matrix, once) for once in (True, False))
    assert len(set(order)) == len(order) < len(set(every)) < len(every)
    assert stress[order].max() >= 1 > np.delete(stress, order).max()
    front, event = (sp.first_precursor(block, sites=64, event=kind) for kind in KINDS)
    np.testing.assert_allclose(front.stress, stress, rtol=0, atol=1e-7)  # of the end, at twelve heights
    assert (int(front.status), int(event.status)) == (Outcome.REBREAK, Outcome.ARRESTED)
    assert (int(front.breaks), int(front.contacts_broken)) == (len(order), len(order))
    assert (int(event.breaks), int(event.contacts_broken)) == (len(every), len(set(every)))
    assert float(front.length) < float(event.length)


@pytest.mark.ci
def test_plane_strain_is_plane_stress_of_other_constants():
    strain = sp.Block(4.0, 0.08, 0.25, sp.Push(0.3), plane="strain")
    dense = whole(strain, 160, reach=48)
    np.testing.assert_allclose(response(strain, 48).push[0], dense.push, atol=1e-10)


@pytest.mark.parametrize(
    ("push", "contacts"),
    [
        *(
            pytest.param(push, 160, id=name, marks=pytest.mark.ci if name == "force" else pytest.mark.slow)
            for push, name in zip(PUSHES, NAMES, strict=True)
        ),
        pytest.param(PUSHES[1], 14, id="ends"),
    ],
)
def test_an_interface_that_gives_way_across(push, contacts):
    """Springs under every point of the lower edge; plane strain, whose E differs; and with a free end."""
    more = {"plane": "strain"} if contacts == 160 and push is PUSHES[0] else {}
    block = sp.Block(4.0, 0.08, 0.3, push, length=None if contacts == 160 else contacts, normal_stiffness=0.7, **more)
    dense, count = whole(block, contacts, reach=48), min(contacts, 48)
    found = response(block, 48)
    np.testing.assert_allclose(found.push[0][:count], dense.push, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.matrix[:, 0][:count, :count], dense.matrix, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_a_stiff_interface_across_is_a_rigid_one():
    """And as it gives way, the front runs further."""
    rigid, stiff, equal = (
        float(sp.precursor_length(at_b(40.0, 0.3, sp.Push(0.25), normal_stiffness=ratio), sites=192))
        for ratio in (np.inf, 1e9, 1.0)
    )
    assert stiff == pytest.approx(rigid, rel=1e-6)
    assert 1.3 < equal / rigid < 2
    assert sp.Block(5.0, 0.1, 0.3, normal_stiffness=np.inf).normal_stiffness is None


@pytest.mark.slow
def test_derivative_in_the_normal_stiffness():
    def length(ratio):
        return sp.precursor_length(at_b(40.0, 0.3, sp.Push(0.25), normal_stiffness=ratio), sites=192)

    around = (float(length(10 + 1e-4)) - float(length(10 - 1e-4))) / 2e-4
    assert float(jax.grad(length)(10.0)) == pytest.approx(around, rel=1e-5)


# --- a block that ends --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("contacts", [5, 30])
def test_a_free_end_of_the_slider(contacts):
    """Against its modes, which a mirror reflects."""
    slider = sp.Slider(10.0, 0.03, 0.3)
    modes = lattice_modes(ended(slider, float(contacts)))
    driven = jax.vmap(modes.profile)(jnp.arange(float(contacts))) @ modes.drive / modes.load
    found = waveguide.response(slider_guide(slider, jnp.int32(contacts)), slider.stiffness, 64)
    np.testing.assert_allclose(found.push[0][:contacts], driven, rtol=0, atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("push", PUSHES, ids=NAMES)
def test_a_block_with_a_free_end(push):
    """Two contacts, and 2.5 and 6 heights; the sequence of breaks too, to the end where it runs through."""
    for contacts in (2, 10, 24):
        block = sp.Block(4.0, 0.08, 0.3, push, length=contacts)
        dense = whole(block, contacts)
        found = response(block, 64)
        # under a force nothing but contacts holds the block: rounding grows by what its elements are stiffer than they are
        np.testing.assert_allclose(
            found.push[0][:contacts], dense.push, rtol=1e-10 if push.control == "force" else 0, atol=1e-11
        )
        np.testing.assert_allclose(found.matrix[:, 0][:contacts, :contacts], dense.matrix, rtol=0, atol=1e-11)
        assert not found.push[0][contacts:].any()
        assert not found.matrix[:, 0][contacts:].any()
        for event in KINDS:
            order, stress, *_ = break_all(dense.push, dense.matrix, once=event == "domino")
            record = sp.first_precursor(block, event=event)
            assert (int(record.breaks), int(record.first)) == (len(order), order[0])
            assert (int(record.status) == Outcome.RAN_THROUGH) == (order[-1] == contacts - 1) == bool(jnp.isinf(record.length))
            np.testing.assert_allclose(record.stress, stress, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_fields_of_a_block_with_a_free_end():
    """What they pull at the contacts is what the pusher does; the mean of their lower edge is what the contacts read."""
    found = sp.first_precursor(at_b(6.0, 1.0, sp.Push(0.3), length=20))
    fields = blocks.fields(found.body, found.load, found.pinning)
    assert fields.horizontal.shape[0] == 21
    lower = np.asarray(fields.horizontal[:, 0])
    assert np.all(np.abs((lower[1:] + lower[:-1]) / 2 - found.stress - found.pinning)[1:] < 0.02)
    guide, k = blocks.guide_of(found.body), found.body.stiffness
    slab, x = guide.slab, waveguide.columns(guide, k, found.load, found.pinning)
    left, right = (jnp.outer(k * found.pinning, one[0]) for one in (slab.reading_left, slab.reading_right))
    pull = x[1:-2] @ slab.across + x[2:-1] @ (slab.right + slab.left) + x[3:] @ slab.across.T - right[1:-1] - left[2:]
    np.testing.assert_allclose(pull, 0, atol=1e-11)
    with pytest.raises(ValueError, match=r"pinning has shape \(8,\): the block has 20 contacts"):
        blocks.fields(found.body, found.load, jnp.zeros(8))


@pytest.mark.slow
def test_a_block_of_twelve_heights_is_as_good_as_endless():
    """And a shorter one has longer events, until they run through."""
    endless = float(sp.precursor_length(at_b(20.0, 1.0, sp.Push(0.4))))
    found = [float(sp.precursor_length(at_b(20.0, 1.0, sp.Push(0.4), length=n * 20))) for n in (12, 6, 4, 2)]
    assert found[0] == pytest.approx(endless, rel=1e-4)
    assert endless < found[0] < found[1] < found[2] < found[3] == np.inf


@pytest.mark.slow
def test_derivatives_of_a_block_that_ends():
    def length(x):
        return sp.precursor_length(sp.Block(x[0], x[1], x[2], sp.Push(x[3]), length=80), sites=128)

    at = jnp.array([20.0, 0.02, 0.3, 0.3])
    steps = np.diag(2e-4 * np.asarray(at))
    near, far = ([float(length(at + n * d) - length(at - n * d)) for d in steps] for n in (1, 2))
    around = (8 * np.array(near) - far) / (12 * steps.sum(axis=1))
    np.testing.assert_allclose(jax.grad(length)(at), around, rtol=1e-6)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("law", "event"),
    [
        ("multicontact", "domino"),
        *(
            pytest.param(*one, marks=pytest.mark.slow)
            for one in (("glued", "domino"), ("glued", "full"), ("amontons", "full"), ("ended", "full"))
        ),
    ],
)
def test_derivatives_back_are_those_forward(law, event):
    """The length goes back through its breaks; its record carries tangents through them. Both at a fixed order."""
    rubs = {} if law == "glued" else {"friction": 0.2, "contact_law": "multicontact" if law == "multicontact" else "amontons"}
    block = sp.Block(20.0, 0.02, 0.3, sp.Push(0.3, 0.2), length=60 if law == "ended" else None, **rubs)
    with jax.enable_x64(True):
        numbers, tree = jax.tree.flatten(jax.tree.map(lambda x: jnp.asarray(x) if isinstance(x, float) else x, block))
        interface = sp.Interface(0.02, 1e-4)

        def length(*numbers):
            return sp.precursor_length(jax.tree.unflatten(tree, numbers), interface, sites=64, event=event)

        def recorded(*numbers):
            return record(jax.tree.unflatten(tree, numbers), interface, 64, event).length

        which = tuple(i for i, x in enumerate(numbers) if jnp.issubdtype(jnp.asarray(x).dtype, jnp.floating))
        assert len(which) == 5 + 2 * bool(rubs)
        back, forward = jax.jit(jax.grad(length, which))(*numbers), jax.jit(jax.jacfwd(recorded, which))(*numbers)
        assert 3 < length(*numbers) < 60
        np.testing.assert_allclose(back, forward, rtol=1e-8)


@pytest.mark.slow
def test_an_event_without_a_length_has_no_derivative():
    """Where it runs through zero would be wrong; where no domino starts it is right."""

    def length(stiffness, **more):
        return sp.precursor_length(sp.Block(20.0, stiffness, 0.3, sp.Push(0.3), **more), sites=64)

    with jax.enable_x64(True):
        assert np.isnan(jax.grad(functools.partial(length, length=8))(0.02))
        assert float(length(1e-6)) == 0
        assert abs(float(jax.grad(length)(1e-6))) < 1e-6


@pytest.mark.slow
def test_derivative_in_every_threshold():
    """Of an event that begins inside and runs both ways: only contacts that broke and the next one matter."""
    rng = np.random.default_rng(3)
    threshold = 1 + 0.05 * rng.random(64)
    threshold[:4] += 0.3
    threshold[4:14] = 0.9 + 0.05 * rng.random(10)

    def length(theta):
        return sp.precursor_length(at_b(30.0, 1.0, sp.Push(0.4)), sp.Profile(threshold=theta), sites=64)

    with jax.enable_x64(True):
        found = sp.first_precursor(at_b(30.0, 1.0, sp.Push(0.4)), sp.Profile(threshold=threshold), sites=64)
        broken = np.flatnonzero(np.asarray(found.pinning))
        assert broken.min() < int(found.first) < broken.max()
        slopes = jax.grad(length)(jnp.asarray(threshold))
        around = [(length(threshold + d) - length(threshold - d)) / 2e-6 for d in 1e-6 * np.eye(64)[:24]]
    np.testing.assert_allclose(slopes[:24], around, rtol=1e-5, atol=1e-5)
    assert np.abs(np.asarray(slopes)).max() > 1
    assert not slopes[broken.max() + 2 :].any()


@pytest.mark.slow
def test_second_derivatives_of_a_block():
    def length(x):
        return sp.precursor_length(sp.Block(x[0], x[1], 0.3, sp.Push(x[2])), sites=64)

    with jax.enable_x64(True):
        at, slopes = jnp.array([20.0, 0.02, 0.3]), jax.jit(jax.grad(length))
        steps = 1e-5 * np.diag(np.asarray(at))
        around = [(slopes(at + d) - slopes(at - d)) / (2 * d.sum()) for d in steps]
        np.testing.assert_allclose(jax.hessian(length)(at), around, rtol=1e-4)


# --- closed forms -------------------------------------------------------------------------------------------------------


def strip(q, height, poisson):
    """Stiffness of a strip, shear stress over displacement of its lower edge, at wavenumber q; E = 1."""
    z = abs(q) * height
    s, c = np.sinh(z), np.cosh(z)
    return 2 * abs(q) * (s * c + z) / ((1 + poisson) ** 2 * z**2 + 4 + (3 - poisson) * (1 + poisson) * s**2)


@pytest.mark.ci
@pytest.mark.parametrize("reach", [1.0, *(pytest.param(x, marks=pytest.mark.ci) for x in (0.1, 5.0, 20.0, 100.0))])
def test_stiffness_of_a_strip_at_one_wavelength(reach):
    """The uniform tractions of patches are waves of q and all q + 2πn, whose compliances add; finer meshes come closer.

    At long waves rounding is all that is left.
    """
    height, poisson = 200.0, 0.3
    q = reach / height
    every = q + 2 * np.pi * np.arange(-3000, 3001)
    stiffness = np.where(np.abs(every) * height < 300, strip(np.clip(every, -300 / height, 300 / height), height, poisson),
                         2 * np.abs(every) / ((3 - poisson) * (1 + poisson)))  # fmt: skip
    compliance = (np.sinc(every / (2 * np.pi)) ** 2 / stiffness).sum()
    phase, off = np.exp(1j * q), []
    for finer in (0, 1):
        slab = jax.jit(elements.slabs, static_argnums=1)(sp.Block(height, 0.01, poisson, sp.Push()), finer)[1]
        D = np.asarray(slab.left + slab.right) + np.asarray(slab.across) * phase + np.asarray(slab.across).T / phase
        reading = np.asarray(slab.reading_left[0]) + np.asarray(slab.reading_right[0]) * phase
        found = (reading @ np.linalg.solve(D, reading.conj())).real + float(slab.own[0, 0])
        off.append(abs(compliance / found - 1))
    assert off[0] < (1e-5 if reach <= 1 else 2e-3)
    assert off[1] < max(off[0] / 3, 2e-7)


@pytest.mark.ci
@pytest.mark.parametrize("b", [0.1, *(pytest.param(b, marks=pytest.mark.slow) for b in (1.0, 10.0))])
def test_slow_decay_is_that_of_an_edge_load(b):
    """The first root of the strip's characteristic equation on the imaginary axis."""
    poisson = 0.3

    def characteristic(z):
        closed = 4 - (1 + poisson) ** 2 * z**2 - (3 - poisson) * (1 + poisson) * np.sin(z) ** 2
        return b * closed - 4 * (1 + poisson) * z * (np.sin(z) * np.cos(z) + z)

    slow = brentq(characteristic, 1e-3, 1.2)
    height = 400.0
    off = []
    for finer in (0, 1):
        transfer = jax.jit(lambda block, finer=finer: blocks.guide_of(block, finer).transfer)(at_b(height, b, sp.Push(0.3)))
        decay = np.abs(np.linalg.eigvals(np.asarray(transfer))).max()
        off.append(-np.log(decay) * height / slow - 1)
    assert abs(off[0]) < 1e-6
    assert abs(off[1]) < 1e-6


@pytest.mark.ci
def test_far_from_the_edge_a_uniform_shift_is_followed():
    """R sums to one along a row."""
    found = response(at_b(5.0, 2.0, sp.Push(0.3)), 256)
    np.testing.assert_allclose(found.matrix[:, 0][128].sum(), 1, atol=1e-6)
    np.testing.assert_allclose(found.matrix[:, 0], found.matrix[:, 0].T, atol=1e-13)


@pytest.mark.slow
def test_forces_are_in_balance_and_a_break_loses_its_energy():
    """The pusher's force is that of all contacts; a break at stress a loses k a² (1 + R_jj)/2."""
    block = at_b(4.0, 1.5, sp.Push(0.3))
    guide, k = blocks.guide_of(block), float(block.stiffness)
    load, pinning = 2.0, jnp.zeros(200).at[jnp.array([0, 3, 9])].set(jnp.array([1.0, 0.4, 0.2]))

    def state(pinning):
        x = waveguide.columns(guide, jnp.asarray(k), jnp.asarray(load), pinning)
        found = response(block, 200)
        stretch = load * found.push[0] + found.matrix[:, 0] @ pinning - pinning
        edge = guide.edge
        force = edge.left[0, 0] * load + edge.across[0] @ x[1] - k * edge.reading_left[0, 0] * pinning[0]
        return float(force), np.asarray(stretch)

    def energy(pinning):
        """By Clapeyron: half of what pusher and pinning points would do, brought there slowly."""
        force, stretch = state(pinning)
        return (float(load) * force - k * float(stretch @ pinning)) / 2

    force, stretch = state(pinning)
    assert force == pytest.approx(k * stretch.sum(), rel=1e-9)
    j, matrix = 5, np.asarray(response(block, 200).matrix[:, 0])
    lost = energy(pinning) - energy(pinning.at[j].add(stretch[j]))
    assert lost == pytest.approx(k * stretch[j] ** 2 * (1 + matrix[j, j]) / 2, rel=1e-8)


# --- in SI units --------------------------------------------------------------------------------------------------------

MATERIAL = {"height": 0.02, "correlation_length": 20e-6, "areal_stiffness": 1e10, "poisson": 0.3, "young": 3e9}


def test_from_material():
    """By hand; the push in m too."""
    block = sp.Block.from_material(
        **MATERIAL,
        push_height=5e-3,
        push_width=2e-3,
        push_control="force",
        plane="strain",
        length=0.05,
        normal_stiffness=3.0,
    )
    assert float(block.height) == pytest.approx(1000)
    assert float(block.stiffness) == pytest.approx(1e10 * 20e-6 / 3e9)
    assert (float(block.push.height), float(block.push.width)) == pytest.approx((0.25, 0.1))
    assert (block.push.control, block.plane) == ("force", "strain")
    assert jax.tree.leaves(block.slider) == jax.tree.leaves(sp.Slider.from_material(**MATERIAL))
    assert repr(block) == (
        "Block(height=1000, stiffness=6.66667e-05, poisson=0.3, "
        "push=Push(height=0.25, width=0.1, control='force'), plane='strain', length=2500, normal_stiffness=3)"
    )
    assert repr(sp.Block.from_material(**MATERIAL, push_height=5e-3).push) == "Push(height=0.25)"


# --- lengths ------------------------------------------------------------------------------------------------------------

TABLE = {
    "top 1/4": (sp.Push(0.25), {0.1: 0.398, 0.5: 0.654, 1: 0.788, 2: 0.902, 10: 0.963}),
    "top 1/2": (sp.Push(0.5), {0.1: 0.903, 0.5: 1.424, 1: 1.617, 2: 1.719, 10: 1.701}),
    "patch 1/4": (sp.Push(0.25, 0.1), {0.1: 0.275, 0.5: 0.393, 1: 0.462, 2: 0.529, 10: 0.572}),
    "patch 1/2": (sp.Push(0.5, 0.1), {0.1: 0.696, 0.5: 1.066, 1: 1.222, 2: 1.317, 10: 1.352}),
    "patch 3/4": (sp.Push(0.75, 0.1), {0.1: 1.366, 0.5: 1.964, 1: 2.106, 2: 2.131, 10: 2.078}),
    "force 1/4": (sp.Push(0.25, 0.1, "force"), {0.1: 0.704, 0.5: 0.788, 1: 0.794, 2: 0.774, 10: 0.734}),
}
INSIDE = (
    {("patch 1/4", b) for b in (0.1, 0.5, 1, 2, 10)} | {("force 1/4", b) for b in (0.1, 0.5, 1, 2, 10)} | {("patch 1/2", 10)}
)


@pytest.mark.ci
@pytest.mark.parametrize("name", TABLE)
def test_lengths_of_a_separate_program(name):
    """H/λc = 100, ν = 0.3, ℓ/H to its mesh, which is short; and where the event begins, and whether contacts break again."""
    push, lengths = TABLE[name]
    for b, expected in lengths.items():
        found = sp.first_precursor(at_b(100.0, b, push), sites=320, event="full")
        assert 0.995 < float(found.length) / 100 / expected < 1.023
        assert (int(found.first) > 0) == ((name, b) in INSIDE)
        assert int(found.status) == Outcome.ARRESTED
        if b < 2:
            assert int(found.breaks) == int(found.contacts_broken)


@pytest.mark.ci
def test_a_side_displaced_as_a_whole_has_no_precursor():
    found = sp.first_precursor(at_b(100.0, 1.0, sp.Push()), sites=320)
    assert (int(found.status), float(found.length)) == (Outcome.NO_DOMINO, 0)
    assert 1 - float(found.stress_before[1]) == pytest.approx(1.9e-2, rel=0.1)  # a separate program, to its mesh
    assert "a side that is pushed as a whole" in str(found)


@pytest.mark.slow
def test_lengths_on_finer_meshes():
    """A mesh twice as fine lengthens an event by half a per cent or less, the next one by less than half of that."""
    block = at_b(60.0, 1.0, sp.Push(0.25))

    @functools.partial(jax.jit, static_argnums=1)
    def length(block, finer):
        found = waveguide.response(blocks.guide_of(block, finer), block.stiffness, 96)
        ended, *_ = first_event(Relaxed(found, jnp.ones(96), jnp.zeros(96)))
        return ended.length(ended.stress - 1, 95, alike=True)

    usual, twice, four = (float(length(block, finer)) for finer in (0, 1, 2))
    assert usual == pytest.approx(float(sp.precursor_length(block, sites=96)), rel=1e-12)
    assert 0 < twice / usual - 1 < 6e-3
    assert 0 < four / twice - 1 < (twice / usual - 1) / 2


@pytest.mark.slow
def test_lengths_do_not_depend_on_the_contacts_resolved():
    block = at_b(30.0, 1.0, sp.Push(0.4))
    few, many = (float(sp.precursor_length(block, sites=n)) for n in (96, 192))
    assert few == pytest.approx(many, rel=1e-12)
    assert float(sp.precursor_length(block)) == pytest.approx(many, rel=1e-12)


@pytest.mark.slow
def test_too_few_contacts_resolved_are_said():
    """A block that goes on has a length, which is not known; one that ends has none, and no warning."""
    block = at_b(30.0, 1.0, sp.Push(0.4))
    said = "sites = 8: the event reached the last contact resolved"
    with pytest.warns(RuntimeWarning, match=said) as told:
        assert float(sp.precursor_length(block, sites=8)) == np.inf
    assert told[0].filename == __file__
    with pytest.warns(RuntimeWarning, match=said) as told:
        assert int(sp.first_precursor(block, sites=8).status) == Outcome.RAN_THROUGH
    assert told[0].filename == __file__
    assert float(jax.jit(lambda block: sp.precursor_length(block, sites=8))(block)) == np.inf
    ends = at_b(30.0, 1.0, sp.Push(0.4), length=8)
    assert float(sp.precursor_length(ends, sites=8)) == float(sp.precursor_length(ends)) == np.inf


@pytest.mark.slow
@pytest.mark.parametrize("push", [sp.Push(0.3), sp.Push(0.4, 0.15)], ids=["top", "patch"])
def test_derivatives_at_a_fixed_order_of_breaks(push):
    numbers = [40.0, 0.01, 0.3, *(float(x) for x in (push.height, push.width) if x is not None)]

    def length(x):
        return sp.precursor_length(sp.Block(x[0], x[1], x[2], sp.Push(*x[3:])), sites=128)

    at = jnp.array(numbers)
    step = 1e-5 * np.array(numbers)
    around = [float(length(at + d) - length(at - d)) / (2 * d.sum()) for d in np.diag(step)]
    np.testing.assert_allclose(jax.grad(length)(at), around, rtol=2e-5)


# --- a smooth rule ------------------------------------------------------------------------------------------------------


@pytest.mark.ci
def test_a_smooth_front_on_the_slider_as_a_waveguide():
    """The block's sum over every contact, against the recursion of two modes."""
    slider, rule = sp.Slider(10.0, 0.03, 0.3), sp.SmoothBreak(0.02)
    found = waveguide.response(slider_guide(slider), slider.stiffness, 160)
    contacts = Relaxed(found, jnp.ones(160), jnp.zeros(160), jnp.asarray(0.03), 159, jnp.asarray(True))
    assert float(smooth_length(contacts, rule)) == pytest.approx(float(sp.precursor_length(slider, rule=rule)), rel=1e-9)


@pytest.mark.slow
def test_a_smooth_front_tends_to_the_hard_one():
    """And an interface counts: with a prestress it runs further."""
    block = at_b(40.0, 1.0, sp.Push(0.25))
    hard = float(sp.precursor_length(block, sites=128))
    off = [hard - float(sp.precursor_length(block, rule=sp.SmoothBreak(w), sites=128)) for w in (4e-3, 1e-3, 2.5e-4)]
    assert off[0] > 3 * off[1] > 9 * off[2] > 0
    assert off[2] < 0.05
    stressed = sp.precursor_length(block, sp.Interface(prestress=0.1), rule=sp.SmoothBreak(0.01), sites=128)
    assert float(stressed) > hard + 1


@pytest.mark.slow
@pytest.mark.parametrize("count", [11, 81])
def test_a_smooth_length_has_no_jumps(count):
    """Over pushes at which contacts behind the front break again in ever other orders, the hard one has."""

    def length(height, rule):
        event = "full" if rule is None else "domino"
        return sp.precursor_length(at_b(40.0, 10.0, sp.Push(height)), rule=rule, sites=128, event=event)

    def roughness(rule):
        one = jax.jit(lambda height: length(height, rule))
        return np.abs(np.diff([float(one(height)) for height in np.linspace(0.3, 0.4, 81)[:count]], 2)).max()

    rule = sp.SmoothBreak(0.03)
    assert roughness(None) > 0.03
    assert roughness(rule) < 1e-3
    around = (float(length(0.4 + 1e-5, rule)) - float(length(0.4 - 1e-5, rule))) / 2e-5
    assert float(jax.grad(length)(0.4, rule)) == pytest.approx(around, rel=1e-6)
    width = lambda w: sp.precursor_length(at_b(40.0, 10.0, sp.Push(0.4)), rule=sp.SmoothBreak(w), sites=128)  # noqa: E731
    around = (float(width(0.03 + 1e-7)) - float(width(0.03 - 1e-7))) / 2e-7
    assert float(jax.grad(width)(0.03)) == pytest.approx(around, rel=1e-5)


@pytest.mark.ci
def test_prestress_lengthens_and_a_threshold_decides():
    block = at_b(30.0, 1.0, sp.Push(0.4))
    plain, stressed = (sp.first_precursor(block, sp.Interface(prestress=p), sites=160) for p in (0.0, 0.15))
    assert float(stressed.length) > float(plain.length) + 1
    assert float(stressed.load) == pytest.approx(0.85 * float(plain.load), rel=1e-12)
    assert float(sp.precursor_length(block, sp.Interface(prestress=0.15))) == pytest.approx(float(stressed.length), rel=1e-12)
    threshold = np.ones(160)
    threshold[7] = 3.0  # no front passes it in its turn
    held = sp.first_precursor(block, sp.Profile(threshold=threshold), sites=160)
    assert float(held.stress[7]) > 1
    assert not held.pinning[7]
    assert float(sp.precursor_length(block, sp.Profile(threshold=threshold))) == pytest.approx(float(held.length), rel=1e-12)


@pytest.mark.ci
def test_fields_in_the_block_are_those_the_contacts_read():
    found = sp.first_precursor(at_b(12.0, 1.0, sp.Push(0.4)), sites=64)
    before, after = (blocks.fields(found.body, found.load, p) for p in (0 * found.pinning, found.pinning))
    assert after.horizontal.shape == (65, elements.heights(found.body).size)
    np.testing.assert_allclose(before.vertical[:, 0], 0, atol=0)
    displaced = np.insert(np.asarray(elements.loaded(found.body)[0]), 1, 0)[0::2] > 0
    np.testing.assert_allclose(after.horizontal[0, displaced], float(found.load), rtol=1e-12)
    # slip is what the lower edge moved, within a contact
    moved = np.asarray(after.horizontal - before.horizontal)[:, 0]
    assert np.all(np.abs((moved[1:] + moved[:-1]) / 2 - found.slip)[:40] < 0.2 * np.max(found.slip))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sp.Push(1.2), r"Push.height = 1.2: must lie in \(0, 1\)"),
        (lambda: sp.Push(0.9, 0.3), r"Push.width = 0.3 about height = 0.9: reaches from 0.75 to 1.05 H, beyond the side"),
        (lambda: sp.Push(width=0.1), r"Push.width is given without a height"),
        (lambda: sp.Push(0.3, control="speed"), r"Push.control = 'speed': must be one of 'displacement', 'force'"),
        (lambda: sp.Block([5.0, 6.0], 0.1, 0.3), r"Block.height has shape \(2,\): one block at a time"),
        (lambda: sp.Block(0.5, 0.1, 0.3), r"Block.height = 0.5: must exceed 1"),
        (
            lambda: sp.Block(5.0, 0.1, 0.3, normal_stiffness=0),
            r"Block.normal_stiffness = 0: must be positive: the normal stiff",
        ),
        (lambda: sp.Block(5.0, 0.1, 0.3, length=1), r"Block.length = 1: a block is at least two contacts long"),
        (lambda: sp.Block(5.0, 0.1, 0.3, length=8.5), r"Block.length = 8.5: must be a whole number of contacts"),
        (
            lambda: jax.grad(lambda x: sp.Block(x, 0.1, 0.3, length=3 * x).height)(5.0),
            r"Block.length is traced, and no integer",
        ),
        (
            lambda: sp.precursor_length(sp.Block(5.0, 0.1, 0.3, length=80), sites=64),
            r"sites = 64: a block of 80 contacts needs",
        ),
        (lambda: sp.precursor_length(sp.Block(5.0, 0.1, 0.3, length=9000)), r"reaches beyond 8192 contacts"),
        (lambda: sp.Block(5.0, 0.1, 0.5, plane="strain"), r"Block.poisson = 0.5: an incompressible block"),
        (
            lambda: sp.Block.from_material(**MATERIAL | {"young": 0}, push_height=5e-3),
            r"from_material: young = 0: Young's modulus must be pos",
        ),
        (
            lambda: sp.Block.from_material(**MATERIAL, push_height=-1),
            r"from_material: push_height = -1: must be positive, in m",
        ),
        (lambda: sp.Block.from_material(**MATERIAL, push_height=0.03), r"Push.height = 1.5: must lie in \(0, 1\)"),
        (lambda: sp.precursor_length(sp.Block(5.0, 0.1, 0.3), sites=1), r"sites = 1: must be a whole number"),
        pytest.param(
            lambda: sp.precursor_length(at_b(20.0, 1.0, sp.Push(0.25, 0.1)), rule=sp.SmoothBreak(0.01)),
            r"rule = SmoothBreak.*begins at",
            marks=pytest.mark.ci,
        ),
        (lambda: jax.jit(sp.precursor_length)(sp.Block(5.0, 0.1, 0.3)), r"under jit and vmap a body needs sites"),
        (lambda: sp.Block(5.0, 0.1, 0.3, sp.Push(0)), r"Push.height = 0: must lie in \(0, 1\)"),
        (
            lambda: sp.precursor_length(sp.Block(5.0, 0.1, 0.3), rule=sp.SmoothBreak(0.01), event="full"),
            r"event = 'full': under a smooth rule",
        ),
        (
            lambda: sp.precursor_length(sp.Block(5.0, 0.1, 0.3), event="whole"),
            r"event = 'whole': must be one of 'domino', 'full'",
        ),
    ],
)
def test_refusals(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# --- series of events ---------------------------------------------------------------------------------------------------


PROTOCOLS = [
    pytest.param(Adiabatic(), id="edge", marks=pytest.mark.slow),
    pytest.param(Spring(0.7), id="spring"),
    pytest.param(Steps(0.05), id="steps", marks=pytest.mark.slow),
]


@pytest.mark.ci
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_series_of_the_slider_as_a_waveguide(protocol):
    """Springs, forces and energies of contacts whose response is a matrix are those of the chain."""
    slider, sites = sp.Slider(10.0, 0.03, 0.3), 64
    expected = sp.series(sp.chain(slider, sites=sites), protocol, events=12)

    def as_waveguide(slider, protocol):
        guide, k = slider_guide(slider), jnp.asarray(slider.stiffness)
        one = jnp.ones(sites)
        body = Relaxed(waveguide.response(guide, k, sites), one, 0 * one, k, sites - 1, alike=True)
        loading = Loading(protocol, None, jnp.asarray(jnp.inf), jnp.array(True), jnp.int32(3000), jnp.int32(sites - 1))
        return of_contacts((12, 0, 0, sites), body, loading)

    found = jax.jit(as_waveguide)(slider, protocol)
    assert int(found.number) == int(expected.number) == 12
    for name in ("site", "leftmost", "extent", "breaks", "kind", "status"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in ("load", "force_before", "force_after", "length", "slip", "work", "stored", "broken", "relaxed"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-11, err_msg=name)
    np.testing.assert_allclose(found.state.pinning, expected.state.pinning, atol=1e-11)
    assert max(found.drift, found.energy_drift) < 1e-12


@pytest.mark.ci
def test_series_of_similar_blocks_share_a_program():
    """However long the blocks, up to the next power of two; each with as many pinning points as it has contacts."""
    block = sp.Block(12.0, 0.03, 0.3, sp.Push(0.25, 0.1), length=40, friction=0.3)
    sp.series(block, events=4)
    programs = series._hard_series._cache_size()
    longer = sp.series(eqx.tree_at(lambda x: x.length, block, np.int32(57)), events=4)
    endless = sp.series(eqx.tree_at(lambda x: x.length, block, None), events=4, sites=57)
    assert series._hard_series._cache_size() == programs + 1  # the one without end
    assert longer.state.pinning.shape == endless.state.pinning.shape == (57,)
    mapped = jax.vmap(lambda push: sp.series(eqx.tree_at(lambda x: x.push.height, block, push), events=4))(
        np.array([0.25, 0.3])
    )
    assert mapped.state.pinning.shape == (2, 40)


@pytest.mark.ci
@pytest.mark.parametrize("machine", [0.05, 0.7, 30.0])
def test_a_machine_on_the_slider_as_a_waveguide(machine):
    """The first front of contacts whose pusher gives way is that of the slider pushed through the same spring."""
    slider = sp.Slider(10.0, 0.03, 0.3)
    held, k, one = waveguide.response(slider_guide(slider), slider.stiffness, 96), jnp.asarray(slider.stiffness), jnp.ones(96)
    body = Relaxed(held.through(machine, k), one, 0 * one, k, 95, alike=True)
    length, _, status = length_of(body, "domino")
    assert status == Outcome.ARRESTED
    assert float(length) == pytest.approx(float(sp.precursor_length(ended(slider, machine=machine))), rel=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize("friction", [pytest.param(None, marks=pytest.mark.slow), 0.2])
def test_a_block_pushed_through_a_machine(friction):
    """It is the first event of a series through that spring; its pusher is in balance; a stiff machine is none."""
    block = sp.Block(12.0, 0.03, 0.3, sp.Push(0.3), length=48, friction=friction)
    soft = eqx.tree_at(lambda x: x.machine, block, jnp.asarray(0.2), is_leaf=lambda x: x is None)
    found, series = sp.first_precursor(soft, event="full"), sp.series(block, Spring(0.2), events=1)
    assert found.length == pytest.approx(float(series.length[0]), rel=1e-12)
    assert found.load == pytest.approx(float(series.load[0]), rel=1e-12)
    assert found.length > 1.02 * sp.precursor_length(block, event="full")  # the spring goes on pushing
    own, through = sp.series(soft, events=3), sp.series(block, Spring(0.2), events=3)
    for name in ("load", "force_after", "length", "work"):
        np.testing.assert_allclose(getattr(own, name), getattr(through, name), rtol=1e-12, err_msg=name)
    with pytest.raises(ValueError, match="they are one spring"):
        sp.series(soft, Spring(0.2), events=1)
    # what the machine pulls with is what the contacts carry
    for pinning, stress in ((0 * found.pinning, found.stress_before), (found.pinning, found.stress)):
        pusher = blocks.fields(soft, found.load, pinning).horizontal[0].max()  # the part of the side that moves as one
        force = 0.2 * (found.load - pusher)
        assert force == pytest.approx(float(block.stiffness * stress.sum()), rel=1e-9)
    stiff = sp.Block(12.0, 0.03, 0.3, sp.Push(0.3), length=48, friction=friction, machine=1e9)
    assert sp.precursor_length(stiff) == pytest.approx(float(sp.precursor_length(block)), rel=1e-6)
    assert sp.Block(12.0, 0.03, 0.3, machine=np.inf).machine is None

    def length(machine):
        return sp.precursor_length(sp.Block(12.0, 0.03, 0.3, sp.Push(0.3), length=48, friction=friction, machine=machine))

    slope, step = jax.grad(length)(0.2), 1e-6
    assert slope == pytest.approx(float(length(0.2 + step) - length(0.2 - step)) / (2 * step), rel=1e-5)


@pytest.mark.slow
def test_a_tall_block_pushed_through_a_machine_is_followed_on_larger_contacts():
    """M/K belongs to the body, whatever its contacts."""
    block = sp.Block(350.0, 1 / (2.6 * 350), 0.3, sp.Push(0.25), machine=0.5)
    found, off = map(float, size.tall_length(block, None, "full"))
    assert found == pytest.approx(float(sp.precursor_length(block, sites=2048, event="full")), abs=max(off, 0.002 * found))


@pytest.mark.ci
@pytest.mark.parametrize("contacts", [pytest.param(None, marks=pytest.mark.slow), 40])
def test_a_series_of_a_block(contacts):
    """Loads and breaks of a whole block by sparse finite elements; the first event is the first precursor."""
    block = sp.Block(4.0, 0.08, 0.3, sp.Push(0.3), length=contacts)
    dense = whole(block, contacts or 160, reach=contacts or 48)
    loads, orders = events_of(dense.push, dense.matrix, 8)
    found = sp.series(block, events=8, sites=contacts or 48, recorded_breaks=500)
    count = min(8, next((i + 1 for i, order in enumerate(orders) if max(order) == (contacts or 48) - 1), 8))
    assert int(found.number) == count
    np.testing.assert_allclose(found.load[:count], loads[:count], rtol=1e-9)
    breaks = np.asarray(found.break_site)
    assert [list(breaks[found.break_event == e]) for e in range(count)] == orders[:count]
    assert max(found.drift, found.energy_drift) < 1e-12
    first = sp.first_precursor(block, event="full")
    assert found.length[0] == pytest.approx(float(first.length), rel=1e-12)
    assert found.load[0] == pytest.approx(float(first.load), rel=1e-12)


@pytest.mark.slow
def test_a_series_on_an_interface_and_of_a_batch():
    """The first event is the first precursor there; lanes do not depend on each other; the force is the balance of all contacts."""
    interface = sp.Interface(prestress=0.2, threshold_slope=0.01)
    block = sp.Block(4.0, 0.08, 0.3, sp.Push(0.3), length=50)
    found = sp.series(block, events=3, interface=interface)
    first = sp.first_precursor(block, interface, event="full")
    assert found.load[0] == pytest.approx(float(first.load), rel=1e-12)
    assert found.length[0] == pytest.approx(float(first.length), rel=1e-12)
    change = block.stiffness * (first.stress - interface.prestress_at(jnp.arange(50))).sum()
    assert found.force_after[0] == pytest.approx(float(change), rel=1e-9)
    many = jax.vmap(lambda h: sp.series(block, events=3, interface=sp.Interface(h, 0.01)))(jnp.array([0.0, 0.2]))
    np.testing.assert_array_equal(many.load[1], found.load)
    aged = sp.series(block, events=3, interface=interface, ageing=sp.Ageing(0.5, 1.0), repin_delay=2)
    assert int(aged.status) in (Outcome.DONE, Outcome.SPANNED)
    assert aged.energy_drift < 1e-12


@pytest.mark.parametrize(
    ("body", "given", "message"),
    [
        (sp.Block(5.0, 0.1, 0.3), {}, "states no end, so give the number"),
        (sp.Block(5.0, 0.1, 0.3, length=20), {"sites": 10}, "sites = 10: a block of 20 contacts needs all of them"),
        (sp.Block(5.0, 0.1, 0.3, length=9000), {}, "sites = 9000: at most 8192"),
        (sp.Block(5.0, 0.1, 0.3), {"sites": 1e4}, "sites = 10000.0: must be a whole number"),
        (sp.Block(5.0, 0.1, 0.3, sp.Push(0.4, 0.2, "force")), {"sites": 30}, "push.control = 'force'"),
        (sp.chain(sp.Slider(5.0, 0.1, 0.3), sites=10), {"sites": 10}, "sites = 10: that is for a block"),
    ],
)
def test_series_that_cannot_be(body, given, message):
    with pytest.raises(ValueError, match=message):
        sp.series(body, events=3, **given)


# --- the first front, and the whole event -------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize(("b", "again"), [(2.0, False), (10.0, True), pytest.param(25.0, True, marks=pytest.mark.slow)])
def test_both_events_of_the_slider_as_a_waveguide(b, again):
    """Contacts in one block, against the recursion and the event of the chain."""
    slider = sp.Slider(50.0, b / 130, 0.3)
    for event in KINDS:
        found = waveguide.response(slider_guide(slider), slider.stiffness, 160)
        ended, _ = first_event(Relaxed(found, jnp.ones(160), jnp.zeros(160)), kind=event)
        reached = ended.length(ended.stress - 1, 159, alike=True)
        assert float(reached) == pytest.approx(float(sp.precursor_length(slider, event=event)), abs=1e-8)
    front, whole = (float(sp.precursor_length(slider, event=event)) for event in KINDS)
    assert (whole > front) == again
    assert whole == pytest.approx(float(sp.precursor_lengths(slider, event="full")), rel=1e-12)


@pytest.mark.ci
def test_the_front_of_a_block_is_that_of_its_slider():
    """Where contacts break again, both fronts stop before their events do; elsewhere they are the events."""
    for b, again in ((1.0, False), (10.0, True), (25.0, True)):
        block = at_b(40.0, b, sp.Push(0.4))
        fronts, events = ([sp.first_precursor(block, event=event) for event in KINDS],
                          [float(sp.precursor_length(block.slider, event=event)) for event in KINDS])  # fmt: skip
        front, whole = fronts
        assert int(front.contacts_broken) == int(front.breaks) <= int(whole.breaks)
        beyond = [float(whole.length / front.length) > 1 + 1e-9, events[1] / events[0] > 1 + 1e-9]
        assert beyond == [again, again]
        assert int(front.status) == (Outcome.REBREAK if again else Outcome.ARRESTED)
        assert int(whole.status) == Outcome.ARRESTED
        assert (front.event, whole.event) == ("domino", "full")
        if not again:
            assert float(front.length) == pytest.approx(float(whole.length), rel=1e-14)
        for event, found in zip(KINDS, fronts, strict=True):
            assert float(sp.precursor_length(block, event=event)) == pytest.approx(float(found.length), rel=1e-13)
    assert "'full' has the length of the whole event" in str(sp.first_precursor(at_b(40.0, 25.0, sp.Push(0.4))))


@pytest.mark.slow
def test_both_events_of_tall_blocks():
    """From coarser blocks, against the contacts themselves."""
    block = at_b(600.0, 25.0, sp.Push(0.1))
    found = [float(sp.precursor_length(block, event=event)) for event in KINDS]
    direct = [float(sp.first_precursor(block, event=event).length) for event in KINDS]
    assert found == pytest.approx(direct, rel=0.01)
    assert found[0] < found[1]


@pytest.mark.slow
def test_derivative_of_a_front_at_a_fixed_order_of_breaks():
    """Beyond the onset of breaking again, where the whole event has other ones."""
    slopes = []
    for event in KINDS:
        length = functools.partial(lambda k, event: sp.precursor_length(sp.Block(40.0, k, 0.3, sp.Push(0.4)), sites=128, event=event),
                                   event=event)  # fmt: skip
        around = (float(length(0.2 + 1e-7)) - float(length(0.2 - 1e-7))) / 2e-7
        slopes.append(float(jax.grad(length)(0.2)))
        assert slopes[-1] == pytest.approx(around, rel=1e-5)
    assert slopes[0] != pytest.approx(slopes[1], rel=0.1)


@pytest.mark.ci
def test_a_single_break_inside_is_an_event():
    """It is arrested at the contact that broke; no domino is for contact 0 alone."""
    threshold = np.full(64, 0.9)
    threshold[7], threshold[0] = 0.1, 5.0
    block = at_b(30.0, 1.0, sp.Push(0.4))
    for event in KINDS:
        found = sp.first_precursor(block, sp.Profile(threshold=threshold), sites=64, event=event)
        assert (int(found.first), int(found.contacts_broken)) == (7, 1)
        assert (int(found.status), float(found.length)) == (Outcome.ARRESTED, 7)
        assert str(found).endswith(
            "arrested: the first contact ahead stayed below its threshold; it begins at contact 7, not at the edge"
        )
        length = sp.precursor_length(block, sp.Profile(threshold=threshold), sites=64, event=event)
        assert float(length) == 7
    threshold[6] = float(found.stress_before[6]) + 1e-3  # its left neighbour breaks next: the rightmost contact decides
    found = sp.first_precursor(block, sp.Profile(threshold=threshold), sites=64)
    assert (int(found.first), int(found.contacts_broken), float(found.length)) == (7, 2, 7)


def test_the_whole_event_of_a_slider_where_it_cannot_be():
    slider = sp.Slider(50.0, 0.1, 0.3)
    with pytest.raises(ValueError, match="under jit and vmap a body needs sites"):
        jax.jit(functools.partial(sp.precursor_length, event="full"))(slider)
    with pytest.raises(ValueError, match="event = 'full': under a smooth rule"):
        sp.precursor_length(slider, rule=sp.SmoothBreak(0.01), event="full")
    with pytest.raises(ValueError, match="sites = 60: the front of a slider needs none"):
        sp.precursor_length(slider, sites=60)


# --- precision ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("double", [True, False])
def test_blocks_under_strict_promotion(double):
    """No number changes its type by itself."""
    interface = sp.Interface(0.1, 0.01)
    ends = sp.Block(12.0, 0.05, 0.3, sp.Push(0.4, 0.2, "force"), length=40, normal_stiffness=2.0)
    with jax.numpy_dtype_promotion("strict"), jax.enable_x64(double):
        for block in (sp.Block(12.0, 0.05, 0.3), ends):
            found = sp.first_precursor(block, interface)
            assert found.length.dtype == (jnp.float64 if double else jnp.float32)
            assert float(sp.precursor_length(block, interface)) == pytest.approx(float(found.length), rel=1e-7)
            assert jnp.isfinite(blocks.fields(block, found.load, found.pinning).horizontal).all()
            assert jnp.isfinite(jax.grad(lambda h, block=block: sp.precursor_length(
                sp.Block(h, 0.05, 0.3, block.push, length=block.length, normal_stiffness=block.normal_stiffness)))(12.0))  # fmt: skip
        assert jnp.isfinite(sp.precursor_length(sp.Block(600.0, 0.01, 0.3)))
        assert jnp.isfinite(sp.precursor_length(sp.Block(12.0, 0.05, 0.3), rule=sp.SmoothBreak(0.01)))
        assert jnp.isfinite(blocks.stages(found.body, interface, 40, jnp.arange(3), "domino")[2]).all()
        for protocol in (Adiabatic(), Steps(0.05), Spring(0.7)):
            many = sp.series(sp.Block(12.0, 0.05, 0.3), protocol, events=3, sites=64, interface=interface)
            assert int(many.number) == 3


@pytest.mark.slow
def test_no_elimination_of_a_batch():
    """jaxlib's waits within a thread of XLA's pool for others of it: two at once never end on two cores."""

    def eliminations(law):
        three = size.many(np.full(3, 10.0), 0.02, 0.3, 0.3, friction=0.2, contact_law=law)
        three = eqx.tree_at(lambda x: x.length, three, np.full(3, 20), is_leaf=lambda x: x is None)
        with jax.default_device(jax.devices("cpu")[0]):
            program = jax.jit(jax.vmap(lambda one: record(one, None, 32, "full").length)).lower(three).compile().as_text()
        return [line for line in program.splitlines() if "getrf" in line and "custom-call(" in line]

    assert not eliminations("amontons")
    assert eliminations("multicontact")
    assert all(re.search(r"= \(f64\[\d+,\d+\]", line) for line in eliminations("multicontact"))
