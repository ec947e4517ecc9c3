"""What a contact keeps: independent programs, an exact change of variables, derivatives, limits and refusals."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.dense_chain import DenseChain, ages, crossing, front_stress, responses

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.events.series import Adiabatic, Loading, load_through
from slippulse_jax.exact.front import exact_fields, exact_front_stress
from slippulse_jax.lengths import arrests
from slippulse_jax.rules import SelfHealing

FRONTS = {  # H/λc, b, ν, φ, ε, r; contacts broken and ℓ of an independent recursion
    (25, 1.95, 0.3, 0.0, 0.0, 0.1): (24, 23.016549759),
    (25, 1.95, 0.3, 0.0, 0.0, 0.5): (14, 13.325682031),
    (200, 0.3, 0.2, 0.2, 0.0, 0.5): (69, 68.947607171),
    (1000, 3, 0.4, -0.1, 0.0, 0.7): (248, 247.190323008),
    (5000, 0.5, 0.3, 0.0, 0.0, 0.25): (2044, 2043.416066833),
    (100, 1, 0.3, 0.0, 0.002, 0.3): (40, 39.029304484),
    (60, 4, 0.25, 0.4, 0.001, 0.2): (71, 70.014650947),
}
SLIDER, SITES = sp.Slider(50.0, 0.02, 0.3), 60


def of_b(height, b, nu, **more):
    return sp.Slider(height, b / (2 * (1 + nu) * height), nu, **more)


def loosened(interface, sites):
    """The profile of contacts that keep nothing and obey the same rule."""
    site, r = np.arange(sites), interface.residual_strength
    theta, phi = (np.asarray(f(site)) for f in (interface.threshold_at, interface.prestress_at))
    return sp.Profile(theta, (phi - r * theta) / (1 - r))


@pytest.mark.parametrize("row", FRONTS, ids=str)
def test_fronts_against_an_independent_recursion(row):
    height, b, nu, phi, slope, r = row
    slider, contacts, (broken, length) = of_b(height, b, nu), sp.Interface(phi, slope, r), FRONTS[row]
    record = sp.first_precursor(slider, contacts)
    assert record.contacts_broken == broken
    found = sp.precursor_length(slider, contacts), sp.precursor_lengths(slider, contacts), record.length
    assert np.allclose(found, length, rtol=0, atol=6e-10)
    if slope == 0 and broken > 50:
        closed = sp.exact_length(slider, contacts), sp.exact_lengths(slider, contacts)
        assert np.allclose(closed, length, rtol=0, atol=1e-8)


@pytest.mark.parametrize("end", [{}, {"length": SITES}, {"machine": 0.5}, {"length": SITES, "machine": 0.5}], ids=str)
def test_fronts_against_dense_matrices(end):
    """Stress at the front, length, load, fields and the edge, of sliders with ends and machines."""
    r, phi = 0.35, 0.15
    slider, contacts = sp.Slider(20.0, 0.08, 0.3, **end), sp.Interface(phi, 0.0, r)
    sites, right = (SITES, "free") if "length" in end else (300, "semi-infinite")
    load, pinning = responses(20.0, 0.08, 0.3, sites, right, SITES, end.get("machine"))
    stress = front_stress(load, pinning, SITES, phi, r)
    s0 = int(np.argmax(stress[1:] < 1)) + 1
    record = sp.first_precursor(slider, contacts, sites=SITES)
    assert record.contacts_broken == s0
    length = crossing(np.append(0, stress[1 : s0 + 1] - 1))
    bulk = arrests(slider, contacts)
    for found in (record.length, sp.precursor_length(slider, contacts), sp.precursor_lengths(slider, contacts), bulk.length):
        assert found == pytest.approx(length, abs=1e-9)
    assert record.load == pytest.approx((1 - phi) / load[0], rel=1e-10)
    assert record.front_stress == pytest.approx(stress, abs=1e-10)
    released = np.where(np.arange(SITES) < s0, stress - r, 0)
    after = phi + (1 - phi) / load[0] * load + pinning @ released - released
    assert record.stress == pytest.approx(after, abs=1e-10)
    assert record.pinning == pytest.approx(released, abs=1e-10)
    assert bulk.edge_stress == pytest.approx(after[0], abs=1e-10)
    if after[0] < 1:  # no contact breaks again
        whole = sp.first_precursor(slider, contacts, sites=SITES, event="full")
        assert whole.stress == pytest.approx(after, abs=1e-9)


@pytest.mark.parametrize("rule", [None, sp.SmoothBreak(0.01), sp.SmoothBreak(0.15)], ids=str)
@pytest.mark.parametrize("contacts", [sp.Interface(0.1, 0.0, 0.3), sp.Interface(0.3, 0.0003, 0.6)], ids=str)
def test_change_of_variables(rule, contacts):
    """(t − rθ)/(1 − r) obeys the rule of r = 0; a width is then over 1 − r."""
    lost, theta = 1 - contacts.residual_strength, np.asarray(contacts.threshold_at(np.arange(400)))
    same = loosened(contacts, 400) if contacts.threshold_slope else sp.Interface(contacts.equivalent_prestress)
    if contacts.threshold_slope:  # a profile ends on a straight line, so compare two
        contacts = sp.Profile(theta, contacts.prestress, contacts.residual_strength)
    wide = None if rule is None else sp.SmoothBreak(rule.width / lost)
    ways = {
        "length": lambda i, rule: sp.precursor_length(SLIDER, i, rule=rule),
        "jit": jax.jit(lambda i, rule: sp.precursor_length(SLIDER, i, rule=rule)),
        "chain": lambda i, rule: sp.rupture(sp.chain(SLIDER, sites=400, interface=i), rule=rule).length,
    }
    for name, way in ways.items():
        assert way(contacts, rule) == pytest.approx(float(way(same, wide)), rel=1e-11), name
    here, there = (sp.sensitivity(SLIDER, i, sites=400, rule=w) for i, w in ((contacts, rule), (same, wide)))
    assert here.length == pytest.approx(float(there.length), rel=1e-11)
    assert here.stress == pytest.approx(np.asarray(lost * there.stress + (1 - lost) * theta), rel=1e-11)
    assert here.prestress == pytest.approx(np.asarray(there.prestress) / lost, rel=1e-10, abs=1e-10)
    moved = here.threshold - (there.threshold - (1 - lost) / lost * there.prestress)
    assert abs(moved).max() < 1e-9 * abs(there.threshold).max()


def test_derivatives_of_fronts():
    """By every number, in the recursion, in bulk and in closed form, against differences and the chain rule."""
    contacts = sp.Interface(0.1, 0.001, 0.3)

    def length(numbers):
        return sp.precursor_length(sp.Slider(*numbers[:3]), sp.Interface(*numbers[3:]))

    at, steps = np.array([50.0, 0.02, 0.3, 0.1, 0.001, 0.3]), np.array([1e-3, 1e-7, 1e-6, 1e-6, 1e-8, 1e-6])
    differences = [float(length(at + h) - length(at - h)) / (2 * h.sum()) for h in np.diag(steps)]
    for derive in (jax.grad, jax.jacfwd):
        assert np.asarray(derive(length)(jnp.asarray(at))) == pytest.approx(differences, rel=1e-6)
    bulk = sp.precursor_lengths(SLIDER, contacts, derivatives=1)
    assert jax.tree.leaves((bulk.slider, bulk.interface)) == pytest.approx(differences, rel=1e-6)
    level = sp.Interface(0.1, residual_strength=0.3)
    for r in (0.0, 0.3):
        own = jax.grad(lambda x: sp.precursor_length(SLIDER, sp.Interface(0.1, residual_strength=x)))(r)
        of_prestress = jax.grad(lambda x: sp.precursor_length(SLIDER, sp.Interface(x)))((0.1 - r) / (1 - r))
        assert float(own) == pytest.approx(-0.9 / (1 - r) ** 2 * float(of_prestress), rel=1e-9)
    closed = sp.exact_lengths(SLIDER, level, derivatives=1)
    own = jax.grad(lambda x: sp.exact_length(SLIDER, sp.Interface(x[0], residual_strength=x[1])))(jnp.array([0.1, 0.3]))
    assert (closed.interface.prestress, closed.interface.residual_strength) == pytest.approx(np.asarray(own).tolist(), rel=1e-9)
    assert np.isnan(closed.interface.threshold_slope), "it is not known there"
    batch = jax.vmap(lambda r: sp.precursor_length(SLIDER, sp.Interface(0.1, 0.001, r)))(jnp.linspace(0, 0.8, 9))
    many = sp.precursor_lengths(SLIDER, sp.Interface(0.1, 0.001, np.linspace(0, 0.8, 9)))
    assert batch == pytest.approx(many, rel=1e-11)


@pytest.mark.ci
def test_bulk_on_every_kernel():
    """Lanes alone, with ends and machines, stiff ones, and with a rule, against one length at a time."""
    rng = np.random.default_rng(4)
    n = 40
    height, b, nu = rng.uniform(5, 300, n), 10 ** rng.uniform(-1, 1, n), rng.uniform(0, 0.5, n)
    contacts = sp.Interface(rng.uniform(-0.5, 0.5, n), rng.uniform(0, 0.002, n), rng.uniform(0, 0.9, n))
    for more in ({}, {"length": rng.uniform(5, 400, n)}, {"machine": 10 ** rng.uniform(-1, 2, n)}):
        slider = of_b(height, b, nu, **more)
        for rule in (None, sp.SmoothBreak(0.05)):
            one = sp.precursor_length(slider, contacts, rule=rule)
            assert sp.precursor_lengths(slider, contacts, rule=rule) == pytest.approx(np.asarray(one), rel=1e-9)
        slopes = sp.precursor_lengths(slider, contacts, derivatives=1)
        each = jax.grad(lambda i, slider=slider: jnp.where(jnp.isfinite(x := sp.precursor_length(slider, i)), x, 0).sum())(
            contacts
        )
        known = np.isfinite(slopes.length)
        for name in ("prestress", "threshold_slope", "residual_strength"):
            got, want = getattr(slopes.interface, name)[known], np.asarray(getattr(each, name))[known]
            assert got == pytest.approx(want, rel=1e-6, abs=1e-6 * abs(want).max()), name
    stiff = sp.Slider(30.0, np.array([0.5, 9.0, 20.0]), 0.3)
    assert sp.precursor_lengths(stiff, sp.Interface(0.1, 0.0, 0.3)) == pytest.approx(
        np.asarray(sp.precursor_length(stiff, sp.Interface(0.1, 0.0, 0.3))), rel=1e-9
    )


def test_closed_form():
    """Front stress, fields, load and outcome, against the recursion; and far below any prestress of a user's."""
    contacts = sp.Interface(0.2, residual_strength=0.45)
    record, exact = sp.first_precursor(SLIDER, contacts), sp.exact_front(SLIDER, contacts)
    sites = np.arange(record.stress.size)
    assert exact.load == pytest.approx(float(record.load), rel=1e-12)
    assert exact.contacts_broken == record.contacts_broken
    assert exact_front_stress(SLIDER, sites, contacts) == pytest.approx(np.asarray(record.front_stress), rel=1e-11)
    before, after = (exact_fields(SLIDER, s, sites, contacts) for s in (0, int(record.contacts_broken)))
    assert before.stress == pytest.approx(np.asarray(record.stress_before), abs=1e-12)
    assert after.stress == pytest.approx(np.asarray(record.stress), abs=1e-12)
    assert after.layer - before.layer == pytest.approx(np.asarray(record.slip), abs=1e-11)
    far = sp.Interface(-0.9, residual_strength=0.95)
    tall = of_b(2e5, 2.0, 0.3)
    assert far.equivalent_prestress == pytest.approx(-37)
    assert sp.exact_length(tall, far) == pytest.approx(float(sp.precursor_length(tall, far)), rel=1e-9)


