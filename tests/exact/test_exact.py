"""The exact solution against the recursion, arbitrary precision, dense chains, and the values worked out before it."""

import functools
import operator

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from oracles import dense_chain
from oracles.lattice_mp import Chain
from problems import PRESTRESSED, REFERENCE, RUNAWAY
from scipy.optimize import brentq
from strategies import random_sliders

import slippulse_jax as sp
from slippulse_jax.base.status import Outcome
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.exact import crossing, double_series
from slippulse_jax.exact.crossing import series_of
from slippulse_jax.exact.front import exact_fields, exact_front, exact_front_stress, exact_length
from slippulse_jax.front.front import front_stress

FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)


@pytest.fixture(autouse=True)
def sixty_digits():
    with mp.workdps(60):
        yield


@jax.jit
def stresses(theta, s):
    return jax.vmap(lambda s: exact_front_stress(sp.Slider(theta[0], theta[1], theta[2]), s, sp.Interface(theta[3])))(s)


@jax.jit
def plain_stresses(theta, s):
    def one(x):
        solution = series_of(x[:3])
        return jax.vmap(lambda y: double_series.stress(solution, y)[0])(s)

    return jax.lax.map(one, theta)


@jax.jit
def lengths(theta):
    return jax.lax.map(lambda x: exact_front(sp.Slider(x[0], x[1], x[2]), sp.Interface(x[3], x[4])), theta)


def fronts(*rows):
    """`lengths` of few sliders, filled up to the one shape that is compiled."""
    few = np.array(rows, float)
    return [np.asarray(x)[: len(few)] for x in lengths(jnp.asarray(np.resize(few, (60, 5))))]


def length(theta):
    return exact_length(sp.Slider(theta[0], theta[1], theta[2]))


@jax.jit
def modes_of(theta):
    return jax.vmap(lambda x: lattice_modes(sp.Slider(x[0], x[1], x[2])))(theta)


def plain_at(row, s):
    """`plain_stresses` of one slider at few positions, filled up to a shape that is compiled already."""
    return plain_stresses(jnp.asarray(np.tile(np.array(row, float), (60, 1))), jnp.asarray(np.resize(s, 1001)))[0, : len(s)]


def relative(found, expected):
    return abs(float((mp.mpf(float(found)) - expected) / expected))


def test_values_worked_out_before():
    front = exact_front(FIG2)
    np.testing.assert_allclose(front.length, 25.788815261, rtol=0, atol=5e-10)
    np.testing.assert_allclose(front.load, 3.1985, rtol=2e-5)
    assert (front.contacts_broken, front.status) == (26, Outcome.ARRESTED)
    tall = sp.Slider(height=75_000.0, stiffness=1 / (2.6 * 75_000), poisson=0.3)
    np.testing.assert_allclose(exact_front(tall).length, 54194.6893438, rtol=1e-12)


@pytest.mark.ci
def test_exponents_and_amplitudes_worked_out_before():
    @jax.jit
    def leading_terms(x):
        """ρ_1, ρ_2, c_1, c_2 of t = Σ c_j ρ_j^s (1 + …); D(s) of the second series has its share in c_1."""
        solution = series_of(x[:3])
        rho, (c1, c2) = 1 - solution.system.start_gap, solution.amplitude
        return *rho, c1 - c2 * solution.echo[1] / (jnp.exp(-solution.echo_rate[1]) - rho[0]), c2

    found = leading_terms(jnp.asarray([25.0, 0.03, 0.3]))
    np.testing.assert_allclose(found, [0.8626520705, 0.9850641060, -0.3907696, 1.4118621], rtol=0, atol=5.1e-8)
    # far from the edge nothing else is left
    far = plain_at([25.0, 0.03, 0.3], np.array([1000.0]))[0]
    np.testing.assert_allclose(far, found[3] * found[1] ** 1000, rtol=1e-10)


def test_degree_kept():
    """Degree 24 leaves less than 1e-11 where the series converges worst, 28 less than 1e-14."""
    chain = Chain(10, 0.08, 0.3)
    reference = chain.series(44)
    for degree, bound in ((24, 1e-11), (28, 1e-14)):
        t = chain.series(degree)
        assert max(abs(t(s) / reference(s) - 1) for s in (0, 0.5, 2, 7)) < bound


