"""Measure the paper's claims, and judge each by a stated criterion.

Everything is computed on demand, at the parameters of the paper's Fig. 2 unless stated otherwise: H/λc = 25, k/K = 0.03,
ν = 0.3. Where a claim does not hold, the reason found is reported.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slippulse_jax import theory
from slippulse_jax.base.status import Outcome
from slippulse_jax.block import Block
from slippulse_jax.bodies.chain import Chain, chain
from slippulse_jax.bodies.modes import lattice_modes
from slippulse_jax.events.ageing import Ageing
from slippulse_jax.events.catalogue import Catalogue, EventClass
from slippulse_jax.events.inertia import quasi_static_break_time, simulate_inertial
from slippulse_jax.events.rupture import nucleate, rupture
from slippulse_jax.events.series import Steps, series
from slippulse_jax.front.front import front_fields, runaway_prestress
from slippulse_jax.interface import Interface, Profile
from slippulse_jax.lengths import arrests, precursor_lengths
from slippulse_jax.paper import FIG2
from slippulse_jax.paper.distribution import Kind, ThresholdDistribution, edge_loads, force_law, smooth_width, stability
from slippulse_jax.precursor import first_precursor, precursor_length
from slippulse_jax.rules import CrackLike, SelfHealing
from slippulse_jax.slider import Slider

Verdict = Literal["holds", "holds within limits", "does not hold as worded"]

HOLDS: Verdict = "holds"
WITHIN: Verdict = "holds within limits"
FAILS: Verdict = "does not hold as worded"

STRAIGHT = 0.99
"""Smallest R² of points that lie almost on a straight line."""
CLOSE = 0.10
"""Largest relative difference of a formula that agrees."""
LONG = 3.0
"""κΛ above which Λ ≫ 1/κ, the paper's condition for Eq. (25)."""
ROUGHLY = 0.2
"""Largest relative difference from a number that the paper gives as rough."""
SAME = 1.5
"""Largest ratio of lengths that are about the same."""


class Finding(NamedTuple):
    """Numbers measured for one claim, and the verdict that follows."""

    measured: str
    verdict: Verdict


class Claim(NamedTuple):
    """One claim, with the criteria of its verdicts."""

    number: str
    says: str
    holds: str  # criterion of *holds*
    limits: str  # criterion of *holds within limits*; empty where a claim either holds or fails
    measure: Callable[[], Finding]


class Result(NamedTuple):
    """One row of the table of claims."""

    number: str
    says: str
    criteria: str
    measured: str
    verdict: Verdict


CLAIMS: dict[str, Claim] = {}
"""Every claim by its number, in the order of this module."""


def examine(numbers: list[str] | None = None) -> Iterator[Result]:
    """Measure claims in double precision; a ValueError for an unknown number."""
    for number in numbers or []:
        if number not in CLAIMS:
            raise ValueError(f"no claim {number!r}: must be one of {', '.join(CLAIMS)}")
    for one in CLAIMS.values():
        if numbers is None or one.number in numbers:
            with jax.enable_x64(True):
                measured, verdict = one.measure()
            criteria = one.holds + (f"; within limits: {one.limits}" if one.limits else "")
            yield Result(one.number, one.says, criteria, measured, verdict)


def page(results: list[Result]) -> str:
    """Write the table of claims as a page of the documentation."""
    count = {verdict: sum(r.verdict == verdict for r in results) for verdict in (HOLDS, WITHIN, FAILS)}
    head = (
        "# The paper's claims, measured\n\n"
        "This page shows which claims of the paper hold in this model. It is for readers of the paper, and for referees.\n\n"
        "Written by `slippulse claims --write docs/appendix/claims.md`; every number is measured when the page is written, and every verdict "
        "follows from the numbers by the criterion stated beside it. Where the paper gives no number (*almost*, *roughly*), the "
        "criterion is this project's. Unless stated otherwise: $H/\\lambda_c = 25$, $k/K = 0.03$, $\\nu = 0.3$.\n\n"
        f"{count[HOLDS]} hold, {count[WITHIN]} hold within limits, {count[FAILS]} does not hold as worded.\n\n"
        "| | the paper says | it holds if | measured | verdict |\n|---|---|---|---|---|\n"
    )
    return head + "\n".join(row(result) for result in results) + "\n"