def test_run_away_and_limits():
    """φ_c = r + (1 − r) φ_c(0); the macroscopic length; the onset of breaking again; and ℓ → 0 as r → 1."""
    r = 0.4
    critical = float(sp.theory.runaway_prestress(SLIDER, r))
    assert critical == pytest.approx(r + (1 - r) * float(sp.theory.runaway_prestress(SLIDER)), rel=1e-14)
    assert np.isinf(sp.precursor_length(SLIDER, sp.Interface(critical + 1e-3, residual_strength=r)))
    assert np.isfinite(sp.precursor_length(SLIDER, sp.Interface(critical - 1e-2, residual_strength=r)))
    tall = of_b(1e6, 1.0, 0.3)
    law = sp.theory.macroscopic_length(1.0, 0.3, prestress=0.1, residual_strength=r)
    assert sp.exact_length(tall, sp.Interface(0.1, residual_strength=r)) / 1e6 == pytest.approx(float(law), rel=5e-3)
    onset = float(sp.rebreaking_onset(100.0, 0.3, residual_strength=0.2))
    assert onset == pytest.approx(float(sp.rebreaking_onset(100.0, 0.3, -0.25)), rel=1e-9)
    for b, status in ((0.98 * onset, Outcome.ARRESTED), (1.02 * onset, Outcome.REBREAK)):
        assert sp.first_precursor(of_b(100.0, b, 0.3), sp.Interface(residual_strength=0.2)).status == status
    lengths = sp.precursor_lengths(of_b(200.0, 1.0, 0.3), sp.Interface(residual_strength=np.array([0, 0.3, 0.5, 0.7, 0.9])))
    assert lengths / 200 == pytest.approx([0.81, 0.55, 0.41, 0.27, 0.12], abs=6e-3)


