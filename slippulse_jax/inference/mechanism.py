"""Pulse or crack: which of two fronts measurements show.

Both are fitted. The difference of their deviances is compared with what it is in measurements simulated from either fit, and
fitted by both: no theorem holds for models of which none contains the other.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from slippulse_jax.base.status import NotConverged
from slippulse_jax.inference.fit import FitResult, fit, wanted_parameters
from slippulse_jax.inference.parameters import Parameter
from slippulse_jax.inference.result.samples import refitted, simulated
from slippulse_jax.inference.table.measurements import Measurements

LEVEL = 0.05
"""Share of simulated measurements beyond which a kind of front is rejected."""


@dataclasses.dataclass(frozen=True, eq=False)
class Mechanism:
    """Fits of both fronts, and the significance of their difference."""

    pulse: FitResult
    crack: FitResult
    difference: float  # deviance of the pulse less that of the crack
    p_pulse: float  # share of pulses with a difference at least as large
    p_crack: float  # share of cracks with a difference at most as large
    power: float  # share of simulated cracks in which the pulse is rejected
    power_of_pulse: float  # share of simulated pulses in which the crack is rejected
    unconverged: float  # share of refits that did not converge, whose deviance may be too large

    @property
    def statement(self) -> str:
        """The conclusion in a sentence."""
        pulse, crack = self.p_pulse < LEVEL, self.p_crack < LEVEL
        if pulse and crack:
            return "neither front gives these measurements"
        if crack:
            return "a self-healing front: a crack-like one is rejected"
        if pulse:
            return "a crack-like front: a self-healing one is rejected"
        freed = {"residual_strength"} <= {*self.pulse.names} and {"friction"} <= {*self.crack.names}
        if freed and all(data.observable.of_rows for data in self.pulse.problem.observed):
            return (
                "lengths alone cannot separate a pulse from a crack, each with the stress that it leaves free; gauges behind "
                "the tip can"
            )
        return "these measurements do not separate the two"

    def __str__(self) -> str:
        crack = ", ".join(f"{name} {value:.4g}" for name, value in self.crack.values.items())
        pulse = ", ".join(f"{name} {value:.4g}" for name, value in self.pulse.values.items())
        return "\n".join(
            (
                f"Pulse or crack: {self.statement}",
                f"  deviance             pulse {self.pulse.deviance:.4g} (best {pulse})",
                f"                       crack {self.crack.deviance:.4g} (best {crack})",
                f"  p of the difference  pulse {self.p_pulse:.3g}, crack {self.p_crack:.3g}, by simulation",
                f"  power                a crack as fitted would reject the pulse in {self.power:.0%} of cases, "
                f"a pulse the crack in {self.power_of_pulse:.0%}",
            )
        )


def pulse_or_crack(
    measurements: Measurements,
    free: Sequence[str | Parameter] = ("stiffness",),
    *,
    simulations: int = 200,
    seed: int = 0,
    **options: Any,
) -> Mechanism:
    """Compare self-healing and crack-like fronts as models of the same measurements.

    Parameters
    ----------
    measurements : Measurements
        Readings of gauges behind the tip tell most: a crack leaves its friction there, a pulse the stress of contacts that were
        loaded anew. From lengths alone little can be told (docs/model/beyond.md).
    free : sequence of str or Parameter
        Parameters to fit, as for `fit`. The stress that a front leaves behind is fitted beside them: what contacts of the pulse
        keep (`residual_strength`), unless a prestress is fitted or thresholds have a slope, and the friction of the crack.
    simulations : int
        Measurements simulated from each fit.
    seed : int
    **options
        Further arguments of `fit`.

    Returns
    -------
    Mechanism
        Every refit starts at the minima of the fits to the measurements themselves.

    Raises
    ------
    ValueError
        As `fit` does; or if there are fewer than 20 simulations, or the pulse's event is to be a crack.
    NotConverged
        If a simulated measurement has no finite deviance near one of the fits; never seen.
    """
    if simulations < 20:
        raise ValueError(f"simulations = {simulations}: at least 20 are needed")
    if options.get("event") == "crack":
        raise ValueError("event = 'crack': both fronts are fitted; 'domino' or 'full' says what the pulse's lengths are")
    options = {"intervals": "profile", "body": "slider", **options}  # none is looked at here
    wanted = wanted_parameters(measurements, free, options.pop("bounds", None), options.pop("fixed", None))
    names, fitted = {one.name for one in wanted}, {one.name for one in wanted if one.value is None}
    alike = "prestress" in fitted or "threshold_slope" in names or measurements.or_zero("threshold_slope").any()
    kept = [] if alike or "residual_strength" in names else [Parameter("residual_strength")]
    friction = [] if "friction" in names else [Parameter("friction")]
    pulse = fit(measurements, [*(one for one in wanted if one.name != "friction"), *kept], seed=seed, **options)
    of_crack = [*(one for one in wanted if one.name != "residual_strength"), *friction]
    crack = fit(measurements, of_crack, seed=seed, **{**options, "event": "crack"})
    rng = np.random.default_rng(seed)
    of_pulses, of_cracks = (_differences(truth, pulse, crack, simulations, rng) for truth in (pulse, crack))
    difference = pulse.deviance - crack.deviance
    return Mechanism(
        pulse=pulse,
        crack=crack,
        difference=difference,
        p_pulse=float((of_pulses[0] >= difference).mean()),
        p_crack=float((of_cracks[0] <= difference).mean()),
        power=float((of_cracks[0] > np.quantile(of_pulses[0], 1 - LEVEL)).mean()),
        power_of_pulse=float((of_pulses[0] < np.quantile(of_cracks[0], LEVEL)).mean()),
        unconverged=float(np.mean([of_pulses[1], of_cracks[1]])),
    )


def _differences(
    truth: FitResult, pulse: FitResult, crack: FitResult, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    """Simulated deviances of pulse less crack, and the share not converged."""
    drawn = simulated(truth, count, rng)
    every, deviance, lost = [(data.value, data.weight) for data in drawn.observed], [], []
    for result in (pulse, crack):
        means = np.repeat(result.problem.prior_mean, count, axis=0)
        for j, name in enumerate(result.parameters.names):
            if name in truth.parameters.names:
                means[:, j] = drawn.prior_mean[:, truth.parameters.index(name)]
        _, found, converged = refitted(result, result.problem.with_replicates(every, means), count)
        if not np.isfinite(found).all():
            raise NotConverged("pulse or crack: simulated measurements that no front near the fits gives; never seen")
        deviance.append(found)
        lost.append(1 - converged.mean())
    return deviance[0] - deviance[1], float(np.mean(lost))
