"""Random tables of measurements of every kind, drawn by seed from the model that is then fitted to them."""

import signal
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

import slippulse_jax as sp
from slippulse_jax.inference.parameters import parameter_set
from slippulse_jax.inference.search.likelihood import make_problem

KINDS = (
    "one stiffness", "bounds", "counts", "mixed", "prestress", "second", "each specimen", "priors", "student", "relative",
    "ends", "machine", "measured", "blocks",
)  # fmt: skip
"""What a table is of. Those after "mixed" are of lengths, counts and limits too, but for "relative" and "blocks"."""
ONE_BLOCK_IN = 40
"""One block in so many tables: its fit costs as much as many others."""
OF = {"one stiffness": "length", "relative": "length", "blocks": "length", "bounds": "at_least", "counts": "whole"}
PLAIN = ("one stiffness", "relative", "blocks")
"""Kinds to which nothing else is added."""


class Table(NamedTuple):
    """A table, what is fitted to it, and the true values of that."""

    measurements: sp.Measurements
    free: tuple[Any, ...]
    options: dict[str, Any]
    truth: dict[str, float]


class Late(Exception):
    """The time allowed is over."""


@contextmanager
def within(seconds):
    """Raise `Late` after so many seconds of processor time of this process."""

    def late(*_):
        raise Late

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def kind_of(seed: int) -> str:
    """Kind of the table of a seed: all in turn."""
    return "blocks" if seed % ONE_BLOCK_IN == 0 else KINDS[:-1][seed % (len(KINDS) - 1)]


def draw(seed: int, kind: str | None = None) -> Table:
    """Draw one table of a kind, with other complications at random."""
    for attempt in range(1000):
        found = _drawn(np.random.default_rng([seed, attempt]), kind or kind_of(seed))
        if found is not None:
            return found
    raise AssertionError(f"no table of {kind or kind_of(seed)}")


def _drawn(rng: np.random.Generator, kind: str) -> Table | None:
    """A table, or None where the model gives no lengths to measure."""
    n = int(rng.integers(4 if kind == "relative" else 1, 12))
    height = np.exp(rng.uniform(np.log(8), np.log(rng.choice([80, 1000, 5000])), n))
    if kind == "blocks":
        n = int(rng.integers(2, 5))
        height = np.full(n, np.exp(rng.uniform(np.log(20), np.log(60))))
    given: dict[str, Any] = {
        "height": height,
        "poisson": np.full(n, rng.uniform(0.05, 0.45)),
        "correlation_length": np.full(n, rng.uniform(3, 30) * 1e-6),
        "young": np.full(n, np.exp(rng.uniform(0, 5)) * 1e9),
    }
    mixtures = ["length"], ["length", "whole", "at_least"], ["whole"], ["at_least"], ["whole", "at_least"]
    of = [str(one) for one in rng.choice([OF[kind]] if kind in OF else mixtures[rng.integers(5)], n)]
    free, options = _complicate(rng, kind, given)
    ones = np.ones(n)
    wanted = parameter_set(sp.Measurements(length=ones, length_sigma=ones, kind=of, **given), free)
    theta = _true(rng, wanted, given, kind)
    exact = make_problem(sp.Measurements(length=ones, length_sigma=ones, kind=of, **given), wanted).predict(theta)[0]
    if not (np.isfinite(exact) & (exact > 0.5)).all():
        return None
    read, sigma = _measured(rng, exact, np.array(of))
    if (read <= 0.05).any() or (read > given.get("block_length", np.inf)).any():
        return None
    truth = {one.label: float(one.value(t)) for one, t in zip(wanted.free, theta, strict=True) if not one.nuisance}
    return Table(sp.Measurements(length=read, length_sigma=sigma, kind=of, **given), tuple(free), options, truth)


def _complicate(rng: np.random.Generator, kind: str, given: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Add columns to `given`; parameters to fit and options."""
    height, n = given["height"], len(given["height"])
    if kind in PLAIN:
        given |= {"push_height": height * 0.3, "block_length": height * rng.uniform(3, 5)} if kind == "blocks" else {}
        return ["stiffness"], {"sigma": "relative"} if kind == "relative" else {}
    shares = {"each specimen": 0.3, "prestress": 0.15, "second": 0.15, "priors": 0.3, "student": 0.2, "ends": 0.1}
    shares |= {"machine": 0.05, "measured": 0.1}
    there = {name for name, share in shares.items() if kind == name or rng.random() < share}
    free: list[Any] = ["stiffness"]
    if "each specimen" in there:
        given["specimen"] = [str(one) for one in rng.choice(["a", "b"], n)]
        free = [sp.Parameter("stiffness", each="specimen")] if kind == "each specimen" else free
    if "prestress" in there:
        free.append("prestress")
    if "second" in there:
        slope = sp.Parameter("threshold_slope", bounds=(-0.2 / height.max(), 1 / height.max()))
        free.append(["correlation_length", "poisson", "young", slope][rng.integers(4)])
    for name, share in (("poisson", 0.04), ("young", 0.05), ("correlation_length", 0.1)):
        if "priors" in there and rng.random() < 0.6 and name not in free:
            given[f"{name}_sigma"] = share * given[name]
    columns: dict[str, tuple[str, Any]] = {
        "ends": ("block_length", height * rng.uniform(2.2, 6)),
        "machine": ("machine_stiffness", given["young"] * np.exp(rng.uniform(-3, 3))),
        "measured": ("provenance", ["measured"] * n),
    }
    given |= dict(column for name, column in columns.items() if name in there)
    options = {"fixed": {"threshold_scatter": 0}} if "measured" in there else {}
    return free, options | ({"loss": "student"} if "student" in there else {})


def _true(rng: np.random.Generator, wanted: Any, given: dict[str, Any], kind: str) -> np.ndarray:
    """θ: b from 0.05 to 3 at the median height, errors of inputs by their priors, the rest as stated."""
    b = np.exp(rng.uniform(np.log(0.05), np.log(3)))
    poisson, young, unit = given["poisson"][0], given["young"][0], given["correlation_length"][0]
    stiffness = np.log(b / (2 * (1 + poisson) * np.median(given["height"])) * young / unit)
    stated = {"correlation_length": np.log(unit), "young": np.log(young), "poisson": poisson, "threshold_slope": 0.0}
    theta = []
    for one in wanted.free:
        if one.name == "areal_stiffness":
            theta.append(stiffness + 0.3 * rng.standard_normal() * (kind == "each specimen"))
        elif np.isfinite(one.prior_sigma):
            theta.append(rng.normal(one.prior_mean, one.prior_sigma))
        else:
            theta.append(rng.uniform(-0.2, 0.1) if one.name == "prestress" else stated[one.name])
    return np.clip(theta, wanted.low, wanted.high)


def _measured(rng: np.random.Generator, exact: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What is read of lengths, with errors of 0.5 to 10 %; and these, of most counts and limits 0."""
    n = len(exact)
    sigma = np.maximum(rng.uniform(0.005, 0.1, n) * exact, 0.01)
    sharp = np.where(rng.random(n) < 0.7, 0.0, np.minimum(sigma, 3.0))
    sigma = np.where(of == "length", sigma, sharp)
    read = exact + sigma * rng.standard_normal(n)
    count, limit = np.maximum(np.ceil(read), 1), read * rng.uniform(0.3, 1, n)
    return np.select([of == "whole", of == "at_least"], [count, limit], read), sigma