# --- events and series ---------------------------------------------------------------------------------------------------


def rough(residual, **more):
    """A dense chain of varied contacts, and the package's."""
    rng = np.random.default_rng(7)
    slider = (8.0, 0.06, 0.3)
    theta, phi = rng.uniform(0.9, 1.1, 30), rng.uniform(0, 0.2, 30)
    chain = sp.chain(sp.Slider(*slider, length=30), interface=sp.Profile(theta, phi, residual))
    return DenseChain.uniform(slider, theta, phi, residual=residual, **more), chain


@pytest.mark.parametrize("residual", [0.2, pytest.param(0.7, marks=pytest.mark.ci)])
@pytest.mark.parametrize("how", [{}, {"delay": 2}, pytest.param({"ageing": (0.75, 0.4)}, marks=pytest.mark.ci)], ids=str)
def test_series_against_dense_program(how, residual):
    """Order of breaks, loads, forces, energies and pinning points of every event."""
    ageing = how.get("ageing")
    strength = None if ageing is None else ages("exponential", *ageing)
    plain, chain = rough(residual, delay=how.get("delay", 0), strength=strength)
    got = sp.series(
        chain, events=20, recorded_breaks=4000, stop_when_spanning=False, repin_delay=how.get("delay", 0),
        ageing=None if ageing is None else sp.Ageing(*ageing),
    )  # fmt: skip
    start = plain.energy()
    for e in range(20):
        order = plain.event()
        assert list(np.asarray(got.break_site)[np.asarray(got.break_event) == e]) == order, e
        assert got.load[e] == pytest.approx(plain.load, abs=1e-9)
        assert got.force_after[e] == pytest.approx(plain.push(), abs=1e-9)
        assert got.stored[e] == pytest.approx(plain.energy() - start, abs=1e-9)
    assert got.state.pinning == pytest.approx(plain.pinning, abs=1e-9)
    assert max(float(got.drift), float(got.energy_drift)) < 1e-12