def row(result: Result) -> str:
    """Format one line of the page."""
    return f"| {' | '.join(result)} |"


def claim(number: str, *, holds: str, limits: str = "") -> Callable[[Callable[[], Finding]], Callable[[], Finding]]:
    """Add a measurement to `CLAIMS`; its docstring states the claim."""

    def added(measure: Callable[[], Finding]) -> Callable[[], Finding]:
        CLAIMS[number] = Claim(number, (measure.__doc__ or "").rstrip("."), holds, limits, measure)
        return measure

    return added


def judge(holds: bool, within: bool = False) -> Verdict:
    """Give the verdict of the two criteria."""
    return HOLDS if holds else WITHIN if within else FAILS


def _listed(numbers: Iterable[Any], form: str = "") -> str:
    """Numbers in one format, separated by commas."""
    return ", ".join(f"{number:{form}}" for number in numbers)


@claim("C1", holds="26 contacts break", limits="25 or 27")
def count() -> Finding:
    """Λ = 26 λc at the parameters of Fig. 2."""
    found = first_precursor(FIG2)
    broken = int(found.contacts_broken)
    kept = np.array([0.1, 0.3, 0.5])
    share = precursor_lengths(FIG2, interface=Interface(residual_strength=kept)) / float(found.length)
    text = (
        f"{broken} contacts, ℓ = {float(found.length):.3f} λc (semi-infinite chain). The paper's contacts lose all their stress; of those that "
        f"keep {_listed(kept)} of their strength ℓ is {_listed(share, '.3f')} times as long"
    )
    return Finding(text, judge(broken == 26, abs(broken - 26) == 1))


@claim(
    "C2",
    holds="on every broken contact u_t grows by less than 10% and u by a factor of 1.5 to 2",
    limits="only on the contact where u grows most",
)
def displacements() -> Finding:
    """As the front passes, u_t hardly changes while u almost doubles."""
    broken = int(first_precursor(FIG2).contacts_broken)
    before, after = (front_fields(FIG2, position=s, sites=4 * broken) for s in (0, broken))
    upper = np.asarray(after.upper / before.upper)[:broken]
    layer = np.asarray(after.layer / before.layer)[:broken]
    each = (upper < 1.1) & (layer > 1.5) & (layer < 2)
    text = f"u_t grows by at most {upper.max() - 1:.1%}, u by a factor of {layer.min():.2f} to {layer.max():.2f}"
    return Finding(text, judge(bool(each.all()), bool(each[layer.argmax()])))


@claim("C3", holds="the largest stress is on the first contact that did not break, and behind it stress falls from the edge on")
def stress() -> Finding:
    """The stress peaks at the front, and behind it grows with the distance from it."""
    found = first_precursor(FIG2)
    after, broken = np.asarray(found.stress), int(found.contacts_broken)
    falling = bool((np.diff(after[:broken]) < 0).all())
    text = f"largest stress {after.max():.3f} σ_s on contact {int(after.argmax())} (front at {broken}); behind it " + (
        f"monotonic, up to {after[0]:.3f} σ_s at the edge" if falling else "not monotonic"
    )
    return Finding(text, judge(falling and int(after.argmax()) == broken))


def _straight(x: np.ndarray, lengths: np.ndarray) -> tuple[str, Verdict]:
    """R² of straight lines, with the slope's sign, and the verdict."""
    r = np.array([np.corrcoef(x, length)[0, 1] for length in lengths])
    r2 = r * abs(r)
    return f"R² = {_listed(r2, '.4f')}", judge(bool((r2 > STRAIGHT).all()), bool((r2 > STRAIGHT).any()))


