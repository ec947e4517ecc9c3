"""Equilibrium of any chain against dense matrices, against the lattice modes, and against a manufactured solution."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import batch, both_chains, ended
from jax.tree_util import Partial
from oracles.dense_chain import end_stiffness, stiffness_matrix, uniform_springs
from scipy.optimize import fsolve, root

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.chain import Chain, Springs, State, chain, eliminate, endless, potential_energy, respond
from slippulse_jax.bodies.equilibrium import equilibrium, forces, imbalance
from slippulse_jax.bodies.modes import lattice_modes

ENDS = ("semi-infinite", "free", "clamped")
FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)
solve, solve_one = jax.jit(jax.vmap(equilibrium)), jax.jit(equilibrium)


def random_case(rng, sites, right):
    """A heterogeneous, preloaded chain: as numbers, as the dense program, and as the package's arguments."""
    height, stiffness, poisson = 10 ** rng.uniform(0.3, 2.3), 10 ** rng.uniform(-3, -0.3), rng.uniform(0, 0.5)
    contact = stiffness * 10 ** rng.uniform(-0.5, 0.5, sites) * (rng.random(sites) > 0.15)
    contact[rng.integers(sites)] = stiffness
    fields = {
        "contact": contact,
        "threshold": rng.uniform(0.5, 1.5, sites),
        "prestress": rng.uniform(-0.2, 0.4, sites),
        "upper": height * 10 ** rng.uniform(-0.3, 0.3, sites - 1),
        "layer": 10 ** rng.uniform(-0.3, 0.3, sites - 1),
    }
    pinning, load = rng.uniform(-1, 1, sites) * rng.choice([0, 0.3]), rng.uniform(0, 5)
    dense, mine = both_chains((height, stiffness, poisson), sites, right, fields)
    return dense, mine, State(jnp.asarray(pinning), jnp.asarray(load))


