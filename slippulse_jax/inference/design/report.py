"""A design of experiments as text and as plain values."""

from typing import TYPE_CHECKING, Any

import numpy as np

from slippulse_jax.files import plain

if TYPE_CHECKING:
    from slippulse_jax.inference.design.design import Candidate, Design

BIT = np.log(2)


def labels(candidates: list["Candidate"]) -> list[str]:
    """Name each candidate by the conditions in which the candidates differ."""
    each = [_conditions(one) for one in candidates]
    differ = [field for field in each[0] if len({getattr(c, field) for c in candidates}) > 1] or ["height"]
    return [", ".join(conditions[field] for field in differ) for conditions in each]


def _conditions(one: "Candidate") -> dict[str, str]:
    """Conditions of a candidate in words, by field."""
    size, unit = (1, "λc") if one.correlation_length is None else (1e3, "mm")
    side, of_side = (1, "H") if one.correlation_length is None else (one.height * size, unit)
    return {
        "height": f"H = {one.height * size:.5g} {unit}",
        "poisson": f"ν = {one.poisson:g}",
        "prestress": f"φ = {one.prestress:g}",
        "threshold_slope": f"ε = {one.threshold_slope:g}",
        "sigma": f"σ = {one.sigma * size:.3g} {unit}",
        "correlation_length": f"λc = {(one.correlation_length or 0) * 1e6:.4g} µm",
        "young": f"E = {(one.young or 0) * 1e-9:.4g} GPa",
        "push_height": f"h = {(one.push_height or 0) * side:.4g} {of_side}",
        "push_width": f"pusher {(one.push_width or 0) * side:.4g} {of_side}",
    }


def report(found: "Design") -> str:
    """Format a design as text."""
    k = found.knowledge
    unit = " Pa/m" if k.in_si else ""
    symbol = "k/λc²" if k.in_si else "k/K"
    several = len(k.roots) > 1
    lines = [f"Known: {symbol} " + (" or " if several else "").join(
        f"{value:.4g}{unit} (ln ± {sd:.2g}{f', {share:.0%}' if several else ''})" for share, value, sd in k.roots
    )]  # fmt: skip
    lines.append(f"       standard deviation of ln k, over all roots: {k.log_sd:.3g}")
    names = labels(found.candidates)
    wide = max(map(len, names))
    apart = f" {'told apart':>11}" if several else ""
    lines.append(f"{'':4} {'candidate':{wide}} {'length':>17} {'information':>18} {'D-optimal':>10} {'se of ln k':>11}{apart}")
    scale, length_unit = scale_of(found)
    for place, i in enumerate(found.ranking, 1):
        mean, sd = found.expected_length[i] * scale[i]
        span = f"{mean:8.4g} ± {sd:<6.2g}{length_unit}" if np.isfinite(mean) else "never stops"
        last = f" {found.told_apart[i]:11.0%}" if several else ""
        lines.append(
            f"{place:3}. {names[i]:{wide}} {span:{17 + len(length_unit)}} "
            f"{found.information[i] / BIT:6.3f} ± {_small(found.information_error[i] / BIT)} bit "
            f"{found.d_optimal[i] / BIT:6.3f} bit {found.log_stderr[i]:11.3g}{last}"
        )
    lines.append(_by_root(found))
    if len(found.sequence) > 1:
        lines.append("Sequence, each adding most to those before it:")
        for place, (i, gain) in enumerate(found.sequence, 1):
            last = f", roots told apart {gain.told_apart:.0%}" if several else ""
            lines.append(
                f"{place:3}. {names[i]:{wide}} together {gain.information / BIT:.3f} ± "
                f"{_small(gain.error / BIT)} bit, se of ln k {gain.log_stderr:.3g}{last}"
            )
    lines += [f"  {note}" for note in notes(found)]
    return "\n".join(lines)


def _by_root(found: "Design") -> str:
    """Length expected of the best candidate under each root."""
    k, best = found.knowledge, found.best
    scale, name = scale_of(found)
    seen = []
    for root, (_, value, _) in enumerate(k.roots):
        own = (k.labels == root) & np.isfinite(found.length[:, best])
        weight = k.probability[own]
        length = weight @ found.length[own, best] / weight.sum() if weight.sum() > 0 else np.inf
        seen.append(f"{length * scale[best]:.4g} {name} if {'k/λc²' if k.in_si else 'k/K'} = {value:.3g}")
    return f"Next: {labels(found.candidates)[best]}; expect {', '.join(seen)}."


def notes(found: "Design") -> list[str]:
    """List warnings to read before the experiment."""
    said = []
    pushed = found.candidates[0]
    if pushed.push_height is not None:
        over = "on a patch" if pushed.push_width is not None else "over everything above"
        said.append(f"Blocks under two-dimensional elasticity, pushed {over} at the height h, {pushed.push_control} held.")
    elif found.knowledge.event == "full":
        said.append("Lengths are those of whole events, in which contacts may break again.")
    if (found.information_error > 0.1 * np.maximum(found.information, 0.05)).any():
        said.append("Note: too few samples for an error this small; give more (nodes, or a longer chain).")
    endless = found.knowledge.probability @ np.isinf(found.length)
    for i in np.flatnonzero(endless > 1e-3).tolist():
        said.append(f"Note: {labels(found.candidates)[i]}: with probability {endless[i]:.0%} the front never stops.")
    if found.information.max() < 0.1:
        said.append("Note: no candidate adds much information: the lengths are on their plateau, or already known to within σ.")
    return said


def _small(x: float) -> str:
    return f"{x:.3f}" if x >= 5e-4 else "0.001" if x > 1e-4 else "0.000"


def scale_of(found: "Design") -> tuple[np.ndarray, str]:
    """Size of λc in the unit of lengths, for each candidate, and the name of the unit."""
    if found.knowledge.in_si:
        return np.array([(c.correlation_length or 0) * 1e3 for c in found.candidates]), "mm"
    return np.ones(len(found.candidates)), "λc"


def to_dict(found: "Design") -> dict[str, Any]:
    """Plain Python values of everything but the samples, ready for JSON; information in nats."""
    lengths = found.expected_length
    content = {
        "knowledge": {
            "unit": "Pa/m" if found.knowledge.in_si else "",
            "log_sd": found.knowledge.log_sd,
            "event": found.knowledge.event,
            "roots": [{"probability": p, "stiffness": k, "log_sd": sd} for p, k, sd in found.knowledge.roots],
        },
        "units": {"information": "nat", "length": "λc", "height": "m" if found.knowledge.in_si else "λc", "push": "H"},
        "candidates": [
            {
                **c._asdict(),
                "label": label,
                "rank": int(np.flatnonzero(found.ranking == i)[0]) + 1,
                "length": lengths[i, 0],
                "length_sd": lengths[i, 1],
                "never_stops": found.knowledge.probability @ np.isinf(found.length[:, i]),
                **{
                    name: getattr(found, name)[i]
                    for name in ("information", "information_error", "d_optimal", "log_stderr", "told_apart")
                },
            }
            for i, (c, label) in enumerate(zip(found.candidates, labels(found.candidates), strict=True))
        ],
        "sequence": [{"candidate": s.candidate, **s.gain._asdict()} for s in found.sequence],
        "notes": notes(found),
    }
    return plain(content)