@claim(
    "C4",
    holds=f"lengths lie on a rising straight line, R² > {STRAIGHT}, over H/λc = 10–50 at k/K = 0.003, 0.01 and 0.03",
    limits="only at one of them",
)
def height() -> Finding:
    """Λ grows almost linearly with H."""
    heights = np.linspace(10, 50, 41)
    lengths = precursor_lengths(Slider(heights, np.array([[0.003], [0.01], [0.03]]), 0.3))
    r2, verdict = _straight(heights, lengths)
    slopes = [np.polyfit(heights, length, 1)[0] for length in lengths]
    return Finding(f"{r2}; slopes {_listed(slopes, '.3f')}", verdict)


@claim(
    "C5",
    holds=f"lengths lie on a rising straight line in ln(k/K), R² > {STRAIGHT}, over 0.003–0.03 at H/λc = 10, 25 and 50",
    limits="only at one of them",
)
def stiffness() -> Finding:
    """Λ grows almost logarithmically with k/K."""
    drawn = np.geomspace(0.003, 0.03, 41)
    heights = np.array([10.0, 25.0, 50.0])
    lengths = precursor_lengths(Slider(heights[:, None], drawn, 0.3))
    r2, verdict = _straight(np.log(drawn), lengths)
    beyond = np.geomspace(0.003, 0.6, 601)
    fronts = arrests(Slider(heights[:, None], beyond, 0.3))
    peaks = beyond[fronts.length.argmax(axis=1)]
    again = beyond[(fronts.status == Outcome.REBREAK).argmax(axis=1)]
    text = (
        f"{r2}: the taller the slider, the more the line bends; Λ is largest at k/K = "
        f"{_listed(peaks, '.3f')} and falls beyond: Λ is not monotonic in k/K. From k/K = "
        f"{_listed(again, '.3f')} on contact 0 breaks again before the front stops, and the event goes farther than "
        "that front"
    )
    return Finding(text, verdict)


@claim("C6", holds="ℓ differs by less than 1e-9 λc")
def threshold() -> Finding:
    """Λ does not depend on σ_s, and therefore not on a uniform normal load."""
    at = [float(first_precursor(FIG2, interface=Profile(np.full(1, t))).length) for t in (0.1, 1.0, 10.0)]
    spread = max(at) - min(at)
    friction = (0.0, 0.1, 0.3, 0.5)  # at μ = 0 the whole event of the others, under level thresholds
    on_block = [precursor_length(Block(24.0, 0.3 / (2.6 * 24), 0.3, length=72, friction=mu), event="full") for mu in friction]
    text = (
        f"thresholds of 0.1, 1 and 10: ℓ differs by {spread:.1e} λc. On a block that is pushed above H/4 and whose thresholds are μ times "
        f"a pressure, which this push tilts (H/λc = 24, b = 0.3, L = 3 H), ℓ/H = {_listed(np.array(on_block) / 24, '.2f')} at μ = {_listed(friction)}: there it "
        "depends on μ, though not on the load"
    )
    return Finding(text, judge(spread < 1e-9))


@claim(
    "C7",
    holds=f"both are within {CLOSE:.0%} of the lattice over H/λc = 10–50, k/K = 0.003–0.03",
    limits=f"only where κΛ > {LONG:g}, the paper's own condition Λ ≫ 1/κ",
)
def formulas() -> Finding:
    """Eqs. (58) and (25) agree with the numerics (Fig. 3)."""
    sliders = Slider(np.linspace(10, 50, 9)[None, :], np.array([[0.003], [0.01], [0.03]]), 0.3)
    lattice = precursor_lengths(sliders)
    long = lattice * np.asarray(sliders.kappa) > LONG
    given = {"Eq. (25)": theory.length_eq25(sliders), "Eq. (58), corrected,": theory.length(sliders)}
    ratio = {name: np.asarray(length) / lattice for name, length in given.items()}
    text = ". ".join(
        f"{name} relative to the lattice: {r.min():.3f} to {r.max():.3f}; where κΛ > {LONG:g}, {r[long].min():.3f} to {r[long].max():.3f}"
        for name, r in ratio.items()
    )
    off = [abs(r - 1) for r in ratio.values()]
    verdict = judge(all(x.max() < CLOSE for x in off), all(x[long].max() < CLOSE for x in off))
    return Finding(f"{text}. As printed, Eq. (58) rests on an erroneous Ψ_6 (label cra54)", verdict)