def balance_bound(chains, found, floor=1e-12):
    """10⁻¹² of the load; more only where a last digit of a displacement, times the stiffness of a bond, exceeds that."""
    load = np.abs(found.push)
    digit = np.finfo(found.upper.dtype).eps * np.abs(found.upper).max(-1)
    return np.maximum(floor, 4 * np.asarray(chains.upper).max(-1) * digit / load)


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
@pytest.mark.parametrize("sites", [2, 120, *(pytest.param(n, marks=pytest.mark.slow) for n in (3, 17))])
def test_against_dense_matrices(sites, right):
    rng = np.random.default_rng(sites)
    dense, mine, states = zip(*[random_case(rng, sites, right) for _ in range(25)], strict=True)
    found = solve(batch(mine), batch(states))
    assert np.all(found.status == Outcome.SOLVED)
    assert np.all(found.residual <= balance_bound(batch(mine), found))
    for n, (d, s) in enumerate(zip(dense, states, strict=True)):
        u_t, u = d.at(s.pinning, float(s.load)).fields()
        np.testing.assert_allclose(found.upper[n], u_t, rtol=0, atol=1e-10)
        np.testing.assert_allclose(found.layer[n], u, rtol=0, atol=1e-10)
        np.testing.assert_allclose(found.stress[n], d.stress(), rtol=0, atol=1e-10)
        np.testing.assert_allclose(found.push[n], d.push(), rtol=0, atol=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
def test_forces_are_slopes_of_the_energy(right):
    """Of displacements out of balance, and of the pinning points: then of all that the contacts carry, prestress included."""
    rng = np.random.default_rng(7)
    _, mine, state = random_case(rng, 12, right)
    x = tuple(jnp.asarray(one) for one in rng.normal(size=(2, 12)))
    (upper, layer), pinning = jax.jit(jax.grad(potential_energy, argnums=(1, 2)))(mine, x, state.pinning)
    force = forces(mine, state.pinning, x)
    np.testing.assert_allclose(upper, -force[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(layer, -force[1], rtol=1e-12, atol=1e-12)
    unheld = imbalance(mine, state, x)
    assert unheld[0][0] == 0
    np.testing.assert_array_equal(np.append(unheld[0][1:], unheld[1]), np.append(force[0][1:], force[1]))
    carried = mine.stiffness * mine.stress(x[1], state.pinning)
    np.testing.assert_allclose(pinning, -carried, rtol=1e-12, atol=1e-12)
    assert potential_energy(mine, (0 * x[0], 0 * x[1]), 0 * x[0]) == 0


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
def test_chain_pulled_through_a_spring(right):
    """Its contacts are those of the chain whose edge is held where the spring leaves it; the spring carries the push."""
    rng = np.random.default_rng(8)
    _, mine, state = random_case(rng, 12, right)
    stiffness = 0.7
    held, moved = (float(equilibrium(mine, State(state.pinning, u)).push) for u in (0.0, 1.0))
    edge = (stiffness * float(state.load) - held) / (stiffness + moved - held)
    alone = equilibrium(mine, State(state.pinning, edge))
    assert alone.status == Outcome.SOLVED
    assert float(alone.push) == pytest.approx(stiffness * (float(state.load) - edge), rel=1e-9)
    pulled = jax.jit(lambda mine: mine.contacts().through(stiffness))(mine)
    attached = np.asarray(mine.contact) > 0
    released = jnp.where(attached, state.pinning / jnp.where(attached, pulled.response.soft, 1), 0)
    stress = pulled.prestress + state.load * pulled.response.push[0] + released @ pulled.response.matrix[:, 0] - released
    np.testing.assert_allclose(stress, alone.stress, rtol=1e-10, atol=1e-11)
    force = pulled.response.edge_stiffness * state.load - mine.stiffness * pulled.response.push[0] @ (
        pulled.response.soft * released
    )
    np.testing.assert_allclose(force, alone.push, rtol=1e-9)


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
def test_uniform_chain_against_its_lattice_modes(right):
    modes = lattice_modes(ended(FIG2, 100, right))
    exact = jax.vmap(lambda i: modes.drive @ modes.profile(i))(jnp.arange(100.0))
    found = jax.jit(equilibrium)(chain(ended(FIG2, 100, right), sites=100), relaxed_at(FIG2, modes.load))
    np.testing.assert_allclose(found.layer, exact, rtol=1e-12)


def relaxed_at(slider, load, sites=100):
    return chain(slider, sites=sites).relaxed(load)


@pytest.mark.ci
@pytest.mark.parametrize("height", [25.0, 1e3, 1e5])
def test_an_endless_chain_does_not_notice_where_it_is_cut(height):
    slider = sp.Slider(height=height, stiffness=0.03, poisson=0.3)
    short, long = (jax.jit(equilibrium)(chain(slider, sites=n), relaxed_at(slider, 2.0, n)) for n in (7, 5000))
    np.testing.assert_allclose(short.layer, long.layer[:7], rtol=1e-12)
    np.testing.assert_allclose(short.upper, long.upper[:7], rtol=1e-12)


def test_endless_end_is_the_limit_of_long_walls():
    for height, stiffness, poisson in [(25.0, 0.03, 0.3), (1.1, 1.0, 0.5), (100.0, 1e-3, 0.0)]:
        slider = sp.Slider(height=height, stiffness=stiffness, poisson=poisson)
        K_T = float(slider.K_T)
        end = endless(Springs(slider.K_L, jnp.ones(()), slider.K_T), jnp.asarray(stiffness))
        matrix = np.diag([float(end.upper), float(end.layer)]) + float(end.across) * np.array([[1, -1], [-1, 1]])
        np.testing.assert_allclose(matrix, end_stiffness("semi-infinite", height, 1.0, K_T, stiffness), rtol=1e-9)


# --- manufactured solution -------------------------------------------------------------------------------------------

A, B, Q, LENGTH = 0.3, 2.0, 1.5, 3.0  # κ_T², K_T/K and k/K of the continuum equations, and the length of the slider


def manufactured(right):
    """u_t(x), even about the left edge; u and u_b follow from the two continuum equations."""
    x = np.polynomial.Polynomial([0, 1 / LENGTH])
    if right == "semi-infinite":  # nothing at all beyond the resolved part, and smoothly so
        f = (1 - x**2) ** 10
    elif right == "free":  # no slope at x = L either, in u_t nor in u
        f = 1 + 20 * (x * (1 - x)) ** 4
    else:  # neither layer moves at x = L
        f = (1 - x**2) ** 3
    u = f - f.deriv(2) / A
    return f, u, u - (u.deriv(2) - B * (u - f)) / Q


def discretisation_error(right, sites):
    # sites at the middle of cells of length h; the left face at x = 0, the wall of a clamped end at x = L
    h = LENGTH / (sites + 0.5) if right == "clamped" else LENGTH / sites
    x = (np.arange(sites) + 0.5) * h
    f, u, u_b = manufactured(right)
    K_L, K_T, k = B / A, B * h**2, Q * h**2  # of a cell, in units of its bond of the interfacial layer
    one, zero = jnp.ones(()), jnp.zeros(())
    end = {
        "free": Springs(zero, zero, zero),
        "clamped": Springs(one * K_L, one, zero),
        "semi-infinite": endless(Springs(one * K_L, one, one * K_T), one * k),
    }[right]
    cells = Chain(
        upper=jnp.full(sites - 1, K_L),
        layer=jnp.ones(sites - 1),
        across=jnp.full(sites, K_T),
        contact=jnp.full(sites, k),
        threshold=jnp.ones(sites),
        prestress=jnp.zeros(sites),
        stiffness=one * k,
        height=one * K_L,
        end=end,
    )
    found = jax.jit(equilibrium)(cells, State(jnp.asarray(u_b(x)), jnp.asarray(f(x[0]))))
    return max(np.abs(found.layer - u(x)).max(), np.abs(found.upper - f(x)).max())


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
def test_continuum_equations_are_approached_at_second_order(right):
    # the left edge asks u'(0) = 0 and imposes u_t; the manufactured u has both
    assert abs(manufactured(right)[1].deriv()(0.0)) < 1e-9
    errors = [discretisation_error(right, n) for n in (100, 200, 400, 800)]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


# --- nonlinear contacts ----------------------------------------------------------------------------------------------


def hardening(stretch):
    return stretch + 0.3 * stretch**3


@pytest.mark.ci
@pytest.mark.parametrize(
    "law", [jnp.tanh, hardening, *(pytest.param(x, marks=pytest.mark.slow) for x in (jnp.arctan, jnp.sinh))]
)
def test_nonlinear_contacts_against_a_general_root_finder(law):
    rng = np.random.default_rng(5)
    for right in ENDS:
        dense, mine, state = random_case(rng, 12, right)
        nonlinear = Chain(**{**{f: getattr(mine, f) for f in mine.__dataclass_fields__}, "law": Partial(law)})
        found = equilibrium(nonlinear, state)
        assert found.status == Outcome.SOLVED
        one = jax.tree.map(lambda x: x[None], (nonlinear, found))
        assert np.all(found.residual <= balance_bound(*one))

        def balance(x, dense=dense, state=state):
            forces = dense.matrix @ x
            z = x[12:] - np.asarray(state.pinning)
            forces[12:] += dense.k * (np.asarray(law(z)) - z) - dense.k * np.asarray(state.pinning)
            forces[0] = x[0] - float(state.load)
            return forces

        start = np.concatenate(dense.at(state.pinning, float(state.load)).fields())
        x, _, ok, _ = fsolve(balance, start, full_output=True, xtol=1e-14)
        assert np.abs(balance(x)).max() < 1e-9, ok
        np.testing.assert_allclose(np.concatenate([found.upper, found.layer]), x, rtol=0, atol=1e-8)


# --- derivatives -----------------------------------------------------------------------------------------------------


LAWS = [pytest.param(None, id="linear", marks=pytest.mark.slow), pytest.param(jnp.tanh, id="tanh")]
"""The second takes every step of the first, and more."""


def from_parameters(law, parameters):
    """A scalar of the solution, from a flat dictionary of every input."""
    p = dict(parameters)
    state = State(p.pop("pinning"), p.pop("load"))
    slider = sp.Slider(height=p.pop("height"), stiffness=p.pop("stiffness"), poisson=p.pop("poisson"))
    found = equilibrium(chain(slider, sites=9, law=law, **p), state)
    weight = jnp.cos(jnp.arange(9.0))
    return weight @ found.layer + weight @ found.stress + jnp.sin(weight @ found.upper) + found.push


def random_parameters(rng):
    n = 9
    return {
        "height": rng.uniform(2, 40),
        "stiffness": 10 ** rng.uniform(-2, -0.5),
        "poisson": rng.uniform(0, 0.45),
        "contact": 10 ** rng.uniform(-2, 0, n),
        "prestress": rng.uniform(-0.2, 0.3, n),
        "upper": rng.uniform(2, 40, n - 1),
        "layer": rng.uniform(0.5, 2, n - 1),
        "pinning": rng.uniform(-0.3, 0.3, n),
        "load": rng.uniform(0.5, 3),
    }


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_derivatives_forward_reverse_and_second_order_at_200_points(law):
    rng = np.random.default_rng(0)
    points = batch([jax.tree.map(jnp.asarray, random_parameters(rng)) for _ in range(200)])
    # directions of the size of the parameters themselves, so that none drowns in the others
    ways = jax.tree.map(lambda x: jnp.asarray(rng.uniform(-1, 1, x.shape)) * (0.1 + jnp.abs(x)), points)
    along = jax.vmap(lambda p, v, e: from_parameters(law, jax.tree.map(lambda x, y: x + e * y, p, v)), (0, 0, None))
    value = jax.jit(along)
    forward = jax.jit(jax.vmap(lambda p, v: jax.jvp(lambda x: from_parameters(law, x), (p,), (v,))[1]))(points, ways)
    gradient = jax.jit(jax.vmap(jax.grad(lambda x: from_parameters(law, x))))(points)
    reverse = sum(
        jnp.sum((g * v).reshape(200, -1), axis=1) for g, v in zip(*map(jax.tree.leaves, (gradient, ways)), strict=True)
    )
    scale = sum(
        jnp.sum(jnp.abs(g * v).reshape(200, -1), axis=1) for g, v in zip(*map(jax.tree.leaves, (gradient, ways)), strict=True)
    )
    # fourth-order differences: truncation and rounding both far below 1e-6 at this step
    h = 1e-3
    difference = (
        (8 * (value(points, ways, h) - value(points, ways, -h)) - value(points, ways, 2 * h) + value(points, ways, -2 * h))
        / 12
        / h
    )
    assert np.abs((forward - reverse) / scale).max() < 1e-12
    assert np.abs((forward - difference) / scale).max() < 1e-6
    assert all(np.all(np.any(g.reshape(200, -1) != 0, axis=1)) for g in jax.tree.leaves(gradient))


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_second_derivatives(law):
    rng = np.random.default_rng(1)
    p = jax.tree.map(jnp.asarray, random_parameters(rng))
    v = jax.tree.map(lambda x: jnp.asarray(rng.uniform(-1, 1, x.shape)) * (0.1 + jnp.abs(x)), p)

    def f(x):
        return from_parameters(law, x)

    def dot(a, b):
        return sum(jnp.vdot(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))

    def g(x):
        return dot(jax.grad(f)(x), v)

    def at(e):
        return jax.tree.map(lambda x, y: x + e * y, p, v)

    slope = jax.jit(g)
    over = dot(jax.jit(lambda: jax.jvp(jax.grad(f), (p,), (v,))[1])(), v)  # forward over reverse
    again = dot(jax.jit(jax.grad(g))(p), v)  # reverse over reverse
    twice = jax.jit(lambda: jax.jvp(lambda e: jax.jvp(lambda d: f(at(d)), (e,), (1.0,))[1], (0.0,), (1.0,))[1])()
    h = 1e-3
    difference = (8 * (slope(at(h)) - slope(at(-h))) - slope(at(2 * h)) + slope(at(-2 * h))) / 12 / h
    np.testing.assert_allclose([over, again, twice], difference, rtol=1e-6)
    np.testing.assert_allclose([over, again], twice, rtol=1e-10)


@pytest.mark.ci
@pytest.mark.parametrize("law", LAWS)
def test_implicit_and_unrolled_routes_agree(law):
    """Differentiate through the elimination itself, and through Newton's steps one by one."""
    rng = np.random.default_rng(2)
    p = jax.tree.map(jnp.asarray, random_parameters(rng))

    def unrolled(parameters):
        q = dict(parameters)
        state = State(q.pop("pinning"), q.pop("load"))
        slider = sp.Slider(height=q.pop("height"), stiffness=q.pop("stiffness"), poisson=q.pop("poisson"))
        c = chain(slider, sites=9, law=law, **q)

        def step(x, _):
            z = x[1] - state.pinning
            slope = jnp.ones(9) if law is None else jax.vmap(jax.grad(law))(z)
            dx = respond(c, c.contact * slope, eliminate(c, c.contact * slope), imbalance(c, state, x))
            return (x[0] + dx[0], x[1] + dx[1]), None

        start = (jnp.zeros(9).at[0].set(state.load), jnp.zeros(9))
        x, _ = jax.lax.scan(step, start, length=1 if law is None else 12)
        stress, weight = c.stress(x[1], state.pinning), jnp.cos(jnp.arange(9.0))
        push = c.upper[0] * (x[0][0] - x[0][1]) + c.across[0] * (x[0][0] - x[1][0])
        return weight @ x[1] + weight @ stress + jnp.sin(weight @ x[0]) + push

    implicit = jax.jit(jax.grad(lambda x: from_parameters(law, x)))(p)
    through = jax.jit(jax.grad(unrolled))(p)
    for name in p:
        np.testing.assert_allclose(implicit[name], through[name], rtol=1e-9, atol=1e-11, err_msg=name)


def test_parameters_of_a_force_law_have_derivatives():
    def pushed(strength):
        law = Partial(lambda s, z: z + s * z**3, strength)
        c = chain(FIG2, sites=20, law=law)
        return equilibrium(c, c.relaxed(2.0)).push

    pushed, h = jax.jit(pushed), 1e-4
    np.testing.assert_allclose(jax.jit(jax.grad(pushed))(0.2), (pushed(0.2 + h) - pushed(0.2 - h)) / (2 * h), rtol=1e-6)


# --- statuses and precision ------------------------------------------------------------------------------------------


def with_cut(cut_upper, detached_from, sites=8):
    upper, layer, contact = np.full(sites - 1, 25.0), np.ones(sites - 1), np.full(sites, 0.03)
    contact[detached_from:] = 0
    if cut_upper is not None:
        upper[cut_upper] = layer[cut_upper] = 0
    return chain(ended(FIG2, sites), contact=contact, upper=upper, layer=layer)


@pytest.mark.ci
def test_detaching_everything_moves_the_chain_as_one():
    c = with_cut(None, 0)
    found = equilibrium(c, c.relaxed(2.0))
    assert found.status == Outcome.SOLVED
    np.testing.assert_allclose(found.layer, 2.0, rtol=1e-13)
    np.testing.assert_array_equal(found.stress, 0.0)
    np.testing.assert_allclose(found.push, 0.0, atol=1e-13)


@pytest.mark.ci
def test_a_floating_part_is_a_status_and_never_a_nan():
    floating, whole = with_cut(4, 5), with_cut(4, 8)
    found = solve(batch([floating, whole]), batch([floating.relaxed(2.0)] * 2))
    np.testing.assert_array_equal(found.status, [Outcome.SINGULAR, Outcome.SOLVED])
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(found))
    alone = solve(batch([whole]), batch([whole.relaxed(2.0)]))
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[1], b[0]), found, alone)
    held = np.asarray(found.layer[0][:5])
    np.testing.assert_allclose(held, found.layer[1][:5], rtol=1e-14)