def test_rupture_against_dense_program():
    for delay in (0, 2):
        plain, chain = rough(0.3, delay=delay)
        order = plain.event()
        found = sp.rupture(chain, repin_delay=delay)
        assert list(np.asarray(found.order)[: int(found.breaks)]) == order
        assert found.state.pinning == pytest.approx(plain.pinning, abs=1e-11)
        assert found.after.stress == pytest.approx(plain.stress(), abs=1e-11)
        assert found.released[0] == pytest.approx(0.7 * float(chain.threshold[order[0]]), abs=1e-12)
        assert found.drift < 1e-13


BLOCKS = [  # H/λc, L/λc, μ, b, ageing, r; events; the first: F before, after over μF_N, breaks, ℓ; others F : ℓ (dense elements)
    ((24, 72, 0.3, 1.0, None, 0.2), 76, (0.4260, 0.3738, 7, 6.734), "0.5626:23.77 0.6591:44.20 0.6544:65.93 0.6449:72"),
    ((24, 72, 0.3, 1.0, None, 0.5), 129, (0.4260, 0.3979, 6, 5.469), "0.7833:59.70 0.7775:72"),
    ((24, 72, 0.3, 2.0, (0.5, 0.5), 0.3), 62, (0.3390, 0.2881, 12, 7.185), "0.4505:18.60 0.5684:35.00 0.6137:45.42 0.6086:72"),
    ((48, 144, 0.35, 0.8, None, 0.3), 176, (0.4566, 0.4083, 14, 13.057), "0.6959:144"),
    ((48, 144, 0.45, 2.0, None, 0.7), 611, (0.3220, 0.3212, 1, None), "0.3323:8.59"),
]


