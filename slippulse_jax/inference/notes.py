"""What a careful reader should know before using the numbers of a fit."""

from collections.abc import Iterator

import numpy as np

from slippulse_jax.inference.attainable import longest_over
from slippulse_jax.inference.calibrate import can_be_calibrated
from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.parameters import STIFFEST
from slippulse_jax.inference.resolve import softest
from slippulse_jax.inference.result import FitResult
from slippulse_jax.inference.verdict import IMPROBABLE, PLATEAU, Identifiability

REMARKED = 0.05  # probability of χ² below which the scatter is remarked on

TWO_SIDES = (Identifiability.SEVERAL_ROOTS, Identifiability.SKEWED, Identifiability.AT_MAXIMUM, Identifiability.ONE_SIDED)


def before_fit(m: Measurements) -> Iterator[str]:
    """Warnings that need no fit: lengths at or above the longest that any stiffness gives, with the inputs as stated."""
    inputs = (np.log(m.height), np.zeros(len(m)), m.poisson, m.or_zero("prestress"), m.or_zero("threshold_slope"))
    longest, _ = longest_over(np.stack(inputs, axis=1), np.log(softest(m)), np.full(len(m), np.log(STIFFEST)))
    yield from _of_attainable(m, longest)


def notes(result: FitResult) -> Iterator[str]:
    """Sentences, most of them about the data."""
    yield from _of_data(result)
    yield from _of_sigma(result)
    yield from _of_attainable(result.measurements, result.attainable)
    yield from _of_intervals(result)
    if any(root.rebreaks.any() for root in result.roots[:1]):
        yield (
            "at the fitted stiffness the contact at the edge would be back at its threshold before the front stops: the length "
            "is that of the first front alone"
        )
    for outcome in result.outcomes:
        yield f"a start {outcome}"


def _of_data(result: FitResult) -> Iterator[str]:
    m = result.measurements
    if m.other:
        yield f"columns kept and not used: {', '.join(m.other)}"
    kinds = sorted({text for text in m.provenance if text})
    if kinds and kinds != ["measured"]:
        yield f"provenance: {', '.join(kinds)}"
    rows = set(zip(m.specimen or [""] * len(m), m.height, m.poisson, m.length, m.sigma, m.kind, strict=True))
    if len(rows) < len(m) and m.length_sigma is not None:
        yield f"{len(m) - len(rows)} measurement(s) repeat another one exactly: each counts as a measurement of its own"
    if m.in_si and m.young is None:
        yield "no young_GPa: the areal stiffness in Pa/m cannot be had, only its ratio to Young's modulus"


def _of_sigma(result: FitResult) -> Iterator[str]:
    if result.measurements.length_sigma is None:
        yield "no standard errors were given: they are taken as equal, and their size from the scatter about the fit"
    elif result.scaled:
        factor = np.sqrt(result.variance_factor)
        yield f"the stated σ are taken as relative, and scaled by {factor:.3g} to the scatter about the fit"
    if result.p_value is not None and IMPROBABLE <= result.p_value < REMARKED:
        factor = np.sqrt(result.chi2 / result.dof)
        yield (
            f"the scatter is larger than σ says (p = {result.p_value:.2g}): σ would have to be {factor:.2g} times as large; "
            "sigma = 'relative' takes its size from the scatter"
        )
    if result.problem.loss.name != "normal":
        yield f"loss: {result.problem.loss.name}; outliers count less than their σ says"


def _of_intervals(result: FitResult) -> Iterator[str]:
    m = result.measurements
    close = (m.length > PLATEAU * result.attainable).any() and result.identifiability in TWO_SIDES
    plain = result.request["intervals"] == "profile" and can_be_calibrated(result.problem) and not result.scaled
    if close and plain and len(set(m.height)) > 1:
        yield (
            "with the two sides of the peak so close a profile's 68% interval holds the truth in some 60% of studies "
            "(simulated, of three blocks); intervals = 'calibrated' covers as it says"
        )


def _of_attainable(m: Measurements, attainable: np.ndarray) -> Iterator[str]:
    sigma = np.where(np.isnan(m.sigma), 0, m.sigma)
    lowest = np.where(np.array(m.kind) == "whole", m.length - 1, m.length) - sigma
    above = lowest > attainable
    if above.any():
        i = int(np.argmax(m.length / attainable))
        where = f"line {m.lines[i]}" if m.lines else f"measurement {i}"
        yield (
            f"{int(above.sum())} length(s) lie more than σ above the longest that a stiffness in the range searched gives; "
            f"worst at {where}: {m.length[i]:.6g} λc, attainable {attainable[i]:.6g} λc"
        )
    plateau = ~above & (m.length > PLATEAU * attainable)
    if plateau.any():
        ceiling = np.sqrt(2 * (1 + m.poisson[plateau][0])) * np.log(2)
        yield (
            f"{int(plateau.sum())} of {len(m)} lengths lie within {1 - PLATEAU:.0%} of the longest attainable, where they say "
            f"little of stiffness (for a tall slider no length exceeds {ceiling:.3f} H at ν = {m.poisson[plateau][0]:g})"
        )
