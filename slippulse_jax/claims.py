"""The paper's claims, each measured: what it says, what the model gives, and whether the two agree.

Everything is computed when it is asked for, at the parameters of the paper's Fig. 2 unless said otherwise: H/λc = 25, k/K = 0.03,
ν = 0.3. A claim that does not hold is reported with the reason found.
"""

from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slippulse_jax import theory
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lattice.ageing import Ageing
from slippulse_jax.lattice.bulk import precursor_lengths
from slippulse_jax.lattice.cascade import nucleate, rupture
from slippulse_jax.lattice.catalogue import EventClass, SeriesStatus
from slippulse_jax.lattice.chain import chain, relaxed
from slippulse_jax.lattice.distribution import Kind, ThresholdDistribution, edge_loads, force_law, smooth_width, stability
from slippulse_jax.lattice.dynamics import CrackLike, SelfHealing, quasi_static_break_time, simulate_inertial
from slippulse_jax.lattice.events import Steps, series
from slippulse_jax.lattice.interface_front import runaway_prestress
from slippulse_jax.lattice.modes import lattice_modes
from slippulse_jax.lattice.precursor import first_precursor, precursor_length
from slippulse_jax.slider import Slider

Verdict = Literal["holds", "holds within limits", "does not hold as worded"]

HOLDS: Verdict = "holds"
WITHIN: Verdict = "holds within limits"
FAILS: Verdict = "does not hold as worded"


class Finding(NamedTuple):
    """What was measured of one claim."""

    measured: str
    verdict: Verdict


class Result(NamedTuple):
    """One row of the table of claims."""

    number: str
    says: str
    measured: str
    verdict: Verdict


CLAIMS: dict[str, tuple[str, Callable[[], Finding]]] = {}


def claim(number: str, says: str) -> Callable[[Callable[[], Finding]], Callable[[], Finding]]:
    """Put a measurement into the table."""

    def enter(measure: Callable[[], Finding]) -> Callable[[], Finding]:
        CLAIMS[number] = (says, measure)
        return measure

    return enter


def examine(numbers: list[str] | None = None) -> Iterator[Result]:
    """Measure the claims, in double precision, one after the other.

    Raises
    ------
    ValueError
        If there is no such claim.
    """
    for number in numbers or []:
        if number not in CLAIMS:
            raise ValueError(f"no claim {number!r}: there are {', '.join(CLAIMS)}")
    for number, (says, measure) in CLAIMS.items():
        if numbers is None or number in numbers:
            with jax.enable_x64(True):
                measured, verdict = measure()
            yield Result(number, says, measured, verdict)


def fig2() -> Slider:
    """The slider of the paper's Fig. 2."""
    return Slider(25.0, 0.03, 0.3)


def _verdict(holds: bool) -> Verdict:
    return HOLDS if holds else FAILS


@claim("C1", "Λ = 26 λc at the parameters of Fig. 2")
def _count() -> Finding:
    front = first_precursor(fig2())
    count = int(front.contacts_broken)
    return Finding(f"{count} contacts, ℓ = {float(front.length):.3f} λc (semi-infinite chain)", _verdict(count == 26))


@claim("C2", "as the front passes, u_t hardly changes while u almost doubles")
def _fields() -> Finding:
    front = first_precursor(fig2())
    before, after = front.nucleation, front.arrest
    s0 = int(front.contacts_broken)
    upper = np.asarray(after.upper / before.upper)[:s0].max() - 1
    layer = np.asarray(after.interface / before.interface)[:s0].max()
    text = f"u_t grows by at most {upper:.1%}, u by a factor of up to {layer:.2f} over the broken contacts"
    return Finding(text, HOLDS if upper < 0.1 and layer > 1.8 else WITHIN)


@claim("C3", "the stress peaks at the front, and behind it grows with the distance from it")
def _stress() -> Finding:
    front = first_precursor(fig2())
    stress, s0 = np.asarray(front.arrest.stress), int(front.contacts_broken)
    falling = bool((np.diff(stress[:s0]) < 0).all())
    text = f"largest stress {stress.max():.3f} σ_s on contact {int(stress.argmax())} (front at {s0}); behind it " + (
        f"monotonic, up to {stress[0]:.3f} σ_s at the edge" if falling else "not monotonic"
    )
    return Finding(text, _verdict(falling and int(stress.argmax()) == s0))


@claim("C4", "Λ grows almost linearly with H")
def _height() -> Finding:
    height = np.linspace(10, 50, 41)
    length = precursor_lengths(Slider(height, 0.03, 0.3))
    r2 = np.corrcoef(height, length)[0, 1] ** 2
    slope = np.polyfit(height, length, 1)[0]
    return Finding(f"H/λc = 10–50, k/K = 0.03: slope {slope:.3f}, R² = {r2:.6f} of a straight line", _verdict(r2 > 0.99))