@claim(
    "C8",
    holds="Λ rises with φ and is finite below φ_c = (1 + G_00)/2, the Griffith threshold of the lattice, and fronts never stop above it, "
    "at Fig. 2 and where b is small",
    limits="only at Fig. 2",
)
def prestress() -> Finding:
    """Prestress σ_0 lengthens Λ, and beyond a threshold the front never stops."""
    critical = float(runaway_prestress(lattice_modes(FIG2)))
    phi = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.5, 0.53, critical * (1 - 1e-6), critical * (1 + 1e-6), 0.99])
    length = precursor_lengths(FIG2, interface=Interface(phi))
    finite = np.isfinite(length)
    soft = Slider(10.381840251071646, 0.024884160056852563, 0.05409050217326783)
    above = float(precursor_length(soft, interface=Interface(float(runaway_prestress(lattice_modes(soft))) + 1e-4)))
    text = (
        f"Λ = {_listed(np.ceil(length[:8]), '.0f')} at φ = 0–0.53; {_stops(length[8])} at φ_c(1 − 1e-6), "
        f"{_stops(length[9])} at φ_c(1 + 1e-6), φ_c = {critical:.4f}. Where b is small φ ≥ φ_c is necessary, not sufficient: at "
        f"H/λc = 10.4, k/K = 0.025, ν = 0.05 (b = {float(soft.b):.2f}) the front {_stops(above)} at φ_c + 1e-4"
    )
    here = bool((np.diff(length[finite]) > 0).all() and finite[:9].all() and not finite[9:].any())
    return Finding(text, judge(here and np.isinf(above), here))


def _stops(length: float) -> str:
    return f"stops after {np.ceil(length):.0f} contacts" if np.isfinite(length) else "never stops"


@claim(
    "C9",
    holds=f"d ln Λ/dε = −1 to {ROUGHLY:.0%}, with ε the relative rise of σ_s over one λc, over H or over Λ(0)",
    limits="Λ is shorter where thresholds rise and longer where they fall",
)
def threshold_slope() -> Finding:
    """Λ(ε) ≈ Λ(0)(1 − ε) for thresholds σ_s0 + μ_s ε x."""
    base = float(precursor_length(FIG2))
    slope = np.array([-0.005, 0.001, 0.005, 0.01])
    ratio = precursor_lengths(FIG2, interface=Interface(threshold_slope=slope)) / base
    rate = float(jax.grad(lambda e: precursor_length(FIG2, interface=Interface(threshold_slope=e)))(0.0)) / base
    tall = float(FIG2.height)
    text = (
        f"Λ/Λ(0) = {', '.join(f'{r:.3f} at {e:g}' for e, r in zip(slope, ratio, strict=True))} per λc. The paper prints ε with the "
        f"dimension of a gradient; read as the relative rise of σ_s over a length a, d ln Λ/dε = {rate:.1f} λc/a: −1 only for "
        f"a = {-rate:.0f} λc = {-rate / tall:.1f} H"
    )
    holds = any(abs(rate / a + 1) < ROUGHLY for a in (1.0, tall, base))
    return Finding(text, judge(holds, bool(((ratio < 1) == (slope > 0)).all())))


@claim(
    "C10",
    holds=f"a delay of n = 1–6 sites, which makes the pulse n sites wide, lengthens ℓ by n λc to {ROUGHLY:.0%}",
    limits="ℓ grows with every site of delay",
)
def repinning_delay() -> Finding:
    """A repinning delay τ_d widens the pulse to v τ_d and lengthens Λ to Λ + v τ_d."""
    sites = np.arange(7)
    contacts = chain(FIG2, sites=100)
    lengths = np.array([float(rupture(contacts, repin_delay=int(n)).length) for n in sites])
    gain = (lengths - lengths[0])[1:]
    rate = gain / sites[1:]
    text = (
        f"delays of 1–6 sites lengthen ℓ by {_listed(gain, '.2f')} λc: by {rate[0]:.1f} per site at first and "
        f"{rate[-1]:.1f} on average at 6"
    )
    return Finding(text, judge(bool((abs(rate - 1) < ROUGHLY).all()), bool((np.diff(lengths) > 0).all())))


