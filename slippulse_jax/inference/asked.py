"""What is asked of a fit, held against what the measurements can give."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from slippulse_jax.inference.measurements import Measurements
from slippulse_jax.inference.parameters import NEEDS_SI, STIFFNESSES, Parameter


def stiffness_name(m: Measurements) -> str:
    """The form of the stiffness that these measurements can give."""
    if m.correlation_length is None:
        return "stiffness"
    return "areal_stiffness_over_young" if m.young is None else "areal_stiffness"


def as_asked(m: Measurements, wanted: Iterable[str | Parameter]) -> list[Parameter]:
    """Every parameter fitted or held, the stiffness by the name it has for these measurements.

    Raises
    ------
    ValueError
        If one is there twice or has no meaning for these measurements, or one that is needed is missing.
    """
    stiffness = stiffness_name(m)
    chosen = [Parameter(one) if isinstance(one, str) else one for one in wanted]
    chosen = [
        replace(one, name=stiffness) if one.name == "stiffness" else one for one in chosen
    ]  # k/K in SI is the areal stiffness for a fixed λc/E
    names = [one.name for one in chosen]
    for one in chosen:
        if names.count(one.name) > 1:
            raise ValueError(f"parameter {one.name} is given {names.count(one.name)} times")
        _check_meaning(m, one, stiffness)
    if stiffness not in names:
        raise ValueError(f"{stiffness} is neither fitted nor held: name it, or give Parameter({stiffness!r}, value=…)")
    if "strength" not in names and (carrier := _carries_strength(m)):
        raise ValueError(
            f"the measurements state a {carrier}, which scales with σ_s: fit strength too, or hold it at its value in Pa"
        )
    if "width" in names:
        _check_smooth(m, names)
    if not any(one.value is None for one in chosen):
        raise ValueError("nothing is fitted: every parameter is held")
    return chosen


def _check_meaning(m: Measurements, one: Parameter, stiffness: str) -> None:
    """Refuse a parameter that these measurements give no meaning."""
    if one.name == "arrest":
        raise ValueError("parameter arrest: it is fitted wherever gauges were read, and need not be asked for")
    if one.name in STIFFNESSES and one.name != stiffness:
        raise ValueError(f"parameter {one.name}: these measurements can give {stiffness}")
    if one.name in NEEDS_SI and m.correlation_length is None:
        raise ValueError(f"parameter {one.name}: needs measurements in SI, with their correlation length")
    if one.name == "young" and m.young is None:
        raise ValueError("parameter young: the measurements state no young_GPa to start from")
    if one.each == "specimen" and not m.specimen:
        raise ValueError(f"parameter {one.name}: each = 'specimen', but the measurements name no specimens")
    if one.name == "model_factor" and one.prior is None and one.value is None:
        raise ValueError("parameter model_factor: needs a prior, as (1, 0.05): the lengths alone cannot tell it from stiffness")


def _check_smooth(m: Measurements, names: Sequence[str]) -> None:
    """The smooth rule of the fast recursion is for relaxed, uniform interfaces."""
    for name in ("prestress", "threshold_slope"):
        if name in names or m.or_zero(name).any():
            raise ValueError(f"parameter width: the smooth rule is for relaxed, uniform interfaces, without {name}")
    if m.gauges is not None:
        raise ValueError("parameter width: readings of gauges are those of the hard rule; leave one of them out")


def _carries_strength(m: Measurements) -> str:
    """What was measured that scales with σ_s; empty if nothing was."""
    for name in ("displacement", "force"):
        if np.isfinite(m.or_zero(name)).any() and getattr(m, name) is not None:
            return name
    return "reading of a gauge" if m.gauges is not None else ""