@pytest.mark.parametrize("known", REFERENCE)
def test_length_contacts_and_load_of_the_reference_table(known):
    front = exact_front(sp.Slider(*known.slider))
    assert front.contacts_broken == known.contacts
    np.testing.assert_allclose(front.length, known.exact_length, rtol=1e-11)
    np.testing.assert_allclose(front.load, known.load, rtol=1e-11)


@pytest.mark.ci
def test_prestress_sequence_and_runaway():
    known = [*PRESTRESSED, RUNAWAY]
    length, contacts_broken, load, status = fronts(*([*x.slider, x.prestress, 0.0] for x in known))
    np.testing.assert_allclose(length, [x.exact_length for x in known], rtol=1e-10)
    np.testing.assert_allclose(load, [x.load for x in known], rtol=1e-10)
    assert list(contacts_broken) == [x.contacts for x in known]
    assert status[-1] == Outcome.RUN_AWAY


def against_recursion(sliders, count):
    recursion = jax.jit(
        jax.vmap(lambda x: front_stress(lattice_modes(sp.Slider(x[0], x[1], x[2])), count)),
    )(jnp.asarray(sliders))
    exact = plain_stresses(jnp.asarray(sliders), jnp.arange(count, dtype=float))
    seen = np.abs(recursion) > 1e-280  # below, float64 itself loses digits
    return np.max(np.where(seen, np.abs(exact / np.where(seen, recursion, 1) - 1), 0))


@pytest.mark.ci
def test_every_whole_contact_against_the_recursion():
    assert against_recursion(random_sliders(60, 41), 1001) < 1e-11


@pytest.mark.slow
def test_every_whole_contact_up_to_ten_thousand_against_the_recursion():
    sliders = random_sliders(2000, 42)
    assert max(against_recursion(sliders[i : i + 100], 10_001) for i in range(0, 2000, 100)) < 1e-11


def against_mpmath(sliders, seed):
    rng = np.random.default_rng(seed)
    worst = 0.0
    for H, q, nu in sliders:
        phi = rng.choice([0.0, rng.uniform(0, 0.9)])
        chain = Chain(H, q, nu)
        # from beside the edge to well past the arrest
        s = np.append(rng.uniform(0, 3, 2), rng.uniform(0, 2, 2) * H)
        t = chain.series(44, phi)
        found = stresses(jnp.asarray([H, q, nu, phi]), jnp.asarray(s))
        worst = max(worst, *(relative(x, t(y)) for x, y in zip(found, s, strict=True)))
    return worst


@pytest.mark.ci
def test_real_positions_against_sixty_digits():
    assert against_mpmath(random_sliders(8, 43), 44) < 1e-11


@pytest.mark.slow
def test_real_positions_against_sixty_digits_over_the_whole_domain():
    assert against_mpmath(random_sliders(2000, 45), 46) < 1e-11


@pytest.mark.ci
def test_arbitrary_precision_reference_is_itself_right():
    # the plain series meets the recursion at whole s, and the polynomial through 60 whole s in between
    chain = Chain(6, 0.05, 0.2)
    for phi in (0, 0.3):
        steps, t = chain.recursion(61, phi), chain.series(60, phi)
        assert max(abs(t(s) - x) for s, x in enumerate(steps)) < mp.mpf(10) ** -35
        s = mp.mpf("29.37")
        weights = [mp.mpf(-1) ** i * mp.binomial(60, i) / (s - i) for i in range(61)]
        polynomial = sum(w * x for w, x in zip(weights, steps, strict=True)) / sum(weights)
        assert abs(t(s) / polynomial - 1) < 1e-15


def mp_length(chain, near):
    t = chain.series(44)
    return mp.findroot(lambda s: t(s) - 1, mp.mpf(float(near)), tol=1e-50)