CONVERGED = 0.05
"""Step, over the largest stable one, below which the same contacts break.

Times of breaks are of first order in the step: without damping the 41st contact breaks at t = 47.8 with this step and at 47.6
with half of it; with twice this step it does not break, and with the default only at 497, by a wave that the right end reflects.
"""


def _broken(one: Chain, damping: float, rule: SelfHealing | CrackLike) -> tuple[int, float]:
    """Contacts broken with inertia at the load of nucleation, and when."""
    duration = 4000.0 if damping == 1 else 500.0
    motion = simulate_inertial(one, duration=duration, damping=damping, rule=rule, safety=CONVERGED)
    extent = int(motion.extent)
    return extent, float(motion.first_break[:extent].max())


def _pushed_to_nucleation(one: Chain) -> tuple[int, float]:
    """First contact to break under a slow push with inertia, and load."""
    load, velocity = 0.99 * nucleate(one)[0].load, 1e-3
    pushed = simulate_inertial(one, one.relaxed(load), duration=float(0.02 * load / velocity), velocity=velocity)
    return int(pushed.first_break.argmin()), float(load + velocity * pushed.first_break.min())


@claim(
    "C11",
    holds="at every damping more contacts break than quasi-statically, and a chain that is pushed slowly breaks first at contact 0, at "
    "the static load to 1%",
    limits="only without damping",
)
def inertia() -> Finding:
    """Inertia lengthens Λ and leaves the nucleation as it is."""
    one = chain(FIG2, sites=200)
    first = first_precursor(FIG2)
    static, load = int(first.contacts_broken), float(first.load)
    damping = (1.0, 0.3, 0.1, 0.03, 0.0)
    extent, ended = zip(*(_broken(one, g, SelfHealing()) for g in damping), strict=True)
    site, pushed = _pushed_to_nucleation(one)
    text = (
        f"Λ = {_listed(extent)} at damping {_listed(damping, 'g')} √(K/m): undamped {extent[-1]}, the last "
        f"at t = {ended[-1]:.1f} √(m/K), against {static}. Pushed at 1e-3 u_s √(K/m), contact {site} breaks first, at {pushed / load:.4f} of the static load. Overdamped with "
        f"instantaneous breaks Λ is {extent[0]}: each contact then breaks at exactly σ_s, before the overload of the quasi-static "
        "picture has arrived"
    )
    unaffected = site == 0 and abs(pushed / load - 1) < 0.01
    return Finding(text, judge(min(extent) > static and unaffected, extent[-1] > static and unaffected))


KINDS: tuple[Kind, ...] = ("normal", "uniform", "weibull")


@claim(
    "C12",
    holds="for each of three distributions the load that follows the first contact of a whole chain falls where the distribution is "
    "narrow (an event), and from some width on rises all along",
    limits="so for a single contact at the edge",
)
def distribution() -> Finding:
    """A wide distribution P_c(f_s) removes the instability: smooth sliding, no precursor."""
    alone = {kind: smooth_width(FIG2, kind) for kind in KINDS}
    whole = [_whole_chain_smooth(kind) for kind in KINDS]
    found = stability(FIG2, ThresholdDistribution("normal", alone["normal"]))
    text = (
        f"a contact at the edge, whose surroundings have K_s = {float(found.surroundings_at_edge):.2f} k, is stable by itself beyond "
        f"widths (in u_s) of {alone['normal']:.3f} (normal), {alone['uniform']:.3f} (uniform), {alone['weibull']:.3f} (Weibull, "
        f"1/shape). The whole chain, whose contacts fall together, is loaded without a jump beyond "
        f"{_listed(whole, '.3f')}"
    )
    return Finding(text, judge(bool(np.isfinite(whole).all()), bool(np.isfinite(list(alone.values())).all())))


