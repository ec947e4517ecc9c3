"""What a quasi-static fit makes of lengths that the quasi-static model did not make, and which error model is honest about it.

Lengths of the chain with inertia, and of a second precursor on contacts that age, at five heights and several stiffnesses;
2 % of noise, 40 studies each. Prints the bias of k/K and the coverage of the intervals.
Run: python benchmarks/misspecification.py
"""

import jax
import numpy as np

import slippulse_jax as sp

HEIGHTS = np.array([10.0, 15.0, 20.0, 25.0, 30.0])
STIFFNESS = np.geomspace(2e-3, 1e-2, 4)
STUDIES, SIGMA, SITES = 40, 0.02, 160

ERRORS = {
    "σ alone": [],
    "discrepancy": ["discrepancy"],
    "model factor 1 ± 0.1": [sp.Parameter("model_factor", prior=(1, 0.1))],
    "discrepancy, model factor 1 ± 0.1": ["discrepancy", sp.Parameter("model_factor", prior=(1, 0.1))],
    "discrepancy, model factor 1 ± 0.2": ["discrepancy", sp.Parameter("model_factor", prior=(1, 0.2))],
}


def quasi_static(slider: sp.Slider) -> float:
    """The model itself, as a check of this program."""
    return float(sp.exact_length(slider))


def inertial(slider: sp.Slider) -> float:
    """Extent of the first precursor of a slightly damped chain."""
    motion = sp.simulate_inertial(sp.chain(slider, sites=SITES, right="semi-infinite"), duration=600.0, damping=0.1)
    return float(motion.extent) - 0.5


def ageing(slider: sp.Slider) -> float:
    """Extent of the second precursor that reaches past the first, on contacts reborn at 0.3 σ_s that recover over 3 u_s."""
    chain = sp.chain(slider, sites=SITES, right="semi-infinite")
    catalogue = sp.series(chain, events=40, ageing=sp.Ageing(newborn=0.3, scale=3.0))
    extent = np.asarray(catalogue.extent)
    beyond = np.nonzero(extent > extent[0])[0]
    return float(extent[beyond[0]] if len(beyond) else extent[0]) - 0.5


def main() -> None:
    """Print one table."""
    print("| data from | error model | bias of k/K | 68 % | 95 % | number given |\n|---|---|---|---|---|---|")
    for name, source in (("model itself", quasi_static), ("inertia, γ = 0.1", inertial), ("second precursor, ageing", ageing)):
        with jax.enable_x64(True):
            lengths = np.array([[source(sp.Slider(h, k, 0.3)) for h in HEIGHTS] for k in STIFFNESS])
            true = np.array([[quasi_static(sp.Slider(h, k, 0.3)) for h in HEIGHTS] for k in STIFFNESS])
        print(f"  ({name}: length over the model's {np.array2string((lengths / true).mean(axis=1), precision=3)})", flush=True)
        for label, extra in ERRORS.items():
            rng = np.random.default_rng(5)
            bias, hits, given = [], np.zeros(2), 0
            for truth, length in zip(STIFFNESS, lengths, strict=True):
                for _ in range(STUDIES):
                    sigma = SIGMA * length
                    m = sp.Measurements(
                        height=HEIGHTS, poisson=0.3, length=length + sigma * rng.standard_normal(5), length_sigma=sigma
                    )
                    result = sp.fit(m, ["stiffness", *extra])
                    bias.append(np.log(result.value / truth))
                    given += bool(result.intervals["stiffness"][0.95])
                    hits += [any(p.low <= truth <= p.high for p in pieces) for pieces in result.intervals["stiffness"].values()]
            count = STUDIES * len(STIFFNESS)
            shares = " | ".join(f"{100 * x / count:.0f} %" for x in (*hits, given))
            print(f"| {name} | {label} | {100 * np.expm1(np.mean(bias)):+.0f} % | {shares} |", flush=True)


if __name__ == "__main__":
    main()
