"""Claims on the first front and its length."""

import numpy as np

from slippulse_jax import theory
from slippulse_jax.interface import Profile
from slippulse_jax.lengths import arrests, precursor_lengths
from slippulse_jax.paper import FIG2
from slippulse_jax.paper.claims.claim import Finding, Verdict, claim, judge
from slippulse_jax.precursor import first_precursor
from slippulse_jax.slider import Slider
from slippulse_jax.status import Outcome

STRAIGHT = 0.99
"""Smallest R² of points that lie almost on a straight line."""
CLOSE = 0.10
"""Largest relative difference of a formula that agrees."""
LONG = 3.0
"""κΛ above which Λ ≫ 1/κ, where the paper expects its Eq. (25) to hold."""


@claim("C1", holds="26 contacts break", limits="25 or 27")
def count() -> Finding:
    """Λ = 26 λc at the parameters of Fig. 2."""
    found = first_precursor(FIG2)
    broken = int(found.contacts_broken)
    text = f"{broken} contacts, ℓ = {float(found.length):.3f} λc (semi-infinite chain)"
    return Finding(text, judge(broken == 26, abs(broken - 26) == 1))


@claim(
    "C2",
    holds="on every broken contact u_t grows by less than 10% and u by a factor of 1.5 to 2",
    limits="only on the contact where u grows most",
)
def displacements() -> Finding:
    """As the front passes, u_t hardly changes while u almost doubles."""
    found = first_precursor(FIG2)
    before, after, broken = found.nucleation, found.arrest, int(found.contacts_broken)
    upper = np.asarray(after.upper / before.upper)[:broken]
    layer = np.asarray(after.layer / before.layer)[:broken]
    each = (upper < 1.1) & (layer > 1.5) & (layer < 2)
    text = f"u_t grows by at most {upper.max() - 1:.1%}, u by a factor of {layer.min():.2f} to {layer.max():.2f}"
    return Finding(text, judge(bool(each.all()), bool(each[layer.argmax()])))


@claim(
    "C3",
    holds="the largest stress is on the first contact that did not break, and behind it stress falls from the edge on",
)
def stress() -> Finding:
    """The stress peaks at the front, and behind it grows with the distance from it."""
    found = first_precursor(FIG2)
    after, broken = np.asarray(found.arrest.stress), int(found.contacts_broken)
    falling = bool((np.diff(after[:broken]) < 0).all())
    text = f"largest stress {after.max():.3f} σ_s on contact {int(after.argmax())} (front at {broken}); behind it " + (
        f"monotonic, up to {after[0]:.3f} σ_s at the edge" if falling else "not monotonic"
    )
    return Finding(text, judge(falling and int(after.argmax()) == broken))


def _straight(x: np.ndarray, lengths: np.ndarray) -> tuple[str, Verdict]:
    """R² of a straight line through each row of lengths, with the sign of its slope; and the verdict."""
    r = np.array([np.corrcoef(x, length)[0, 1] for length in lengths])
    r2 = r * abs(r)
    return f"R² = {', '.join(f'{one:.4f}' for one in r2)}", judge(bool((r2 > STRAIGHT).all()), bool((r2 > STRAIGHT).any()))


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
    return Finding(f"{r2}; slopes {', '.join(f'{slope:.3f}' for slope in slopes)}", verdict)


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
        f"{', '.join(f'{peak:.3f}' for peak in peaks)} and falls beyond: Λ is not monotonic in k/K. From k/K = "
        f"{', '.join(f'{first:.3f}' for first in again)} on contact 0 breaks again before the front stops, and the event goes farther than "
        "that front"
    )
    return Finding(text, verdict)


@claim(
    "C6",
    holds="ℓ differs by less than 1e-9 λc",
)
def threshold() -> Finding:
    """Λ does not depend on σ_s, and therefore not on a uniform normal load."""
    at = [float(first_precursor(FIG2, interface=Profile(np.full(1, t))).length) for t in (0.1, 1.0, 10.0)]
    spread = max(at) - min(at)
    return Finding(f"thresholds of 0.1, 1 and 10: ℓ differs by {spread:.1e} λc", judge(spread < 1e-9))


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
    "C16",
    holds="contact 1 stays below σ_s when contact 0 breaks",
)
def no_upper_layer() -> Finding:
    """With no upper slider and the left edge of the layer displaced, no front propagates."""
    # u_0 = U imposed: when contact 0 repins, u_0 does not move, and nothing changes for its neighbours
    q, n = 0.03, 200
    a = np.diag(np.full(n, 2 + q)) - np.diag(np.ones(n - 1), 1) - np.diag(np.ones(n - 1), -1)
    push = np.linalg.solve(a, np.eye(n)[0])  # u_1 … u_n per u_0
    text = f"contact 1 carries {push[0]:.4f} σ_s when contact 0 breaks at u_0 = u_s, and the same afterwards: u_0 is held, nothing moves"
    return Finding(text, judge(bool(push[0] < 1)))


@claim(
    "C17",
    holds="within 2% over H/λc = 10–1e5, k/K = 1e-4–0.1",
    limits=f"within {CLOSE:.0%}",
)
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