def differentiate(function, x, index, order):
    """Central differences whose error, h⁴ and 10⁻⁶⁰/h^order, is beyond 1e-20."""
    h = mp.mpf(10) ** -9 * x[index]
    at = [function([mp.mpf(v) + (k * h if i == index else 0) for i, v in enumerate(x)]) for k in (-2, -1, 0, 1, 2)]
    if order == 1:
        return (at[0] - 8 * at[1] + 8 * at[3] - at[4]) / (12 * h)
    return (-at[0] + 16 * at[1] - 30 * at[2] + 16 * at[3] - at[4]) / (12 * h**2)


@functools.partial(jax.jit, static_argnums=1)
def length_along_axes(theta, order):
    """ℓ* and its derivatives up to `order` along H and along q; all modes at once are the matter of another test."""

    def along(direction):
        def further(values):
            def and_slope(x):
                found, slopes = jax.jvp(values, (x,), (direction,))
                return (*found, slopes[-1])

            return and_slope

        values = functools.reduce(lambda f, _: further(f), range(order), lambda x: (length(x),))
        return values(theta)

    return jax.vmap(along)(jnp.eye(3)[:2])


def length_against_mpmath(sliders, order):
    """Worst relative errors of ℓ* and of its derivatives (in logarithms of H and q)."""
    worst = np.zeros(1 + order)
    for x in sliders:
        value, *slopes = (np.asarray(y) for y in length_along_axes(jnp.asarray(x), order))
        value = value[0]
        if not value > 0.05:  # nothing to differentiate where no front runs; tiny lengths are ill-conditioned by nature
            continue
        expected = mp_length(Chain(*x), value)
        scale = expected
        worst[0] = max(worst[0], relative(value, expected))
        for i in (0, 1):
            for k, slope in enumerate(slopes, start=1):
                exact = differentiate(lambda y, near=value: mp_length(Chain(*y), near), x, i, k)
                worst[k] = max(worst[k], float(abs(mp.mpf(float(slope[i])) - exact) * mp.mpf(x[i]) ** k / scale))
    return worst


@pytest.mark.ci
def test_length_and_derivatives_against_sixty_digits():
    value, first = length_against_mpmath(random_sliders(2, 47)[1:], order=1)
    assert value < 1e-11
    assert first < 1e-8


@pytest.mark.slow
def test_length_and_derivatives_against_sixty_digits_over_the_domain():
    value, first, second = length_against_mpmath(random_sliders(150, 48), order=2)
    assert value < 1e-10
    assert first < 1e-8
    assert second < 1e-8


def resonance(n, height):
    """k/K at which ρ_2 r_2^{2n} = ρ_1 for this height: there the plain series has a pole."""

    def mismatch(log_q):
        chain = Chain(height, mp.exp(log_q), 0.3)
        rho = chain.roots()
        return float(mp.log(rho[1] * chain.r[1] ** (2 * n) / rho[0]))

    low, high = np.log(0.1), 0.0
    assert mismatch(low) * mismatch(high) < 0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if mismatch(middle) * mismatch(low) > 0 else (low, middle)
    return float(np.exp(low))


@jax.jit
def stress_bend(x):
    """d²t/dq² at s = 2.3."""

    def t(q):
        return plain_stresses(x.at[1].set(q)[None], jnp.asarray([2.3]))[0, 0]

    return jax.jvp(lambda q: jax.jvp(t, (q,), (jnp.ones_like(q),))[1], (x[1],), (jnp.ones_like(x[1]),))[1]


NEAR_POLES = [(1, 2.0), (3, 12.0), (9, 25.0)]
"""n and H/λc."""


@pytest.mark.ci
@pytest.mark.parametrize(
    ("n", "height", "bent"), [(1, 2.0, False), *(pytest.param(*x, True, marks=pytest.mark.slow) for x in NEAR_POLES)]
)
def test_resonances_are_not_seen(n, height, bent):
    """In the stress and, in the slow cases, in its second derivative."""
    q = resonance(n, height)
    mp.mp.dps = 100  # at a distance δ from the pole the reference loses 1/δ² of its digits, and of its convergence
    for nudge in (0, 1e-9):
        x = (height, q * (1 + nudge), 0.3)
        t = Chain(*x).series(90)
        s = np.array([0.3, 2.0, 7.7])
        found = plain_at(x, s)
        assert max(relative(a, t(b)) for a, b in zip(found, s, strict=True)) < 1e-12
        if not bent:
            continue
        bend = stress_bend(jnp.asarray(x))
        two = differentiate(lambda y: Chain(*y).series(90)(2.3), x, 1, 2)
        assert abs(float((mp.mpf(float(bend)) - two) * x[1] ** 2)) < 1e-10