@pytest.mark.parametrize(
    "row", BLOCKS[:3] + [pytest.param(row, marks=pytest.mark.ci) for row in BLOCKS[3:]], ids=lambda row: str(row[0])
)
def test_blocks_against_dense_finite_elements(row):
    """Lengths to 1 %, forces to 0.5 %: the meshes differ."""
    (height, sites, friction, b, ageing, r), events, (before, after, breaks, length), others = row
    block = sp.Block(height, b / (2.6 * height), 0.3, sp.Push(0.15, 0.1), length=sites, friction=friction)
    contacts, aged = sp.Interface(residual_strength=r), None if ageing is None else sp.Ageing(*ageing)
    found = sp.series(block, events=800, interface=contacts, ageing=aged)
    table, strength = found.table(), float(found.strength)
    assert found.status == Outcome.SPANNED
    assert abs(int(found.number) - events) <= 0.05 * events
    assert table["force_before"][0] / strength == pytest.approx(before, rel=5e-3)
    assert table["force_after"][0] / strength == pytest.approx(after, rel=5e-3)
    assert table["breaks"][0] == breaks
    if length is not None:
        assert table["length"][0] == pytest.approx(length, rel=0.01)
    ends = np.minimum(table["length"], sites)
    for other in others.split():
        force, place = map(float, other.split(":"))
        near = np.flatnonzero(abs(ends / place - 1) < 0.01)
        assert (abs(table["force_before"][near] / strength / force - 1) < 5e-3).any(), other
    assert max(float(found.drift), float(found.energy_drift)) < 1e-11


def every_break(body, sites, ageing=None, breaks=3000):
    """Order of breaks and loads of a series of contacts."""
    shape = 400, breaks, 0, sites
    loading = Loading(
        Adiabatic(), ageing, jnp.asarray(jnp.inf), jnp.asarray(True), jnp.int32(50 * sites), jnp.asarray(sites - 1)
    )
    end = load_through(shape, body.up_to(sites - 1), loading)
    count = int(end.number)
    return np.asarray(end.order)[: int(end.total)], np.asarray(end.rows["load"])[:count], end


@pytest.mark.parametrize("friction", [None, 0.35])
def test_change_of_variables_of_blocks(friction):
    """Contact by contact, with friction through the pressure that each reads: R − rθQ, t − rθp, (1 − r)θ, and loads as they are."""
    r = 0.3
    block = sp.Block(24.0, 0.8 / (2.6 * 24), 0.3, sp.Push(0.15, 0.1), length=72, friction=friction)
    body = block.contacts(sp.Interface(0.0, 0.0, r), 72)
    response, kept = body.response, r * body.threshold

    def less(rows):
        return rows.at[0].add(-kept * rows[1]) if len(rows) > 1 else rows

    own = response._replace(push=less(response.push), matrix=jax.vmap(less)(response.matrix))
    same = body._replace(
        response=own, threshold=body.threshold - kept, prestress=body.prestress - kept, residual_strength=0.0
    )  # fmt: skip
    (order, loads, end), (again, others, there) = every_break(body, 72), every_break(same, 72)
    assert len(order) > 100
    assert np.array_equal(order, again)
    assert loads == pytest.approx(others, rel=1e-11)
    strength = end.readings[1] if friction else 1.0
    assert end.readings[0] == pytest.approx(np.asarray(there.readings[0] + kept * strength), abs=1e-11)