def _whole_chain_smooth(kind: Kind) -> float:
    """Width beyond which the load of a whole chain never falls.

    By bisection, along the path of the first contact of 40. NaN where it never falls even with narrow thresholds, so that there is no instability to remove; inf where it falls with wide ones.
    """

    @jax.jit
    def falls(width: jax.Array) -> jax.Array:
        law = force_law(ThresholdDistribution(kind, width))
        return (jnp.diff(edge_loads(chain(FIG2, sites=40, law=law), jnp.arange(0.01, 2.5, 0.01))) <= 0).any()

    low, high = 0.02, 0.5
    if not falls(jnp.asarray(low)):
        return np.nan
    if falls(jnp.asarray(high)):
        return np.inf
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (middle, high) if falls(jnp.asarray(middle)) else (low, middle)
    return high


@claim(
    "C13",
    holds=f"the largest precursor breaks at most {SAME} times as many contacts as the smallest, under quasi-static loading, and the "
    "other events nucleate at a stress peak",
    limits="so in steps of 0.5 u_s, each of which breaks one patch of contacts",
)
def without_ageing() -> Finding:
    """Without ageing all precursors have about the same length, the stress peak moving on between them."""
    adiabatic = series(chain(FIG2, sites=150), events=60)
    kind, breaks, load = (np.asarray(x) for x in (adiabatic.kind, adiabatic.breaks, adiabatic.load))
    edge, peak = kind == EventClass.EDGE, kind == EventClass.RENUCLEATED
    steps = series(chain(FIG2, sites=300), Steps(0.5), events=8, recorded_breaks=1000)
    stepped, patches = np.asarray(steps.breaks), _patches(steps)
    text = (
        f"adiabatically: the pulses from the edge break {_listed(breaks[edge])} contacts, the second at U = "
        f"{load[edge][1]:.2f} u_s; the other {int(peak.sum())} of {len(kind)} events nucleate at a stress peak, mostly of one contact: a second "
        f"pulse meets contacts still unloaded by the first. In steps of 0.5 u_s: {_listed(stepped)} breaks each, extents "
        f"{_listed(np.asarray(steps.extent))}, in {_listed(patches)} separate patches"
    )
    of_two_kinds = bool((edge | peak).all())
    return Finding(text, judge(_alike(breaks[edge]) and of_two_kinds, _alike(stepped) and max(patches) == 1))


def _patches(events: Catalogue) -> list[int]:
    """Count the separate patches of neighbouring contacts that broke in each event."""
    site, event = np.asarray(events.break_site), np.asarray(events.break_event)
    return [int((np.diff(np.unique(site[event == e])) > 1).sum()) + 1 for e in range(len(events.breaks))]


def _alike(breaks: np.ndarray) -> bool:
    return bool(breaks.max() <= SAME * breaks.min())


@claim(
    "C14",
    holds="the record extents of large events rise at least three times, each further than all before, and the last event spans",
    limits="they rise, but none of 3000 events spans",
)
def with_ageing() -> Finding:
    """With ageing precursors grow until one spans the interface."""
    aged = series(chain(FIG2, sites=150), events=3000, ageing=Ageing(0.3, 3.0))
    n = int(aged.number)
    extent, breaks, force = (np.asarray(x)[:n] for x in (aged.extent, aged.breaks, aged.force_before))
    records, first = np.unique(np.maximum.accumulate(extent[breaks >= 10]), return_index=True)
    force = force[breaks >= 10][first]
    spans = int(aged.status) == Outcome.SPANNED
    text = (
        f"thresholds reborn at 0.3 σ_s, recovering over 3 u_s of load, N = 150: the record extents of events of 10 breaks and more are "
        f"{_listed(records)}; " + (f"event {n} spans" if spans else f"none of {n} spans")
    )
    falls = "falls at first" if (np.diff(force)[:1] < 0).all() else "does not fall at first"
    text += f". The force on the edge as they start {falls}: {_listed(force, '.2f')} K u_s"
    grows = len(records) > 3
    return Finding(text, judge(grows and spans, grows))