@pytest.mark.ci
def test_choice_of_resonance_does_not_change_the_sum():
    # shifts the nearest n by moving through the boundary between two choices: no jump
    H = np.linspace(8.0, 30.0, 4001)
    t = np.asarray(
        plain_stresses(jnp.stack([jnp.asarray(H), jnp.full(H.shape, 0.03), jnp.full(H.shape, 0.3)], -1), jnp.asarray([1.7]))
    )
    bend = np.diff(t[:, 0], 2)
    assert np.max(np.abs(np.diff(bend))) < 1e-10


@pytest.mark.ci
def test_rise_is_what_the_stress_has_gained():
    """Near the edge and about the crossing; far beyond it nothing is left of t(0) = 1."""
    theta = random_sliders(60, 41).T
    found = jax.jit(series_of)(theta)
    start, slope = double_series.stress(found, np.zeros(60))
    np.testing.assert_allclose(start, 1, rtol=1e-12)
    np.testing.assert_allclose(double_series.rise(found, np.zeros(60))[1], slope, rtol=1e-9, atol=1e-12)
    for s in (1.0, 30.0, 1e9):
        stress, slope = double_series.stress(found, np.full(60, s))
        rise, fall = double_series.rise(found, np.full(60, s))
        np.testing.assert_allclose(rise, stress - 1, atol=1e-12)
        np.testing.assert_allclose(fall, slope, atol=1e-12)
    np.testing.assert_allclose(rise, -1, rtol=1e-12)


@pytest.mark.ci
def test_table_of_a_slider_does_not_depend_on_its_neighbours():
    """Bit for bit, also where a neighbour needs more rows; rows end where they are rounding."""
    table = jax.jit(series_of)
    theta = random_sliders(60, 41).T
    together = table(theta)
    rows = (np.abs(together.table) > 0).any((1, 2)).sum(0)
    assert rows.min() < rows.max() < double_series.ROWS
    for i in range(5):
        alone = table(np.repeat(theta[:, [i]], 60, axis=1))
        for found, expected in zip(together[1:], alone[1:], strict=True):
            np.testing.assert_array_equal(found[..., i], expected[..., i])


@pytest.mark.ci
@pytest.mark.parametrize("n", range(4))
def test_moments_of_a_decay_are_integrals(n):
    z = np.array([-0.9, 0.0, 1e-9, 0.5, np.nextafter(1, 0), 1.0, 1.5, 10.0, 50.0])
    expected = [mp.quad(lambda y, x=x: y**n * mp.exp(-mp.mpf(x) * y), [0, 1]) for x in z]
    found = double_series._moment(n, jnp.asarray(z))
    assert max(map(relative, found, expected)) < 1e-13


def counted(modes, phi, eps):
    """Whole contacts by the recursion in NumPy, prestress and threshold slope included."""
    r, w, R, C = modes
    S, T, E = np.zeros(2), np.zeros(2), np.ones(2)
    for s in range(100_000):
        t = phi + w @ S + E @ ((1 - phi) * C + R @ T)
        if s and t < 1 + eps * s:
            return s
        S, T, E = r * (S + t), T + E * t, r * E
    return -1