@claim("C5", "Λ grows almost logarithmically with k/K")
def _stiffness() -> Finding:
    stiffness = np.geomspace(0.003, 0.3, 81)
    length = precursor_lengths(Slider(25.0, stiffness, 0.3))
    peak = stiffness[length.argmax()]
    rising = stiffness <= 0.03
    r2 = np.corrcoef(np.log(stiffness[rising]), length[rising])[0, 1] ** 2
    text = (
        f"H/λc = 25: R² = {r2:.4f} of a straight line in ln(k/K) over 0.003–0.03; Λ peaks at k/K = {peak:.3f} and falls beyond, "
        f"so that it is not monotonic"
    )
    return Finding(text, WITHIN)


@claim("C6", "Λ does not depend on σ_s, nor therefore on a uniform normal load")
def _threshold() -> Finding:
    at = [float(first_precursor(fig2(), interface=Profile(np.full(1, t))).length) for t in (0.1, 1.0, 10.0)]
    spread = max(at) - min(at)
    return Finding(f"thresholds of 0.1, 1 and 10: ℓ differs by {spread:.1e} λc", _verdict(spread < 1e-9))


@claim("C7", "Eqs. (58) and (25) agree with the numerics (Fig. 3)")
def _formula() -> Finding:
    sliders = Slider(np.linspace(10, 50, 9)[None, :], np.array([[0.003], [0.01], [0.03]]), 0.3)
    lattice = precursor_lengths(sliders)
    formulas = {"Eq. (25)": theory.length_eq25(sliders), "Eq. (58), corrected,": theory.length(sliders)}
    ratio = {name: np.asarray(length) / lattice for name, length in formulas.items()}
    spans = "; ".join(f"{name} over the lattice {r.min():.3f} to {r.max():.3f}" for name, r in ratio.items())
    text = f"H/λc = 10–50, k/K = 0.003–0.03: {spans}. As printed, Eq. (58) rests on an erroneous Ψ_6 (label cra54)"
    return Finding(text, HOLDS if all(abs(r - 1).max() < 0.03 for r in ratio.values()) else WITHIN)


@claim("C8", "prestress σ_0 lengthens Λ, and beyond a threshold the front never stops")
def _prestress() -> Finding:
    critical = float(runaway_prestress(lattice_modes(fig2())))
    phi = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.53, critical * (1 - 1e-6), critical * (1 + 1e-6)])
    length = precursor_lengths(fig2(), interface=Interface(phi))
    holds = bool((np.diff(length[:-1]) > 0).all() and np.isfinite(length[-2]) and np.isinf(length[-1]))
    soft = Slider(10.381840251071646, 0.024884160056852563, 0.05409050217326783)
    above = float(runaway_prestress(lattice_modes(soft))) + 1e-4
    stopped = float(precursor_length(soft, interface=Interface(above)))
    text = (
        f"Λ = {', '.join(f'{x:.0f}' for x in np.ceil(length[:8]))} at φ = 0–0.53; finite at φ_c(1 − 1e-6), infinite at φ_c(1 + 1e-6), "
        f"φ_c = (1 + G_00)/2 = {critical:.4f}. On softer sliders φ ≥ φ_c is necessary, not sufficient: at H/λc = 10.4, k/K = 0.025, "
        f"ν = 0.05 a front stops after {np.ceil(stopped):.0f} contacts at φ_c + 1e-4"
    )
    return Finding(text, _verdict(holds))


@claim("C9", "Λ(ε) ≈ Λ(0)(1 − ε) for thresholds σ_s0 + μ_s ε x")
def _slope() -> Finding:
    base = float(precursor_length(fig2()))
    slope = np.array([-0.005, 0.001, 0.005, 0.01])
    ratio = precursor_lengths(fig2(), interface=Interface(threshold_slope=slope)) / base
    at_zero = float(jax.grad(lambda e: precursor_length(fig2(), interface=Interface(threshold_slope=e)))(0.0)) / base
    text = (
        f"with ε the rise in σ_s per site, Λ(ε)/Λ(0) = {', '.join(f'{r:.3f} at {e:g}' for e, r in zip(slope, ratio, strict=True))}; "
        f"d ln Λ/dε = {at_zero:.1f} per site, or {at_zero / base:.2f} with ε the rise over Λ(0). The sign is the paper's; the factor "
        "is 1 only if ε is measured over about the length where these agree, which the paper does not state"
    )
    return Finding(text, WITHIN)


