"""Ends of every domain of the package: accepted or refused exactly, in both precisions, as the message says."""

import importlib
import pkgutil
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slippulse_jax
from slippulse_jax.base.domains import Domain


def inside(found, name):
    """Domains that a value is or holds, by their names."""
    if isinstance(found, Domain):
        yield found, name
    elif isinstance(found, dict):
        for key, one in found.items():
            yield from inside(one, f"{name}[{key}]")
    elif isinstance(found, tuple):
        for key, one in zip(getattr(found, "_fields", range(len(found))), found, strict=True):
            yield from inside(one, f"{name}.{key}")


def every_domain():
    """Domains of all modules, each once."""
    found = {}
    for module in pkgutil.walk_packages(slippulse_jax.__path__, "slippulse_jax."):
        for name, value in vars(importlib.import_module(module.name)).items():
            for domain, where in inside(value, f"{module.name.removeprefix('slippulse_jax.')}.{name}"):
                found.setdefault(domain, where)
    return {name: domain for domain, name in found.items()}


DOMAINS = every_domain()

WORDS = {
    "must exceed (-?[0-9]+)": ("low", None, False),
    "must exceed the correlation length": ("low", 1.0, False),
    "must be positive": ("low", 0.0, False),
    "must be 0 or more": ("low", 0.0, True),
    "cannot be negative|not negative": ("low", 0.0, True),
    "above the interface": ("low", 0.0, False),
    "numbered from 1": ("low", 1.0, True),
    "at least two": ("low", 2.0, True),
    "no less than an atom's size, 0.1 nm": ("low", 1e-10, True),
    "below 10⁴ GPa": ("high", 1e13, False),
    r"less than 2\*\*31 - 1": ("high", 2.0**31 - 1, False),
}
"""What messages say of an end, its value (None: the number in the text), and whether it is included."""


def stated(message):
    """Ends that a message states, each with whether it is included; ±inf where it states none."""
    ends = {"low": (-np.inf, False), "high": (np.inf, False)}
    if found := re.search(r"must lie in ([\[(])(\S+), (\S+)([\])])", message):
        return (float(found[2]), found[1] == "["), (float(found[3]), found[4] == "]")
    for words, (side, value, closed) in WORDS.items():
        if found := re.search(words, message):
            ends[side] = float(found[1]) if value is None else value, closed
    return ends["low"], ends["high"]


def test_domains_are_found_wherever_they_stand():
    names = " ".join(DOMAINS)
    for one in ("FRICTION", "rules.WIDTH", "COLUMNS[length_sigma].domain", "_DOMAIN[b]", "NEWBORN", "OF_SIDE"):
        assert one in names


@pytest.mark.parametrize("name", DOMAINS)
def test_ends_are_those_of_the_message(name):
    domain = DOMAINS[name]
    closed = domain.closed in ("low", "both"), domain.closed in ("high", "both")
    if "likely" not in name.lower():  # whose words are of what lies outside
        assert stated(domain.requirement) == ((domain.low, closed[0]), (domain.high, closed[1]))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", DOMAINS)
def test_ends_are_accepted_or_refused_exactly(name, dtype):
    domain, tiny = DOMAINS[name], np.finfo(dtype).tiny  # the smallest that compilers do not round to 0
    for end, other, side in ((domain.low, domain.high, "low"), (domain.high, domain.low, "high")):
        at = dtype(end)
        cases = {at: domain.closed in (side, "both")}
        if np.isfinite(at):
            away = np.inf if side == "high" else -np.inf
            cases[np.nextafter(at, dtype(other)) if at else np.copysign(tiny, -dtype(away))] = True
            cases[np.nextafter(at, dtype(away)) if at else np.copysign(tiny, dtype(away))] = False
        for number, holds in cases.items():
            with jax.enable_x64(True):
                for given in (number, jnp.asarray(number, dtype)):
                    assert given.dtype == dtype
                    assert bool(domain.holds(given)) == holds
                    if holds:
                        domain.check("x", given)
                    else:
                        with pytest.raises(ValueError, match=re.escape(domain.requirement) or None):
                            domain.check("x", given)