@pytest.mark.ci
def test_ceiling_of_the_length_is_the_whole_count():
    rng = np.random.default_rng(49)
    sliders = random_sliders(60, 50)
    sliders[:, 0] = 2 * 150 ** rng.uniform(size=60)
    phi = rng.choice([0, 0, 1], 60) * rng.uniform(-0.5, 0.9, 60)
    slope = rng.choice([0, 1], 60) * rng.choice([-1, 1], 60) * 10 ** rng.uniform(-6, -2, 60)
    theta = np.column_stack([sliders, phi, slope])
    front = lengths(jnp.asarray(theta))
    every = modes_of(jnp.asarray(theta))
    modes = zip(*(np.asarray(x) for x in (every.ratio, every.weight, every.reflection, every.drive)), strict=True)
    for x, m, n, status, length in zip(theta, modes, front.contacts_broken, front.status, front.length, strict=True):
        ahead = m[3] @ m[0] * (1 - x[3]) + x[3]
        if x[4] < 0 and ahead > 1 + x[4]:
            continue  # contact 1 would break before contact 0: not a front that starts at the edge
        assert status in (Outcome.ARRESTED, Outcome.REBREAK, Outcome.NO_DOMINO, Outcome.RUN_AWAY), x
        assert counted(m, *x[3:]) == n, (x, length)


@pytest.mark.parametrize(("low", "high", "most"), [(6, 10, 2e-3), (10, 30, 1e-4), (30, 100, 1e-6), (100, np.inf, 1e-8)])
def test_closed_form_beside_the_curve_of_the_recursion(low, high, most):
    rng = np.random.default_rng(60)
    height, poisson, b = 8 * 400 ** rng.uniform(size=2000), rng.uniform(0.1, 0.45, 2000), 0.03 * 1000 ** rng.uniform(size=2000)
    slider = sp.Slider(height, b / (2 * (1 + poisson) * height), poisson)
    exact, length = sp.exact_lengths(slider), sp.precursor_lengths(slider)
    np.testing.assert_array_equal(np.ceil(exact[exact > 1]), np.ceil(length[exact > 1]))
    assert np.all(length[exact <= 1] == 0)
    here = (exact > low) & (exact < high)
    assert here.sum() > 100
    assert np.abs(exact - length)[here].max() < most


@pytest.mark.ci
def test_closed_form_under_prestress_and_on_slopes_and_in_all_derivatives():
    """In ln H, ln k, ν and φ; a slope departs by more than ℓ, as ℓ departs by ripples of one contact."""
    rng = np.random.default_rng(61)
    height, poisson, b = 8 * 50 ** rng.uniform(size=1500), rng.uniform(0.1, 0.45, 1500), 0.03 * 1000 ** rng.uniform(size=1500)
    slider = sp.Slider(height, b / (2 * (1 + poisson) * height), poisson)
    interface = sp.Interface(rng.uniform(-0.8, 0.5, 1500), rng.uniform(-0.5, 2, 1500) * 0.05 / height)
    exact, found = (f(slider, interface, derivatives=1) for f in (sp.exact_lengths, sp.precursor_lengths))
    np.testing.assert_array_equal(np.isfinite(exact.length), np.isfinite(found.length))
    for low, high, most, slopes in (
        (6, 10, 2e-3, 0.1),
        (10, 30, 1e-4, 7e-3),
        (30, 100, 1e-6, 1.5e-4),
        (100, 1e6, 1e-8, 1.5e-6),
    ):
        here = (exact.length > low) & (exact.length < high)
        assert here.sum() > 100
        assert np.abs(exact.length[here] - found.length[here]).max() < most
        scale = height, slider.stiffness, 1, 1
        for name, x in zip(("slider.height", "slider.stiffness", "slider.poisson", "interface.prestress"), scale, strict=True):
            one, other = ((operator.attrgetter(name)(result) * x)[here] for result in (exact, found))
            assert np.abs(one - other).max() < slopes, (name, low)


def test_no_domino_is_length_zero():
    # just above the threshold of the domino the length leaves zero without a jump
    rows = [[5.0, q, 0.3, 0, 0] for q in np.geomspace(1e-4, 1e-2, 58)]
    length, contacts_broken, _, status = fronts([2.0, 1e-6, 0.3, 0, 0], *rows)
    assert (length[0], contacts_broken[0], status[0]) == (0, 1, Outcome.NO_DOMINO)
    at_once = fronts([2.0, 1e-6, 0.3, 0, -1e-4])  # the threshold falls, but the stress falls faster
    assert (at_once[0][0], at_once[1][0], at_once[3][0]) == (0, 1, Outcome.NO_DOMINO)
    assert length[1] == 0
    assert 0 < length[length > 0][0] < 0.2