@claim(
    "C15",
    holds=f"breaks far apart in time give the quasi-static state to 1e-9 u_s, and Λ is that of the quasi-static model to {ROUGHLY:.0%} "
    "with instantaneous breaks at damping 0.3, 0.1 and 0, and for contacts that repin when their slip rate vanishes",
    limits="only with breaks far apart in time",
)
def simulation() -> Finding:
    """A simulation with inertia agrees with the quasi-static model."""
    short = chain(Slider(10.0, 0.03, 0.3), sites=30)
    wait = quasi_static_break_time(short, 0.5)
    slow = simulate_inertial(short, duration=14 * wait, damping=0.5, rule=SelfHealing(wait))
    state, site = nucleate(short)
    apart = float(abs(slow.state.pinning - rupture(short, state, trigger=site).state.pinning).max())
    one, static = chain(FIG2, sites=200), int(first_precursor(FIG2).contacts_broken)
    damped = {g: _broken(one, g, SelfHealing())[0] for g in (0.3, 0.1, 0.0)}
    crack = [_broken(one, 0.1, CrackLike(friction))[0] for friction in (0.3, 0.5, 0.7)]
    rounding = 10.0 ** np.ceil(np.log10(max(apart, 1e-16)))  # its digits differ between machines
    text = (
        f"breaks far apart in time: the same state to {rounding:.0e} u_s (H/λc = 10). Instantaneous breaks: Λ = "
        f"{_listed(damped.values())} at damping {_listed(damped, 'g')} √(K/m), against {static}. Contacts that "
        f"repin only when their slip rate vanishes (friction 0.3, 0.5, 0.7 σ_s): Λ = {_listed(crack)}, which "
        "depends on the thresholds, as the paper says of crack-like models"
    )
    near = all(abs(extent / static - 1) < ROUGHLY for extent in (*damped.values(), *crack))
    return Finding(text, judge(apart < 1e-9 and near, apart < 1e-9))


@claim("C16", holds="contact 1 stays below σ_s when contact 0 breaks")
def no_upper_layer() -> Finding:
    """With no upper slider and the left edge of the layer displaced, no front propagates."""
    # u_0 = U imposed: when contact 0 repins, u_0 does not move, and nothing changes for its neighbours
    q, n = 0.03, 200
    a = np.diag(np.full(n, 2 + q)) - np.diag(np.ones(n - 1), 1) - np.diag(np.ones(n - 1), -1)
    push = np.linalg.solve(a, np.eye(n)[0])  # u_1 … u_n per u_0
    text = f"contact 1 carries {push[0]:.4f} σ_s when contact 0 breaks at u_0 = u_s, and the same afterwards: u_0 is held, nothing moves"
    return Finding(text, judge(bool(push[0] < 1)))


@claim("C17", holds="within 2% over H/λc = 10–1e5, k/K = 1e-4–0.1", limits=f"within {CLOSE:.0%}")
def long_length() -> Finding:
    """(λc κ_2)^-1 ≈ √(2(1+ν) + h/q)/h, with h = λc/H, q = k/K (label cra44)."""
    heights, q = np.geomspace(10, 1e5, 41)[None, :], np.geomspace(1e-4, 0.1, 31)[:, None]
    approximate = np.sqrt(2 * 1.3 + 1 / (heights * q)) * heights
    ratio = approximate * np.asarray(Slider(heights, q, 0.3).kappa_2)
    off = abs(ratio - 1).max()
    return Finding(f"over exact: {ratio.min():.4f} to {ratio.max():.4f}", judge(off < 0.02, off < CLOSE))


@claim("C18", holds="the ratio of the two is the same to 1e-12 over H/λc = 2–1e6")
def stiffness_ratio() -> Finding:
    """K_T/K_L ~ (λc/H)²."""
    heights = np.geomspace(2, 1e6, 20)
    slider = Slider(heights, 0.03, 0.3)
    scaled = np.asarray(slider.K_T / slider.K_L) * heights**2
    spread = np.ptp(scaled)
    return Finding(f"K_T/K_L = {scaled[0]:.4f} (λc/H)² = (λc/H)²/2(1+ν), to {spread:.0e}", judge(bool(spread < 1e-12)))