@pytest.mark.parametrize("event", ["domino", "full"])
@pytest.mark.parametrize("friction", [None, 0.35])
def test_derivatives_of_events(friction, event):
    """At a fixed order of breaks: of r, prestress and every threshold, where contacts break again too."""
    b = 2.0 if event == "domino" else 8.0
    block = sp.Block(24.0, b / (2.6 * 24), 0.3, sp.Push(0.15, 0.1), friction=friction)
    rng = np.random.default_rng(0)
    theta, way = 1 + 0.001 * np.arange(64), rng.normal(size=64)

    def length(x):
        contacts = sp.Profile(theta + x[0] * way, 0.05 + x[1], 0.3 + x[2])
        return sp.precursor_length(block, contacts, sites=64, event=event)

    h = 1e-6 * np.eye(3)
    differences = [float(length(x) - length(-x)) / 2e-6 for x in h]
    assert np.asarray(jax.grad(length)(jnp.zeros(3))) == pytest.approx(differences, rel=1e-5)


def test_smooth_rule_of_blocks():
    """Narrow, it is the hard one; where less breaks at once, a little less far."""
    block, contacts = sp.Block(24.0, 0.03, 0.3), sp.Interface(residual_strength=0.4)
    hard = float(sp.precursor_length(block, contacts, sites=128))
    narrow = float(sp.precursor_length(block, contacts, sites=128, rule=sp.SmoothBreak(1e-4)))
    assert narrow == pytest.approx(hard, abs=0.1)
    slope = jax.grad(
        lambda r: sp.precursor_length(block, sp.Interface(residual_strength=r), sites=128, rule=sp.SmoothBreak(0.05))
    )
    wide = partial(sp.precursor_length, block, sites=128, rule=sp.SmoothBreak(0.05))
    ends = [float(wide(sp.Interface(residual_strength=0.4 + h))) for h in (1e-5, -1e-5)]
    assert slope(0.4) == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-5)


@pytest.mark.parametrize(("width", "kept"), [(0.15, 0.6), (0.1, 0.3)])
def test_a_smooth_rupture_is_as_long_as_its_front(width, kept):
    """Contacts far ahead, whose stress is below what they keep, add nothing."""
    slider, rule = sp.Slider(20.0, 0.02, 0.3), sp.SmoothBreak(width)
    moved = sp.rupture(sp.chain(slider, sites=100, residual_strength=kept), rule=rule)
    front = sp.precursor_length(slider, sp.Interface(residual_strength=kept), rule=rule)
    assert float(moved.length) == pytest.approx(float(front), rel=1e-12)


@pytest.mark.ci
def test_inertia():
    """Slow breaks give the quasi-static rupture; energy balances; a crack has its own friction."""
    chain = sp.chain(sp.Slider(8.0, 0.1, 0.3), sites=20, interface=sp.Interface(0.1, 0.0, 0.3))
    still = sp.rupture(chain)
    moved = sp.simulate_inertial(chain, duration=8000, damping=0.5, rule=SelfHealing(300.0))
    assert moved.status == Outcome.ARRESTED
    assert moved.extent == still.extent
    assert moved.state.pinning == pytest.approx(np.asarray(still.state.pinning), abs=1e-6)
    finer = sp.simulate_inertial(chain, duration=8000, damping=0.5, rule=SelfHealing(300.0), safety=0.1)
    assert moved.imbalance < 1e-3 * float(moved.broken)
    assert moved.imbalance / finer.imbalance == pytest.approx(4, rel=0.05)  # of the step alone
    with pytest.raises(ValueError, match="residual_strength of the chain = 0.3"):
        sp.simulate_inertial(chain, duration=1.0, rule=sp.CrackLike(0.2))


# --- nothing kept, and refusals -----------------------------------------------------------------------------------------