def test_falling_thresholds_met_in_a_shallow_dip():
    """The stress falls below its threshold for a few contacts only, which no step of the search may leap over: dense solves."""
    rows = [
        [2.515172213422015, 0.1177717076674809, 0.39352012331160885, -0.1743272564839421, -0.062254966938787445],
        [9.013787037722954, 0.0008064571635537513, 0.013209338640513268, -0.30508982283810615, -0.008165159521624043],
        [5.534470614529353, 0.018771391982251102, 0.26314398235743425, -0.8457750246788698, -0.04673045947740861],
        [6.787054713991983, 0.017951923131668643, 0.2930854308484969, 0.0, -0.01684573287334711],
        [5.507319985084529, 0.0009564850241100305, 0.3756775468053286, 0.4, -0.004112285559740533],
        [3.0503803678348365, 0.03226742783825884, 0.4221603076314818, 0.0, -0.0309391219715589],
    ]
    site, expected = np.arange(90), []
    for *slider, phi, slope in rows:
        expected.append(dense_chain.front(*slider, 1 + slope * site, np.full(90, phi), 0, 90)[0])
    length, contacts_broken, _, status = fronts(*rows)
    assert list(contacts_broken) == expected
    assert (status == Outcome.ARRESTED).all()
    length, _, _, status = fronts([25.0, 0.03, 0.3, -0.2, -0.05])
    assert (np.isinf(length[0]), status[0]) == (True, Outcome.RUN_AWAY), "no threshold is left at contact 20"


def test_falling_thresholds_that_one_contact_alone_is_below():
    """Slopes between the least that stops a front, at one contact, and the next: no step of the search may leap over that one."""
    rng = np.random.default_rng(6)
    sliders = np.column_stack([1 + 10 ** rng.uniform(-0.5, 1.6, 60), 10 ** rng.uniform(-4, -0.5, 60), rng.uniform(0, 0.5, 60)])
    stress = jax.jit(jax.vmap(lambda x: front_stress(lattice_modes(sp.Slider(x[0], x[1], x[2])), 120)))(sliders)
    stopping = (np.asarray(stress)[:, 1:] - 1) / np.arange(1, 120)
    least, following = np.sort(stopping, axis=1)[:, :2].T
    slope = least + rng.uniform(0.1, 0.9, 60) * (following - least)
    assert (slope < 0).all()
    found = fronts(*np.column_stack([sliders, np.zeros(60), slope]))
    np.testing.assert_array_equal(found[1], stopping.argmin(1) + 1)


@pytest.mark.ci
def test_no_crossing_is_leapt_over_and_no_dip_between_contacts_taken():
    """Beyond the run-away prestress, each beside the whole contacts of the recursion."""
    rows = [
        [15.52078737312579, 0.00013753251063659, -0.35489595021500875, 0.940529952211546, 3.034382860328369e-06],
        [1.5813477062745016, 0.0016731326378381782, -0.6490487461169643, 0.960826342534066, 0.0],
        [116.71450415327993, 0.004683632606265626, 0.31399368903267394, 0.6264738924593782, -4.737942873295958e-05],
    ]
    height, stiffness, poisson, phi, slope = np.array(rows).T
    slider, interface = sp.Slider(height, stiffness, poisson), sp.Interface(phi, slope)
    length, contacts_broken, _, status = fronts(*rows)
    assert list(contacts_broken) == [20, -1, -1]
    assert list(status) == [Outcome.ARRESTED, Outcome.RUN_AWAY, Outcome.RUN_AWAY]
    assert 19 < length[0] < 20
    assert np.isinf(length[1:]).all()
    np.testing.assert_allclose(sp.exact_lengths(slider, interface), length, rtol=1e-9)
    over = [float(t - 1 - slope[0] * s) for s, t in enumerate(Chain(*rows[0][:3]).recursion(21, phi[0]))]
    for found in (sp.precursor_length(slider, interface), sp.precursor_lengths(slider, interface)):
        np.testing.assert_allclose(found, [dense_chain.crossing(np.array(over)), np.inf, np.inf], rtol=1e-9)
    # in arbitrary precision, the third until its thresholds have fallen to the prestress
    for row, count, expected in zip(rows, (30, 1000, int((1 - phi[2]) / -slope[2])), (20, 0, 0), strict=True):
        stress = Chain(*row[:3]).recursion(count, row[3])
        below = [t < 1 + row[4] * s for s, t in enumerate(stress)]
        assert below[1:].index(True) + 1 == expected if expected else not any(below[1:])


