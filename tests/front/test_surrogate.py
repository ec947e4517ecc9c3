"""The smooth break rule: its limit, its derivatives, and that it never turns into a NaN."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import ended
from scipy.integrate import quad
from scipy.special import expit

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.chain import chain
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.events.rupture import nucleate, rupture
from slippulse_jax.front.arrest import arrest, quantity
from slippulse_jax.front.front import runaway_prestress
from slippulse_jax.rules import SmoothBreak


@jax.jit
def length(height, stiffness, poisson, width):
    slider = sp.Slider(height=height, stiffness=stiffness, poisson=poisson)
    given = (slider, None, SmoothBreak(width=width))
    return quantity("length", *given), quantity("status", *given)


STOPPED = [Outcome.ARRESTED, Outcome.NO_DOMINO, Outcome.REBREAK]


@jax.jit
def hard(height, stiffness, poisson):
    """ℓ on a straight line, to which a smooth rule tends as it gets narrower; that of a profile."""
    even = sp.Profile(jnp.ones(1))
    return jax.vmap(lambda *x: arrest(sp.Slider(*x), even, most=10_000).length)(height, stiffness, poisson)


@jax.jit
def in_a_chain(height, width, threshold):
    c = chain(sp.Slider(height=height, stiffness=0.03, poisson=0.3), sites=120, threshold=threshold)
    state, site = nucleate(c)
    return rupture(c, state, trigger=site, rule=SmoothBreak(width=width))


def random_sliders(n, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(5, 60, n), 10 ** rng.uniform(-3, -1, n), rng.uniform(0.05, 0.45, n)


def test_fraction_broken_is_the_distribution_it_says():
    """A logistic law of thresholds around θ, cut off at zero: from its density, by quadrature."""
    for theta, w in [(1.0, 0.1), (0.7, 0.4), (1.3, 1.0)]:
        rule = SmoothBreak(width=w)

        def density(x, theta=theta, w=w):
            s = expit((x - theta) / w)
            return s * (1 - s) / w

        whole = quad(density, 0, np.inf)[0]
        for t in (0.05, 0.6, 1.0, 1.9):
            expected = quad(density, 0, t)[0] / whole
            np.testing.assert_allclose(rule.broken(jnp.asarray(t), jnp.asarray(theta)), expected, rtol=1e-8)
        assert rule.broken(jnp.asarray(-0.5), jnp.asarray(theta)) == 0
        # and the length between two contacts is its integral along the straight line
        for a, b in [(0.2, 1.4), (1.1, 1.1), (1.2, 1.2 + 1e-9), (1.3, 0.1), (1.3, -0.4), (-0.3, 0.9), (-0.2, -0.1)]:
            xs, ends = np.polynomial.legendre.leggauss(60), np.clip([a, b], 0, None)  # nothing breaks where it is not pulled
            inside = rule.broken(jnp.asarray(ends[0] + (ends[1] - ends[0]) * (xs[0] + 1) / 2), jnp.asarray(theta)[None])
            share = (ends[1] - ends[0]) / (b - a) if a != b else 1.0
            line = share * (xs[1] @ np.asarray(inside)) / 2
            found = rule.overloaded_length(*map(jnp.asarray, (a, b, theta, theta)))
            np.testing.assert_allclose(found, line, rtol=1e-7)


@pytest.mark.ci
def test_narrow_rule_is_the_hard_model():
    h, q, nu = random_sliders(200, 1)
    exact = np.asarray(hard(h, q, nu))
    found, status = length(h, q, nu, np.full(200, 1e-6))
    assert np.isin(status, STOPPED).all()
    # all but those with a contact within some 1e-5 of its threshold
    near = np.abs(np.asarray(found) - exact)
    assert (near < 1e-6).mean() > 0.98
    assert near.max() < 1


@pytest.mark.ci
def test_mean_bias_vanishes_at_second_order():
    """Over many sliders, whose last contact comes as near to its threshold as it happens to.

    Only sliders within ~w of a contact on its threshold notice the width, a part of them in proportion to w, and those by
    about as much in proportion to w: w² on average, though for each slider alone the bias falls exponentially.
    """
    h, q, nu = random_sliders(2000, 2)
    exact = np.asarray(hard(h, q, nu))
    keep = exact > 2
    widths = 10.0 ** -np.arange(3.0, 4.6, 0.5)
    bias = [np.abs(np.asarray(length(h, q, nu, np.full(2000, w))[0]) - exact)[keep].mean() for w in widths]
    rates = np.diff(np.log(bias)) / np.diff(np.log(widths))
    np.testing.assert_allclose(rates, 2.0, atol=0.2)


@pytest.mark.ci
def test_one_slider_has_an_exponentially_small_bias():
    """Once w is small beside every |t − θ|, the bias falls faster than any power of w."""
    widths = np.array([4e-3, 2e-3, 1e-3, 5e-4])
    bias = np.abs(np.asarray(length(25.0, 0.03, 0.3, widths)[0]) - 25.7898112750714)  # on a straight line, by dense solves
    rates = np.diff(np.log(bias)) / np.diff(np.log(widths))
    assert np.all(np.diff(rates) > 0)
    assert rates[-1] > 3


@pytest.mark.ci
@pytest.mark.parametrize(
    ("n", "tallest", "softest"), [(300, 50.0, 1e-3), pytest.param(3000, 300.0, 1e-5, marks=pytest.mark.slow)]
)
def test_never_a_nan_in_value_or_gradient(n, tallest, softest):
    rng = np.random.default_rng(3)
    h, q, nu = rng.uniform(1.05, tallest, n), 10 ** rng.uniform(np.log10(softest), 0, n), rng.uniform(-0.9, 0.5, n)
    w = 10 ** rng.uniform(-6, 0, n)
    w[: n // 30], w[n // 30 : n // 15] = 1e-6, 1.0
    found, status = length(h, q, nu, w)
    assert np.isin(status, STOPPED).all()
    assert np.isfinite(found).all()
    gradient = jax.jit(jax.vmap(jax.grad(lambda x: length(*x)[0])))(jnp.stack(list(map(jnp.asarray, (h, q, nu, w))), -1))
    assert np.isfinite(gradient).all()


@pytest.mark.ci
def test_derivatives_forward_and_reverse_at_200_points():
    h, q, nu = random_sliders(200, 4)
    w = 10 ** np.random.default_rng(5).uniform(-2.3, 0, 200)
    points = jnp.stack(list(map(jnp.asarray, (h, q, nu, w))), -1)
    ways = jnp.asarray(np.random.default_rng(6).uniform(-1, 1, (200, 4))) * points
    f = jax.jit(jax.vmap(lambda x: length(*x)[0]))
    forward = jax.jit(jax.vmap(lambda x, v: jax.jvp(lambda y: length(*y)[0], (x,), (v,))[1]))(points, ways)
    gradient = jax.jit(jax.vmap(jax.grad(lambda x: length(*x)[0])))(points)
    step = 1e-5
    e = step * np.minimum(1, points[:, 3:] / 0.05)  # the narrower the rule, the sharper the bends
    difference = (8 * (f(points + e * ways) - f(points - e * ways)) - f(points + 2 * e * ways) + f(points - 2 * e * ways)) / 12
    difference = np.asarray(difference / e[:, 0])
    scale = np.abs(np.asarray(gradient * ways)).sum(-1) + 1e-3
    assert np.abs((forward - (gradient * ways).sum(-1)) / scale).max() < 1e-10
    assert np.abs((np.asarray(forward) - difference) / scale).max() < 1e-4
    assert np.all(np.abs(gradient).max(-1) > 0)


@pytest.mark.ci
def test_chain_and_recursion_give_the_same_smooth_length():
    for height, width in [(10.0, 0.01), (25.0, 0.03), (25.0, 1e-3)]:
        found = in_a_chain(height, width, jnp.ones(120))
        np.testing.assert_allclose(found.length, length(height, 0.03, 0.3, width)[0], rtol=1e-9)


def test_rupture_of_a_chain_approaches_the_hard_one():
    rng = np.random.default_rng(7)
    threshold = jnp.asarray(1 + 0.01 * rng.uniform(-1, 1, 120))
    c = chain(sp.Slider(height=25.0, stiffness=0.03, poisson=0.3), sites=120, threshold=threshold)
    state, site = nucleate(c)
    exact = rupture(c, state, trigger=site)
    order = np.asarray(exact.order[: int(exact.breaks)])
    assert site == 0
    assert np.all(np.diff(order) == 1)  # one front from left to right: the case the sweep stands for
    n = len(order)
    over = np.append(exact.released[1:n] - threshold[1:n], exact.after.stress[n] - threshold[n])
    for width in (1e-4, 3e-5, 1e-6):
        tolerance = 20 * np.exp(-np.abs(over).min() / width) + 1e-9
        found = in_a_chain(25.0, width, threshold)
        assert found.status == Outcome.ARRESTED
        np.testing.assert_allclose(found.length, exact.length, atol=tolerance)
        np.testing.assert_allclose(found.slip, exact.slip, atol=tolerance)
        np.testing.assert_allclose(found.energy, exact.energy, rtol=tolerance)


@pytest.mark.ci
def test_rupture_from_the_middle_of_a_chain_approaches_the_hard_one():
    """Contacts before the trigger are too strong to break; the length counts them all the same."""
    threshold = jnp.where(jnp.arange(120) < 5, 10.0, 1.0)
    c = chain(sp.Slider(height=25.0, stiffness=0.03, poisson=0.3), sites=120, threshold=threshold)
    state, site = nucleate(c)
    exact = rupture(c, state, trigger=site)
    assert site == 5
    assert exact.order[: int(exact.breaks)].tolist() == list(range(5, 5 + int(exact.breaks)))
    found = in_a_chain(25.0, 1e-6, threshold)
    assert exact.breaks > 10
    assert (found.breaks, found.extent) == (exact.breaks, exact.extent)
    np.testing.assert_allclose(found.length, exact.length, atol=1e-9)
    np.testing.assert_allclose(found.slip, exact.slip, atol=1e-9)


@pytest.mark.ci
@pytest.mark.parametrize("quantity", ["length", pytest.param("energy", marks=pytest.mark.slow)])
def test_derivatives_of_a_smooth_rupture_in_every_threshold(quantity):
    rng = np.random.default_rng(8)
    threshold = jnp.asarray(1 + 0.03 * rng.uniform(-1, 1, 120))

    def f(threshold):
        return getattr(in_a_chain(25.0, 0.02, threshold), quantity)

    reverse = jax.jit(jax.grad(f))(threshold)
    way = jnp.asarray(rng.uniform(-1, 1, 120))
    forward = jax.jit(lambda: jax.jvp(f, (threshold,), (way,))[1])()
    h = 1e-5
    difference = (f(threshold + h * way) - f(threshold - h * way)) / (2 * h)
    np.testing.assert_allclose(reverse @ way, forward, rtol=1e-9)
    np.testing.assert_allclose(forward, difference, rtol=1e-5)
    assert (np.abs(reverse[:20]) > 0).all()  # contacts passed by the front, too, hold it back a little


def test_broadcasting_and_statuses():
    slider = sp.Slider(height=np.array([10.0, 25.0])[:, None], stiffness=np.array([0.03, 0.01, 0.003]), poisson=0.3)
    rule = SmoothBreak(width=0.01)
    found = sp.precursor_length(slider, rule=rule)
    assert found.shape == (2, 3)
    np.testing.assert_allclose(found[1, 0], length(25.0, 0.03, 0.3, 0.01)[0], rtol=1e-13)
    found, status = length(-1.0, 0.03, 0.3, 0.01)
    assert status == Outcome.INVALID
    assert np.isnan(found)


@pytest.mark.ci
def test_float32():
    h, q, nu = random_sliders(100, 9)
    exact = np.asarray(length(h, q, nu, np.full(100, 0.02))[0])
    with jax.enable_x64(False):
        single = [jnp.asarray(x, jnp.float32) for x in (h, q, nu, np.full(100, 0.02))]
        found, _ = length(*single)
        assert found.dtype == jnp.float32
    np.testing.assert_allclose(np.asarray(found), exact, rtol=1e-3)


# --- interfaces, profiles and ends: against the sweep of a chain, and against the hard length ---


FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)
SPREAD = np.random.default_rng(10).uniform(0, 1, (2, 119))
ROUGH = sp.Profile(np.append(0.9, 0.97 + 0.06 * SPREAD[0]), np.append(0, 0.1 * SPREAD[1]))
CONTACTS = [None, sp.Interface(0.2, 0.002), sp.Interface(-0.1), ROUGH]


@pytest.mark.ci
@pytest.mark.parametrize("right", ["semi-infinite", "free", "clamped"])
@pytest.mark.parametrize("contacts", CONTACTS, ids=lambda x: type(x).__name__)
def test_any_interface_against_the_sweep_of_a_chain(contacts, right):
    sites = 120 if right == "semi-infinite" else 80
    site = np.arange(sites)
    theta, phi = (1.0, 0.0) if contacts is None else (contacts.threshold_at(site), contacts.prestress_at(site))
    c = chain(ended(FIG2, sites, right), sites=sites, threshold=theta, prestress=phi)
    state, first = nucleate(c)
    ends = {} if right == "semi-infinite" else {"right": right, "sites": sites}
    for width in (0.02, 3e-3):
        expected = rupture(c, state, trigger=0, rule=SmoothBreak(width=width))
        assert first == 0
        found = sp.precursor_length(ended(FIG2, **ends), contacts, rule=SmoothBreak(width=width))
        np.testing.assert_allclose(found, expected.length, rtol=1e-9)
        if not isinstance(contacts, sp.Profile):
            bulk = sp.precursor_lengths(ended(FIG2, **ends), contacts, rule=SmoothBreak(width=width))
            np.testing.assert_allclose(bulk, found, rtol=1e-12)


@pytest.mark.ci
@pytest.mark.parametrize("contacts", CONTACTS, ids=lambda x: type(x).__name__)
@pytest.mark.parametrize("ends", [{}, {"right": "free", "sites": 100.3}, {"right": "clamped", "sites": 45.3, "machine": 3.0}])
def test_any_interface_approaches_the_hard_length_on_a_straight_line(contacts, ends):
    """As a profile of the same contacts has it; the curve of ℓ ends beside it, by what the documentation says."""
    even, site = contacts or sp.Interface(), np.arange(120)
    profile = even if isinstance(even, sp.Profile) else sp.Profile(even.threshold_at(site), even.prestress_at(site))
    line = sp.precursor_length(ended(FIG2, **ends), profile)
    assert 5 < line < 100
    error = [abs(sp.precursor_length(ended(FIG2, **ends), contacts, rule=SmoothBreak(width=w)) - line) for w in (1e-2, 1e-6)]
    assert error[1] < 1e-9 < error[0]
    beside = abs(sp.precursor_length(ended(FIG2, **ends), contacts) - line)
    assert (beside == 0) if even is profile else (0 < beside < 0.01)


@pytest.mark.slow
def test_a_front_that_reaches_the_end_runs_through():
    """As the sweep of a chain has it: where more than half of the last contact breaks."""
    rule, last = SmoothBreak(width=0.02), []
    for sites in range(40, 70, 2):
        c = chain(ended(FIG2, sites))
        state, site = nucleate(c)
        event = rupture(c, state, trigger=site, rule=rule)
        found = sp.precursor_length(ended(FIG2, sites), rule=rule)
        assert bool(np.isinf(found)) == (event.status == Outcome.RAN_THROUGH)
        last.append(float(found))
        np.testing.assert_allclose(found, event.length, rtol=1e-9)
    assert np.isinf(last[0])
    assert np.isfinite(last[-1])


@pytest.mark.ci
def test_prestress_without_end():
    """Beyond the run-away prestress, and where the prestress alone breaks a part of every contact, nothing stops the front."""
    critical = float(runaway_prestress(lattice_modes(FIG2)))
    found = [
        float(sp.precursor_length(FIG2, sp.Interface(phi), rule=SmoothBreak(1e-3))) for phi in (0.9 * critical, 1.1 * critical)
    ]
    np.testing.assert_allclose(found[0], sp.precursor_length(FIG2, sp.Interface(0.9 * critical)), rtol=0.02)
    assert np.isinf(found[1])
    assert np.isinf(sp.precursor_length(FIG2, sp.Interface(0.3), rule=SmoothBreak(0.1)))
    # 7e-11 of every contact are nothing
    leak = float(sp.precursor_length(FIG2, sp.Interface(0.3), rule=SmoothBreak(0.03)))
    c = chain(FIG2, sites=200, prestress=0.3)
    state, site = nucleate(c)
    np.testing.assert_allclose(leak, rupture(c, state, trigger=site, rule=SmoothBreak(0.03)).length, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("ends", [{}, {"right": "clamped", "sites": 45.3, "machine": 3.0}])
def test_derivatives_in_every_number(ends):
    given = [25.0, 0.03, 0.3, 0.1, 0.002, 0.02, *(ends[name] for name in ("sites", "machine") if ends)]

    def f(x):
        more = {"right": ends["right"], "sites": x[6], "machine": x[7]} if ends else {}
        return sp.precursor_length(ended(sp.Slider(x[0], x[1], x[2]), **more), sp.Interface(x[3], x[4]), rule=SmoothBreak(x[5]))

    x = jnp.array(given)
    reverse, forward = jax.jit(jax.grad(f))(x), jax.jit(jax.jacfwd(f))(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-12)
    x, step = np.tile(given, (len(given), 1)), 1e-5 * np.diag(np.abs(given))
    run = jax.jit(jax.vmap(f))
    difference = (8 * (run(x + step) - run(x - step)) - run(x + 2 * step) + run(x - 2 * step)) / (12 * np.diag(step))
    np.testing.assert_allclose(reverse, difference, rtol=1e-6)
    more = {"right": ends["right"], "sites": given[6], "machine": given[7]} if ends else {}
    bulk = sp.precursor_lengths(
        ended(sp.Slider(*given[:3]), **more), sp.Interface(*given[3:5]), rule=SmoothBreak(given[5]), derivatives=1
    )
    np.testing.assert_allclose(
        [
            *jax.tree.leaves(bulk)[1:4],
            *jax.tree.leaves(bulk)[4 + 2 * bool(ends) :],
            *jax.tree.leaves(bulk)[4 : 4 + 2 * bool(ends)],
        ],
        reverse,
        rtol=1e-10,
    )


@pytest.mark.ci
def test_derivatives_in_every_contact_of_a_profile():
    """By the sensitivity's sweep in reverse, and by the loop forward."""
    rule = SmoothBreak(width=0.02)
    by_contact = jax.jit(jax.grad(lambda profile: sp.precursor_length(FIG2, profile, rule=rule)))(ROUGH)
    found = sp.sensitivity(FIG2, ROUGH, sites=120, rule=rule)
    np.testing.assert_allclose(by_contact.threshold, found.threshold, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(by_contact.prestress, found.prestress, rtol=1e-9, atol=1e-9)


def test_refusals():
    with pytest.raises(ValueError, match=r"SmoothBreak.width has shape \(2,\)"):
        sp.precursor_length(FIG2, ROUGH, rule=SmoothBreak(width=np.array([0.01, 0.02])))