def test_nothing_kept_is_as_before_to_the_bit():
    zero, none = sp.Interface(0.1, 0.001, 0.0), sp.Interface(0.1, 0.001)
    heights = sp.Slider(np.linspace(10, 300, 50), 0.02, 0.3)
    ended = sp.Slider(np.linspace(10, 300, 50), 0.02, 0.3, length=80.0)
    for many in (heights, ended):
        assert np.array_equal(sp.precursor_lengths(many, zero), sp.precursor_lengths(many, none))
        slopes = [sp.precursor_lengths(many, i, derivatives=1) for i in (zero, none)]
        assert np.array_equal(slopes[0].interface.prestress, slopes[1].interface.prestress)
    block = sp.Block(24.0, 0.03, 0.3, sp.Push(0.15, 0.1), length=48, friction=0.3)
    one, other = (sp.series(block, events=60, interface=i) for i in (sp.Interface(residual_strength=0.0), None))
    assert jax.tree.all(jax.tree.map(lambda x, y: np.array_equal(x, y, equal_nan=True), one.table(), other.table()))


def bad(r):
    return {
        "interface": lambda: sp.Interface(residual_strength=r),
        "profile": lambda: sp.Profile(np.ones(3), residual_strength=r),
        "chain": lambda: sp.chain(SLIDER, sites=4, residual_strength=r),
        "runaway": lambda: sp.theory.runaway_prestress(SLIDER, r),
        "macroscopic": lambda: sp.theory.macroscopic_length(1.0, 0.3, residual_strength=r),
        "onset": lambda: sp.rebreaking_onset(100.0, 0.3, residual_strength=r),
    }


@pytest.mark.parametrize("door", bad(0))
def test_out_of_its_domain(door):
    for r in (1.0, -0.1, np.nan):
        with pytest.raises(ValueError, match=r"residual_strength = .*must lie in \[0, 1\)"):
            bad(r)[door]()


def test_traced_out_of_its_domain():
    """Nothing can be raised: no number, and a status."""
    length = jax.jit(lambda r: sp.precursor_length(SLIDER, sp.Interface(residual_strength=r)))
    exact = jax.jit(lambda r: sp.exact_length(SLIDER, sp.Interface(residual_strength=r)))
    block = jax.jit(lambda r: sp.precursor_length(sp.Block(24.0, 0.03, 0.3), sp.Interface(residual_strength=r), sites=64))
    for f in (length, exact, block):
        assert np.isfinite(f(0.5))
        assert np.isnan(f(1.5))
        assert np.isnan(f(-0.5))
    assert np.isnan(jax.jit(lambda r: sp.theory.runaway_prestress(SLIDER, r))(1.5))
    for r in (None, 0.3):
        of_prestress = jax.jit(lambda phi, r=r: sp.exact_length(SLIDER, sp.Interface(phi, residual_strength=r)))
        assert np.isnan(of_prestress(-2.0))
        assert np.isfinite(of_prestress(-0.5))
    aged = jax.jit(lambda r: sp.series(chain_of(r), events=2, ageing=sp.Ageing(0.4, 1.0)).status)
    assert aged(0.2) != Outcome.INVALID
    assert aged(0.5) == Outcome.INVALID


def chain_of(r):
    return sp.chain(SLIDER, sites=8, residual_strength=r)


def test_refusals():
    kept = sp.Interface(0.1, 0.001, 0.3)
    for door in (sp.exact_length, sp.exact_front, sp.exact_lengths):
        with pytest.raises(ValueError, match="threshold_slope = 0.001 beside residual_strength"):
            door(SLIDER, kept)
    with pytest.raises(ValueError, match="leave Interface.residual_strength out"):
        sp.exact_length(SLIDER, sp.Interface(residual_strength=0.3), rule=sp.CrackLike(0.4))
    with pytest.raises(ValueError, match="beside a force law"):
        sp.chain(SLIDER, sites=8, law=jnp.tanh, residual_strength=0.2)
    with pytest.raises(ValueError, match="must be one number"):
        sp.Profile(np.ones(3), 0.0, np.array([0.1, 0.2, 0.3]))
    block = sp.Block(24.0, 0.03, 0.3, length=24)
    for body, more in ((chain_of(0.5), {}), (block, {"interface": sp.Interface(residual_strength=0.5)})):
        with pytest.raises(ValueError, match="Ageing.newborn = 0.4 beside residual_strength = 0.5"):
            sp.series(body, events=2, ageing=sp.Ageing(0.4, 1.0), **more)