@pytest.mark.ci
def test_newton_is_kept_within_its_bracket(monkeypatch):
    """On a step whose slope fades on both sides, where plain Newton steps leap away; from every start, within twenty steps."""

    def rise(s):
        return jnp.arctan(7 - s), -1 / (1 + (7 - s) ** 2)

    monkeypatch.setattr(crossing, "STEPS", 20)
    start = jnp.array([0.2, 1.0, 3.0, 6.9, 8.0, 30.0, 900.0])
    for slope in (0.0, 0.01, -0.001):
        fixed = jnp.full_like(start, slope)
        s, before = crossing._newton(rise, fixed, start, 0 * start, 1e-9)
        exact = brentq(lambda x, slope=slope: np.arctan(7 - x) - slope * x, 0, 100, xtol=1e-13)
        np.testing.assert_allclose(s, exact, rtol=1e-12)
        np.testing.assert_allclose(before, exact, rtol=1e-8)
    monkeypatch.setattr(crossing, "STEPS", 30)
    # all but level at the start, and beyond 50 no number: a longer step than to 4 s + 10 would end there
    s, _ = crossing._newton(
        lambda s: (jnp.where(s < 50, 1e-3 * (1 - (s / 20) ** 8), jnp.nan), -8e-3 * s**7 / 20**8), 0 * start[:3], start[:3], 0 * start[:3],
        1e-9,
    )  # fmt: skip
    np.testing.assert_allclose(s, 20, rtol=1e-12)


@pytest.mark.ci
def test_newton_starts_near_the_crossing_of_tall_sliders():
    """By the macroscopic law on soft interfaces, on stiff or prestressed ones by the tail: t(s) all but φ/φ_c + c_2 ρ_2^s."""
    b, phi = np.array([[0.02, 0], [0.1, 0], [30, 0], [100, 0], [30, 0.1], [100, 0.3]]).T
    theta = np.array([np.full(6, 1e6), b / (2 * 1.3 * 1e6), np.full(6, 0.3), phi, np.zeros(6)])
    start = jax.jit(lambda x: crossing._start(series_of(x), x))(theta)
    np.testing.assert_allclose(start[:2], fronts(*theta.T)[0][:2], rtol=0.05)
    np.testing.assert_allclose(start[2:], fronts(*theta.T)[0][2:], rtol=0.01)


@pytest.mark.ci
def test_falling_thresholds_get_the_careful_search_in_bulk():
    """Beside fronts that arrest, never start, and are found without it."""
    rows = [[25.0, 0.03, 0.3, 0, 0], [2.0, 1e-6, 0.3, 0, 0], [25.0, 0.03, 0.3, 0, -1e-3], [40.0, 0.01, 0.3, 0.3, -2e-5],
            [2.0, 1e-6, 0.3, 0.3, 0], [10.0, 0.3, 0.3, 0.3, -1e-4]]  # fmt: skip
    theta = np.array(rows).T
    length, status = crossing.first_crossing(series_of(theta), theta)
    expected, *_, one_by_one = fronts(*rows)
    assert [x == Outcome.NO_DOMINO for x in status] == [False, True, False, False, True, False]
    np.testing.assert_array_equal(status, np.where(one_by_one == Outcome.REBREAK, Outcome.ARRESTED, one_by_one))
    np.testing.assert_allclose(length, expected, rtol=1e-11)