@claim("C10", "a repinning delay τ_d widens the pulse to v τ_d and lengthens Λ to Λ + v τ_d")
def _delay() -> Finding:
    lengths = np.array([float(precursor_length(fig2(), interface=Interface(repin_delay=n))) for n in range(7)])
    gain = lengths - lengths[0]
    text = (
        f"delays of 1–6 sites lengthen ℓ by {', '.join(f'{g:.2f}' for g in gain[1:])} λc: longer, by {gain[1]:.1f} per site at first "
        f"and {gain[6] / 6:.1f} on average at 6, not by 1 per site"
    )
    return Finding(text, WITHIN)


@claim("C11", "inertia lengthens Λ and leaves the nucleation as it is")
def _inertia() -> Finding:
    one = chain(fig2(), sites=200)
    damping = (1.0, 0.3, 0.1, 0.03, 0.0)
    extent = [int(simulate_inertial(one, duration=4000.0 if g == 1 else 500.0, damping=g).extent) for g in damping]
    text = (
        f"Λ = {', '.join(map(str, extent))} at damping {', '.join(f'{g:g}' for g in damping)} √(K/m): undamped {extent[-1]} against 26. "
        f"Nucleation starts from rest, at the same load. Overdamped with instantaneous breaks it is {extent[0]}, less than 26: each "
        "contact then breaks at exactly σ_s, before the overload of the quasi-static picture has arrived"
    )
    return Finding(text, _verdict(extent[-1] > 26 and extent == sorted(extent)))


@claim("C12", "a wide distribution P_c(f_s) removes the instability: smooth sliding, no precursor")
def _distribution() -> Finding:
    kinds: tuple[Kind, ...] = ("normal", "uniform", "weibull")
    width = {kind: smooth_width(fig2(), kind) for kind in kinds}
    found = stability(fig2(), ThresholdDistribution("normal", width["normal"]))
    text = (
        f"a contact at the edge, whose surroundings have K_s = {float(found.surroundings_at_edge):.2f} k, is stable by itself beyond "
        f"widths (in u_s) of {width['normal']:.3f} (normal), {width['uniform']:.3f} (uniform), {width['weibull']:.3f} (Weibull, "
        "1/shape). The whole chain, whose contacts fall together, is loaded without a jump beyond "
        f"{', '.join(f'{_whole_chain_smooth(kind):.3f}' for kind in kinds)}"
    )
    return Finding(text, _verdict(all(np.isfinite(w) for w in width.values())))


def _whole_chain_smooth(kind: Kind) -> float:
    """Width beyond which the load along the path of the first contact of 40 never falls, by bisection."""

    @jax.jit
    def falls(width: jax.Array) -> jax.Array:
        law = force_law(ThresholdDistribution(kind, width))
        return (jnp.diff(edge_loads(chain(fig2(), sites=40, law=law), jnp.arange(0.01, 2.5, 0.01))) <= 0).any()

    low, high = 0.02, 0.5
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (middle, high) if falls(jnp.asarray(middle)) else (low, middle)
    return high


@claim("C13", "without ageing all precursors have about the same length, the stress peak creeping on between them")
def _series_without_ageing() -> Finding:
    adiabatic = series(chain(fig2(), sites=150), events=60)
    edge = np.asarray(adiabatic.kind) == EventClass.EDGE
    breaks, extent, load = (np.asarray(x) for x in (adiabatic.breaks, adiabatic.extent, adiabatic.load))
    creeping = int((np.asarray(adiabatic.kind) == EventClass.CREEP).sum())
    steps = series(chain(fig2(), sites=300), Steps(0.5), events=8)
    text = (
        f"adiabatically: the pulses from the edge break {', '.join(map(str, breaks[edge]))} contacts, the second at U = "
        f"{load[edge][1]:.2f} u_s; the other {creeping} of 60 events are creep of a peak, mostly by one contact. In steps of 0.5 u_s: "
        f"{', '.join(map(str, np.asarray(steps.breaks)))} breaks each, extents {', '.join(map(str, np.asarray(steps.extent)))}. The "
        "protocol decides: a second pulse meets contacts still unloaded by the first, and only a finite step overloads enough of "
        "them at once"
    )
    return Finding(text, FAILS)