@pytest.mark.ci
def test_a_lane_that_is_not_a_number_leaves_the_others_alone():
    c = chain(FIG2, sites=30)
    states = State(jnp.zeros((3, 30)), jnp.array([1.0, jnp.nan, 3.0]))
    found = jax.jit(jax.vmap(equilibrium, (None, 0)))(c, states)
    np.testing.assert_array_equal(found.status, [Outcome.SOLVED, Outcome.INVALID, Outcome.SOLVED])
    good = jax.jit(jax.vmap(equilibrium, (None, 0)))(c, State(jnp.zeros((3, 30)), jnp.array([1.0, 2.0, 3.0])))
    np.testing.assert_array_equal(np.asarray(found.layer)[[0, 2]], np.asarray(good.layer)[[0, 2]])
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(found))


@pytest.mark.ci
def test_no_number_is_called_solved_that_is_none():
    """Light contacts on stiff bodies, whose forces are less than the last digits of the bonds'; and numbers that overflow."""
    rigid = chain(ended(sp.Slider(25.0, 1e-12, -0.9999999999), 4))
    found = equilibrium(rigid, rigid.relaxed(1000.0))
    assert found.status == Outcome.SOLVED
    assert found.residual < 1e-14
    np.testing.assert_allclose(found.push, 4e-9, rtol=1e-6)  # four contacts of k/K = 1e-12 at u = 1000
    np.testing.assert_allclose(found.stress, 1000.0, rtol=1e-6)
    rng = np.random.default_rng(9)
    solved = 0
    for load in 10 ** rng.uniform(250, 308, 40):
        for slider in sp.Slider(25.0, 0.03, 0.3), sp.Slider(1e9, 1e3, -0.9):
            c = chain(slider, sites=30)
            one = solve(batch([c]), batch([c.relaxed(load)]))
            whole = all(np.isfinite(x).all() for x in jax.tree.leaves(one))
            assert one.status[0] == (Outcome.SOLVED if whole else Outcome.INVALID)
            assert one.residual[0] < 1e-8 or one.status[0] != Outcome.SOLVED
            solved += whole
    assert 20 < solved < 80


