"""Remarks to read before using the numbers of a fit."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from slippulse_jax.base.shown import listed, plural
from slippulse_jax.inference.model.front import IMPROBABLE, SCATTERED
from slippulse_jax.inference.parameters import OF_MEASURING, STIFFNESSES
from slippulse_jax.inference.result.changes import END, MOST_CONTACTS
from slippulse_jax.inference.result.suggestions import size_from_scatter
from slippulse_jax.inference.result.values import UNEVEN, Shown, error_source, fitted_beside, shown_of
from slippulse_jax.inference.result.verdict import GIVEN, PLATEAU
from slippulse_jax.inference.search.intervals import LEVELS
from slippulse_jax.theory import length_ceiling

if TYPE_CHECKING:
    from slippulse_jax.inference.result.result import FitResult


def notes(result: "FitResult") -> list[str]:
    """Remarks to read before using the numbers, most about the data."""
    shown = shown_of(result, {})
    first = *_of_data(result, shown), *_of_sigma(result), *_of_pulls(result, shown), *_of_shape(result, shown)
    first = *first, *_of_what_is_alike(result)
    return [*first, *result.suspicions, *_of_attainable(result), *result.main.notes(result), *_of_model(result)]


def _of_data(result: "FitResult", shown: dict[str, Shown]) -> Iterator[str]:
    m, p = result.measurements, result.problem.p
    used = {*result.parameters.front.columns}.union(*(one.uses(m) for one in result.parameters.observables))
    if unused := [name for name in m.other if name not in used]:
        yield f"columns kept but not used: {', '.join(unused)}"
    for table in filter(None, (m, m.gauges)):
        if skipped := table.skipped:
            which = ", ".join(map(str, skipped[:20])) + ", …" * (len(skipped) > 20)
            lines = plural(len(skipped), "line" if table.lines else "row")
            yield f"skipped {lines} of {table.source} that hold no measurement: {which}"
    kinds = sorted({*m.provenance} - {""})
    if kinds and kinds != ["measured"]:
        yield f"provenance: {', '.join(kinds)}"
    copies = len(m) - m.distinct
    if copies:
        yield (
            f"{plural(copies, 'measurement')} repeat{'s' * (copies == 1)} another exactly; each counts as a measurement of its "
            "own, so leave out copies"
        )
    if result.problem.count - copies < p:
        hold = m.option("--fix NAME=VALUE", "fixed={name: value}")
        state = m.option("--prior NAME=MEAN,DEVIATION", "sp.Parameter(name, prior=(mean, deviation))")
        yield (
            f"{plural(p, 'parameter')} are fitted, but only {result.problem.count - copies} of the data are different; hold "
            f"some ({hold}), state what is known of them ({state}), or measure at more heights"
        )
    beside = {one.name: f"{one.symbol} = {shown[one.label].prior}" for one in fitted_beside(result) if one.name in OF_MEASURING}
    if "model_factor" in beside:
        shared, held = "a model factor is", {"model_factor": 1}
        if "offset" in beside:
            shared, held = "an offset and a model factor are", {"offset": 0, "model_factor": 1}
        option = m.option(" ".join(f"--fix {name}={value}" for name, value in held.items()), f"fixed={held}".replace("'", '"'))
        beside_it = ", ".join(beside.values())
        yield (
            f"measured lengths share errors, so {shared} fitted too, within priors: {beside_it}; to keep only the errors of "
            f"each length, give {option}"
        )
    if m.in_si and m.young is None:
        yield "no young_GPa: the data determine the areal stiffness only as its ratio to Young's modulus"


def _of_sigma(result: "FitResult") -> Iterator[str]:
    m = result.measurements
    if m.length_sigma is None and "length" in result.parameters.front.observes:
        yield "no standard errors were given; equal ones are assumed, as large as the scatter about the fit"
    elif result.scaled:
        yield f"the stated σ are taken as relative, and scaled by {result.scatter:.3g} to the scatter about the fit"
    if result.p_value is not None and result.problem.drawn and result.p_value < SCATTERED:
        yield f"doubtful (p = {result.p_value:.2g}): a line may be wrong, or lengths vary with the height as no model's do"
    elif not result.problem.emulates and result.p_value is not None and IMPROBABLE <= result.p_value < SCATTERED:
        factor = np.sqrt(result.misfit / (result.testable_dof or 1))
        taken = f"; {size_from_scatter(m)} takes its size from the scatter" * result.problem.exact_values
        larger = f"σ would have to be {factor:.2g} times as large{taken}"
        yield f"the scatter is larger than σ explains (p = {result.p_value:.2g}); {larger}"
    if result.problem.loss != "normal":
        yield f"loss: {result.problem.loss}; outliers count less than their σ implies"


def _of_pulls(result: "FitResult", shown: dict[str, Shown]) -> Iterator[str]:
    """Name the inputs that the lengths pull farther than chance would.

    The difference between fitted and stated value scatters by √(σ² − s²), with the stated error σ and that of the fit, s.
    """
    if result.covariance is None or result.identifiability not in GIVEN:
        return
    free = zip(result.parameters.free, result.theta.tolist(), np.diag(result.covariance).tolist(), strict=True)
    known = [every for every in free if math.isfinite(every[0].prior_sigma) and every[0].name != "arrest"]
    pulled: dict[str, list[str]] = {}
    for one, theta, variance in known:
        off = theta - one.prior_mean
        usual = math.sqrt(max(one.prior_sigma**2 - variance, 1e-12 * one.prior_sigma**2))
        chance = 1 - (1 - 2 * ndtr(-abs(off) / usual)) ** len(known)
        if abs(off) > one.prior_sigma and chance < SCATTERED:  # a smaller pull hardly moves the result
            by = f"{abs(off) / one.prior_sigma:.2f} σ {'above' if off > 0 else 'below'}"
            pulled.setdefault(one.name, []).append(f"{shown[one.label].symbol} {by}")
    if not pulled:
        return
    which = listed([text for every in pulled.values() for text in every])
    shared = pulled.keys() & {*OF_MEASURING}
    together = len(set(result.measurements.specimen)) > 1 and any(name in STIFFNESSES for name in result.names)
    checks = ["check the stated value and its error"] * bool(pulled.keys() - shared)
    each = result.measurements.option("--each-specimen stiffness", 'free=[sp.Parameter("stiffness", each="specimen")]')
    checks += [f"the specimens may differ in stiffness ({each})"] * together
    checks += ["the lengths do not vary with the height as the model's do"] * bool(shared)
    yield f"the lengths put {which} what was stated, more than chance would; {'; or '.join(checks)}"


def _of_shape(result: "FitResult", shown: dict[str, Shown]) -> Iterator[str]:
    """Name parameters whose 68 % interval differs from ± the error."""
    for name in result.names:
        this, by = shown[name], shown[name].sides
        if this.prior or math.inf in by or np.abs(by - 1).max() <= UNEVEN:
            continue  # an input with a stated error, or no difference
        why = "the likelihood is not parabolic"
        if result.calibrated:
            why = "the interval is that of simulated measurements"
        elif result.scatter_dof is not None and max(by) / min(by) < 1 + UNEVEN:
            why = f"the size of σ is known from {plural(result.dof, 'degree')} of freedom only"
        text = f"{this.intervals[LEVELS[0]]} {this.unit}".rstrip()
        yield (
            f"{this.symbol}: quote the 68 % interval {error_source(result)}, {text}, not ±; it reaches {by[0]:.2f} standard "
            f"errors below the value and {by[1]:.2f} above; {why}"
        )


def _of_what_is_alike(result: "FitResult") -> Iterator[str]:
    """Say how poorly prestress and what contacts keep are separated."""
    names = result.parameters.names
    if not {"prestress", "residual_strength"} <= {*names} or result.covariance is None:
        return
    both = [names.index(name) for name in ("prestress", "residual_strength")]
    (own, common), (_, kept) = result.covariance[np.ix_(both, both)]
    yield (
        f"φ and r move these data alike (correlation {common / math.sqrt(own * kept):+.2f}): with φ known, r would have "
        f"an error of {math.sqrt(max(kept - common**2 / own, 0.0)):.2g}, not {math.sqrt(kept):.2g}"
    )


def _of_attainable(result: "FitResult") -> Iterator[str]:
    """Warn of lengths near or above the longest that any stiffness gives."""
    m, attainable, front = result.measurements, result.attainable, result.parameters.front
    if not any(one.name in STIFFNESSES for one in result.parameters.free):
        return
    lowest = np.where(np.array(m.kind) == "whole", m.length - 1, m.length) - np.nan_to_num(m.sigma)
    above = lowest > attainable
    if above.any():
        i, count = int(np.argmin(attainable / m.length)), int(above.sum())
        reached = "where no domino starts"
        if attainable[i] > 0:
            reached = f"{m.length[i] / attainable[i]:.3g} times the longest attainable, {m.in_its_unit(i, attainable[i])}"
        yield (
            f"{count} length{'s lie' if count > 1 else ' lies'} more than σ above the longest at any stiffness searched; the "
            f"worst is {m.number(i)}: {m.in_its_unit(i, m.length[i])}, {reached}"
        )
    plateau = ~above & (m.length > PLATEAU * attainable)
    if plateau.any() and front.event != "crack":
        poisson, count = m.poisson[plateau][0], int(plateau.sum())
        ceiling = f"; no first front of a tall slider exceeds {float(length_ceiling(poisson)):.3f} H at ν = {poisson:g}"
        lie, they = ("lie", "they constrain") if count > 1 else ("lies", "it constrains")
        some = f"{count} of {len(m)} lengths {lie}" if len(m) > 1 else "the length lies"
        nearly = f"within {100 * (1 - PLATEAU):.0f} % of the longest attainable, where {they} stiffness little"
        yield f"{some} {nearly}{ceiling * (front.body == 'slider')}"


def _of_model(result: "FitResult") -> Iterator[str]:
    """Say where the model leaves a result uncertain.

    Its search, the definition of a length, the edge contact, or the end of a block.
    """
    m, front = result.measurements, result.parameters.front
    if front.event == "domino" and result.fitted.max() >= MOST_CONTACTS:
        yield f"not included: block end, compliant machine; fronts of more than {MOST_CONTACTS:g} contacts take long"
    known = {one.name for one in result.parameters.free} | {*result.parameters.held}
    if left_out := front.left_out(m, known):
        yield f"not included: {', '.join(left_out)}"
    if result.between_contacts is not None:
        i = int(np.argmax(result.between_contacts))
        off = m.in_its_unit(i, float(f"{result.between_contacts[i]:.2g}"))
        yield f"{front.uncertain_as} within {off} ({m.place(i)}); this is added to σ in quadrature"
    if front.event == "domino" and any(root.rebreaks for root in result.roots[:1]):
        yield (
            "at the fitted stiffness the edge contact is back at its threshold before the front stops; the length is that of "
            "the first front alone"
        )
    if m.block_length is not None and (short := (ratio := m.block_length / result.regime.slow_decay_length) < END).any():
        yield (
            f"{int(short.sum())} of {len(m)} blocks are shorter than {END:g}/κ₂ (the shortest {np.nanmin(ratio):.2g}/κ₂); the "
            "lengths depend on the far end, taken to be free"
        )