@pytest.mark.ci
def test_differentiation_agrees_in_every_mode():
    def f(x):
        return exact_length(sp.Slider(x[0], x[1], x[2]), sp.Interface(x[3], x[4]))

    @jax.jit
    def forward_and_reverse(x):
        """Of one linearisation, which is all that jvp, jacfwd, grad and jacrev are made of."""
        _, push = jax.linearize(f, x)
        return jax.vmap(push)(jnp.eye(5)), jax.linear_transpose(push, x)(jnp.ones_like(x[0]))[0]

    x = np.array([25.0, 0.03, 0.3, 0.1, 1e-3])
    forward, reverse = forward_and_reverse(x)
    np.testing.assert_allclose(reverse, forward, rtol=1e-12)
    step = 1e-5 * np.diag(np.maximum(x, 1e-2))
    around = fronts(*(x + step), *(x - step))[0]
    np.testing.assert_allclose(reverse, (around[:5] - around[5:]) / (2 * np.diag(step)), rtol=1e-7)
    for gradient in forward_and_reverse(np.array([25.0, 0.03, 0.3, 0.54, 0.0])):  # where the front never stops
        assert not np.isfinite(gradient[3])


@pytest.mark.slow
def test_second_derivatives_agree_in_every_mode():
    def f(x):
        return exact_length(sp.Slider(x[0], x[1], x[2]), sp.Interface(x[3], x[4]))

    x = jnp.asarray([25.0, 0.03, 0.3, 0.1, 1e-3])
    over = jax.jit(jax.jacfwd(jax.jacrev(f)))(x)
    np.testing.assert_allclose(over, over.T, rtol=1e-9, atol=1e-9 * np.abs(over).max())
    np.testing.assert_allclose(over, jax.jit(jax.jacrev(jax.jacfwd(f)))(x), rtol=1e-9, atol=1e-9 * np.abs(over).max())


@pytest.mark.ci
def test_batches_are_the_single_sliders():
    H, q = np.array([[10.0], [25.0]]), np.array([0.003, 0.01, 0.03])
    together = exact_length(sp.Slider(H, q, 0.3))
    assert together.shape == (2, 3)
    for i, j in np.ndindex(2, 3):
        np.testing.assert_allclose(together[i, j], exact_front(sp.Slider(H[i, 0], q[j], 0.3)).length, rtol=1e-13)


@pytest.mark.ci
def test_refused_and_undefined_values():
    with pytest.raises(ValueError, match=r"prestress = 1\.5 at index 1"):
        exact_length(FIG2, sp.Interface(np.array([0.0, 1.5])))
    with pytest.raises(ValueError, match="threshold_slope = -2"):
        exact_length(FIG2, sp.Interface(threshold_slope=-2.0))
    with pytest.raises(ValueError, match="s = -1"):
        exact_front_stress(FIG2, -1.0)
    with pytest.raises(ValueError, match=r"site = 0\.5"):
        exact_fields(FIG2, 3, 0.5)
    for function in (exact_length, exact_front, sp.exact_lengths):
        with pytest.raises(TypeError, match=r"Profile\(…\).*use precursor_length"):
            function(FIG2, sp.Profile(np.ones(3)))
    # traced values
    length, contacts_broken, load, status = fronts(*([h, 0.03, 0.3, p, 0] for h, p in ((-3.0, 0), (np.nan, 0), (25.0, 1.2))))
    assert np.isnan(length).all()
    assert np.isnan(load).all()
    assert (contacts_broken == -1).all()
    assert (status == Outcome.INVALID).all()
    assert np.isnan(length_along_axes(jnp.asarray([-3.0, 0.03, 0.3]), 1)[1]).all()


@pytest.mark.ci
@pytest.mark.usefixtures("float32")
def test_single_precision():
    sliders = random_sliders(40, 51)
    found = exact_front(sp.Slider(*(jnp.asarray(x, jnp.float32) for x in sliders.T)))
    assert found.length.dtype == jnp.float32
    with jax.enable_x64(True):
        expected = fronts(*np.column_stack([np.float32(sliders).astype(float), np.zeros((40, 2))]))[0]
    long = expected > 1
    np.testing.assert_allclose(np.asarray(found.length)[long], expected[long], rtol=1e-3)