@claim("C14", "with ageing precursors grow until one spans the interface")
def _series_with_ageing() -> Finding:
    aged = series(chain(fig2(), sites=150), events=3000, ageing=Ageing(0.3, 3.0))
    n = int(aged.number)
    extent, breaks = np.asarray(aged.extent)[:n], np.asarray(aged.breaks)[:n]
    record = np.maximum.accumulate(np.where(breaks >= 10, extent, 0))
    large = extent[(breaks >= 10) & (extent == record)]
    spans = int(aged.status) == SeriesStatus.SPANNED
    text = (
        f"thresholds reborn at 0.3 σ_s, recovering over 3 u_s of load, N = 150: the record extents of events of 10 breaks and more are "
        f"{', '.join(map(str, large))}; " + (f"event {n} spans" if spans else f"none of {n} spans")
    )
    return Finding(text, _verdict(spans))


@claim("C15", "a simulation with inertia agrees with the quasi-static model")
def _molecular_dynamics() -> Finding:
    short = chain(Slider(10.0, 0.03, 0.3), sites=30)
    wait = quasi_static_break_time(short, 0.5)
    slow = simulate_inertial(short, duration=14 * wait, damping=0.5, rule=SelfHealing(wait))
    state, site = nucleate(short, relaxed(short))
    apart = float(abs(slow.state.pinning - rupture(short, state, trigger=site).state.pinning).max())
    one = chain(fig2(), sites=200)
    crack = [int(simulate_inertial(one, duration=500.0, damping=0.1, rule=CrackLike(f)).extent) for f in (0.3, 0.5, 0.7)]
    text = (
        f"breaks far apart in time: the same state to {apart:.1e} u_s (H/λc = 10); with instantaneous breaks see C11. Contacts "
        f"that repin only when their slip rate vanishes (friction 0.3, 0.5, 0.7 σ_s): Λ = {', '.join(map(str, crack))}, which "
        "depends on the thresholds, as the paper says of crack-like models"
    )
    return Finding(text, WITHIN if apart < 1e-9 else FAILS)


@claim("C16", "with no upper slider and the left edge of the layer displaced, no front propagates")
def _no_upper_layer() -> Finding:
    # u_0 = U imposed: when contact 0 repins, u_0 does not move, and nothing changes for its neighbours
    q, n = 0.03, 200
    a = np.diag(np.full(n, 2 + q)) - np.diag(np.ones(n - 1), 1) - np.diag(np.ones(n - 1), -1)
    push = np.linalg.solve(a, np.eye(n)[0])  # u_1 … u_n per u_0
    text = (
        f"contact 1 carries {push[0]:.4f} σ_s when contact 0 breaks at u_0 = u_s, and as much after: u_0 is held, nothing moves"
    )
    return Finding(text, _verdict(bool(push[0] < 1)))


@claim("C17", "(λc κ_2)^-1 ≈ √(2(1+ν) + h/q)/h, with h = λc/H, q = k/K (label cra44)")
def _long_length() -> Finding:
    height, stiffness = np.geomspace(10, 1e5, 41)[None, :], np.geomspace(1e-4, 0.1, 31)[:, None]
    slider = Slider(height, stiffness, 0.3)
    approximate = np.sqrt(2 * 1.3 + 1 / (height * stiffness)) * height
    ratio = approximate * np.asarray(slider.kappa_2)
    text = f"over exact: {ratio.min():.4f} to {ratio.max():.4f} for H/λc = 10–1e5, k/K = 1e-4–0.1"
    return Finding(text, HOLDS if abs(ratio - 1).max() < 0.02 else WITHIN)


@claim("C18", "K_T/K_L ~ (λc/H)²")
def _stiffness_ratio() -> Finding:
    height = np.geomspace(2, 1e6, 20)
    slider = Slider(height, 0.03, 0.3)
    scaled = np.asarray(slider.K_T / slider.K_L) * height**2
    spread = np.ptp(scaled)
    return Finding(f"K_T/K_L = {scaled[0]:.4f} (λc/H)² = (λc/H)²/2(1+ν), to {spread:.0e}", _verdict(bool(spread < 1e-12)))


def page(results: list[Result]) -> str:
    """The table of claims as a page of the documentation."""
    count = {v: sum(r.verdict == v for r in results) for v in (HOLDS, WITHIN, FAILS)}
    head = (
        "# The paper's claims, measured\n\n"
        "Written by `slippulse claims --write docs/claims.md`; every number is measured when the page is written. Unless said "
        "otherwise: $H/\\lambda_c = 25$, $k/K = 0.03$, $\\nu = 0.3$.\n\n"
        f"{count[HOLDS]} hold, {count[WITHIN]} hold within limits, {count[FAILS]} does not hold as worded.\n\n"
        "| | the paper says | measured | verdict |\n|---|---|---|---|\n"
    )
    rows = (f"| {r.number} | {r.says} | {r.measured} | {r.verdict} |" for r in results)
    return head + "\n".join(rows) + "\n"