@pytest.mark.ci
@pytest.mark.parametrize("law", [lambda z: z + 200 * z**5, lambda z: jnp.expm1(8 * z) / 8], ids=["quintic", "exponential"])
def test_newton_on_laws_that_stiffen(law):
    """Whole steps of Newton's method overshoot by ever more there; a third program finds the equilibrium from forces alone."""
    c = chain(ended(FIG2, 3), law=law)
    found = equilibrium(c, c.relaxed(10.0))
    assert found.status == Outcome.SOLVED

    def forces(x):
        upper, layer = np.array([10.0, *x[:2]]), x[2:]
        bonds = [k * np.diff(u) for k, u in ((np.asarray(c.upper), upper), (np.asarray(c.layer), layer))]
        across = np.asarray(c.across) * (layer - upper)
        along = [np.append(f, 0) - np.append(0, f) for f in bonds]
        return np.concatenate([(along[0] + across)[1:], along[1] - across - np.asarray(c.contact_force(layer))])

    expected = root(forces, np.zeros(5), method="lm", options={"xtol": 1e-14, "ftol": 1e-14}).x
    np.testing.assert_allclose(np.concatenate([found.upper[1:], found.layer]), expected, rtol=1e-8)


@pytest.mark.ci
def test_an_equilibrium_between_two_sides_of_a_small_jump_is_none():
    """The stress on contact 0 jumps by 2e-7 where it would have to balance: far above rounding, however small."""
    plain = chain(FIG2, sites=5)
    stretch = equilibrium(plain, plain.relaxed(0.7)).layer[0]
    c = chain(FIG2, sites=5, law=lambda z: z + jnp.where(z > stretch, 1e-7, -1e-7) * (jnp.arange(5) == 0))
    assert equilibrium(c, c.relaxed(0.7)).status == Outcome.NOT_CONVERGED


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
def test_residual_compares_with_what_the_springs_exert_by_themselves(right):
    """Of chains without an equilibrium, from the stiffness matrix and its absolute values; the largest often at the end."""
    rng, sites, slider = np.random.default_rng(9), 4, (3.0, 0.1, 0.3)
    law = Partial(lambda z: jnp.where(z > 0, 1.0, -1.0) + 0 * z)
    *_, across, _, end = uniform_springs(*slider, sites, right)
    for _ in range(12):
        fields = {name: rng.uniform(0.05, 2, count) for name, count in (("upper", 3), ("layer", 3), ("contact", sites))}
        mine = chain(ended(sp.Slider(*slider), sites, right), sites=sites, law=law, **fields)
        state = State(jnp.asarray(rng.uniform(-1, 1, sites) * [0, 0, 1, 5]), jnp.asarray(rng.uniform(0, 0.3)))
        found = solve_one(mine, state)
        bonds = stiffness_matrix(fields["upper"], fields["layer"], across, np.zeros(sites), end)
        u, stretch = np.concatenate([found.upper, found.layer]), np.asarray(found.layer - state.pinning)
        net, gross = -bonds @ u, np.abs(bonds) @ np.abs(u)
        net[sites:] -= fields["contact"] * np.where(stretch > 0, 1, -1)
        gross[sites:] += fields["contact"] * (1 + np.abs(found.layer) + np.abs(state.pinning))
        net[0] = 0
        assert found.status == Outcome.NOT_CONVERGED
        assert found.residual == pytest.approx(np.abs(net).max() / gross.max(), rel=1e-9)


@pytest.mark.ci
def test_newton_that_cannot_converge_says_so():
    c = chain(FIG2, sites=5, law=lambda z: 0 * z + jnp.where(z > 0, 1.0, -1.0))  # a law that jumps has no slope to follow
    found = equilibrium(c, c.relaxed(0.7))
    assert found.status == Outcome.NOT_CONVERGED
    assert found.residual > 1e-6


@pytest.mark.ci
@pytest.mark.parametrize("right", ENDS)
def test_float32(right):
    rng = np.random.default_rng(3)
    cases = [random_case(rng, 120, right) for _ in range(25)]
    double = batch([c[1] for c in cases]), batch([c[2] for c in cases])
    exact = solve(*double)
    with jax.enable_x64(False):
        found = solve(*jax.tree.map(lambda x: jnp.asarray(np.asarray(x, np.float32)), double))
        assert found.layer.dtype == jnp.float32
    size = np.abs(exact.layer).max(axis=1, keepdims=True)
    assert (np.abs(np.asarray(found.layer, float) - exact.layer) / size).max() < 1e-5
    assert np.all(found.residual <= balance_bound(double[0], found, 1e-5))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sites": 1}, "sites = 1: must be a whole number, at least 2"),
        ({"contact": [0.03, 0.03]}, r"contact has shape \(2,\): must be \(\) or \(5,\) for 5 sites"),
        ({"contact": -0.5}, "contact = -0.5: must be zero or more"),
        ({"upper": -0.5}, "upper = -0.5: must be zero or more"),
        ({"layer": -0.5}, "layer = -0.5: must be zero or more"),
        ({"threshold": 0.0}, "threshold = 0: must be positive"),
        ({"layer": np.nan}, "layer = nan: must be zero or more"),
    ],
)
def test_refusals(wrong, message):
    with pytest.raises(ValueError, match=message):
        chain(FIG2, **{"sites": 5, **wrong})


def test_uniform_and_relaxed_by_default():
    made = chain(FIG2, sites=5)
    np.testing.assert_array_equal(made.threshold, np.ones(5))
    np.testing.assert_array_equal(made.prestress, np.zeros(5))
    np.testing.assert_array_equal(made.contact, np.full(5, 0.03))
    np.testing.assert_array_equal(made.upper, np.full(4, FIG2.K_L))
    np.testing.assert_array_equal(made.layer, np.ones(4))
    np.testing.assert_array_equal(made.relaxed().pinning, np.zeros(5))
    assert made.relaxed().load == 0


def test_a_batch_of_sliders_is_sent_to_vmap():
    with pytest.raises(ValueError, match=r"chain takes one slider, got a batch of shape \(2,\): use jax.vmap"):
        chain(sp.Slider(height=[25.0, 26.0], stiffness=0.03, poisson=0.3), sites=5)


@pytest.mark.ci
@pytest.mark.parametrize("n", [10_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_a_long_chain_is_in_balance_to_rounding(n):
    rng = np.random.default_rng(4)
    c = chain(FIG2, sites=n, contact=0.03 * rng.uniform(0, 2, n))
    found = jax.jit(equilibrium)(c, State(jnp.asarray(rng.uniform(-1, 1, n)), jnp.asarray(3.0)))
    assert found.status == Outcome.SOLVED
    assert found.residual < 1e-12
