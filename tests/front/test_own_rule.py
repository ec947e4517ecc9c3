"""A break rule of one's own: every function that takes ``rule=`` uses it, against a dense program that knows it too."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles.dense_chain import responses
from scipy.integrate import quad

import slippulse_jax as sp
from slippulse_jax.rules import BreakRule

FIG2 = sp.Slider(height=25.0, stiffness=0.03, poisson=0.3)
SITES = 120


class EvenBreak(BreakRule):
    """Thresholds spread evenly from θ − w to θ + lean w: a law with two numbers."""

    width: float = 0.01
    lean: float = 1.0

    def broken(self, stress, threshold):
        return jnp.clip((stress - threshold + self.width) / (self.width * (1 + self.lean)), 0, 1)

    def overloaded_length(self, before, after, threshold_before, threshold_after):
        a, b = before - threshold_before, after - threshold_after
        return (self._integral(b) - self._integral(a)) / (b - a)

    def _integral(self, excess):
        spread = self.width * (1 + self.lean)
        inside = jnp.clip(excess + self.width, 0, spread)
        return inside**2 / (2 * spread) + jnp.maximum(excess - self.lean * self.width, 0)


class Plain:
    """The front under that law, of a dense chain; p(t) written and integrated without the class above."""

    load, pinning = responses(25.0, 0.03, 0.3, 400, "semi-infinite", SITES)

    def __init__(self, width, lean):
        def p(t):
            return np.interp(t, [1 - width, 1 + lean * width], [0.0, 1.0])

        t, gone = np.zeros(SITES), np.zeros(SITES)
        for s in range(SITES):
            t[s] = self.load[s] / self.load[0] + self.pinning[s, :s] @ gone[:s]
            gone[s] = t[s] * (p(t[s]) if s else 1)
        self.stress, self.length = t, p(t[1])
        for a, b in zip(t[1:-1], t[2:], strict=True):
            bends = [(x - a) / (b - a) for x in (1 - width, 1 + lean * width)]
            inside = [x for x in bends if 0 < x < 1]
            self.length += quad(lambda x, a=a, b=b: p(a + (b - a) * x), 0, 1, points=inside, epsabs=1e-13)[0]


@pytest.fixture(scope="module")
def plain():
    return Plain(0.03, 0.5)


RULE = EvenBreak(width=0.03, lean=0.5)


@pytest.mark.ci
def test_every_function_uses_it(plain):
    default = sp.precursor_lengths(FIG2, rule=sp.SmoothBreak(width=0.03))
    assert abs(default - plain.length) > 0.1, "or a rule that is not used would not be seen"
    assert sp.precursor_length(FIG2, rule=RULE) == pytest.approx(plain.length, abs=1e-9)
    assert sp.precursor_lengths(FIG2, rule=RULE) == pytest.approx(plain.length, abs=1e-9)
    found = sp.sensitivity(FIG2, sites=SITES, rule=RULE)
    assert found.length == pytest.approx(plain.length, abs=1e-9)
    np.testing.assert_allclose(found.stress, plain.stress, atol=1e-9)
    chain = sp.chain(FIG2, sites=SITES)
    state, site = sp.nucleate(chain)
    event = sp.rupture(chain, state, rule=RULE, trigger=site)
    assert event.length == pytest.approx(plain.length, abs=1e-9)


@pytest.mark.ci
def test_derivatives_in_its_own_numbers():
    """In the widths of a batch and in the second number they share, in reverse; against differences of the plain program."""
    h, widths = 1e-5, (0.03, 0.05)
    by_width = [(Plain(w + h, 0.5).length - Plain(w - h, 0.5).length) / (2 * h) for w in widths]
    by_lean = sum((Plain(w, 0.5 + h).length - Plain(w, 0.5 - h).length) / (2 * h) for w in widths)
    batch = EvenBreak(width=jnp.array(widths), lean=0.5)
    found = jax.grad(lambda rule: sp.precursor_length(FIG2, rule=rule).sum())(batch)
    assert isinstance(found, EvenBreak)
    np.testing.assert_allclose(found.width, by_width, rtol=1e-5)
    np.testing.assert_allclose(found.lean, by_lean, rtol=1e-5)
    bulk = sp.precursor_lengths(FIG2, rule=batch, derivatives=1)
    assert isinstance(bulk.rule, EvenBreak)
    np.testing.assert_allclose(bulk.rule.width, found.width, rtol=1e-10)
    np.testing.assert_allclose(bulk.rule.lean.sum(), found.lean, rtol=1e-10)
    np.testing.assert_allclose(bulk.length, sp.precursor_lengths(FIG2, rule=batch), rtol=1e-13)
    up, down = (sp.precursor_lengths(sp.Slider(25.0 + e, 0.03, 0.3), rule=batch) for e in (h, -h))
    np.testing.assert_allclose(bulk.slider.height, (up - down) / (2 * h), rtol=1e-5)


@pytest.mark.ci
def test_batches_and_bulk():
    """Its numbers broadcast with the slider's; rules of two classes with the same numbers are told apart."""
    rule = EvenBreak(width=np.array([0.01, 0.03])[:, None], lean=np.array([1.0, 0.5, 0.0]))
    found = sp.precursor_lengths(FIG2, rule=rule)
    assert found.shape == (2, 3)
    assert found[1, 1] == pytest.approx(Plain(0.03, 0.5).length, abs=1e-9)
    default = sp.precursor_lengths(FIG2, rule=sp.SmoothBreak(width=0.03))
    assert sp.precursor_lengths(FIG2, rule=NarrowBreak(width=0.06)) == pytest.approx(default, abs=1e-12)
    assert sp.precursor_lengths(FIG2, rule=NarrowBreak(width=0.03)) != pytest.approx(default, abs=1e-3)


class NarrowBreak(BreakRule):
    """The law of the package, of half the width."""

    width: float

    def broken(self, stress, threshold):
        return sp.SmoothBreak(self.width / 2).broken(stress, threshold)

    def overloaded_length(self, before, after, threshold_before, threshold_after):
        return sp.SmoothBreak(self.width / 2).overloaded_length(before, after, threshold_before, threshold_after)


class WithLaw(EvenBreak):
    """With a field that is no number."""

    law: str = "even"


class NamedBreak(EvenBreak):
    """With one that is static."""

    law: str = eqx.field(static=True, default="even")


CHAIN = sp.chain(FIG2, sites=10)
TAKERS = [
    lambda rule: sp.precursor_length(FIG2, rule=rule),
    lambda rule: sp.precursor_lengths(FIG2, rule=rule),
    lambda rule: sp.precursor_lengths(FIG2, rule=rule, derivatives=1),
    lambda rule: sp.sensitivity(FIG2, sites=SITES, rule=rule),
    lambda rule: sp.rupture(CHAIN, CHAIN.relaxed(), rule=rule),
]


@pytest.mark.parametrize("taker", TAKERS)
def test_what_would_not_be_used_is_refused(taker):
    with pytest.raises(TypeError, match=r"WithLaw\.law = 'even': must be a number"):
        taker(WithLaw(width=0.1))
    with pytest.raises(TypeError, match="rule = <class.*EvenBreak"):
        taker(EvenBreak)
    with pytest.raises(TypeError, match="rule = 0.1: must be None"):
        taker(0.1)


def test_a_rule_has_both_methods():
    """Refused before there is a rule: with one method as the class is defined, with none as an object of it is made."""

    class Neither(BreakRule):
        width: float = 0.1

    with pytest.raises(TypeError, match="Neither .*broken.*overloaded_length"):
        Neither()
    for base in (BreakRule, sp.SmoothBreak, EvenBreak):
        with pytest.raises(TypeError, match="NoMean defines `broken` alone: a break rule defines `broken` and `over"):
            type("NoMean", (base,), {"broken": lambda self, stress, threshold: 1.0})
        with pytest.raises(TypeError, match="NoPart defines `overloaded_length` alone"):
            type("NoPart", (base,), {"overloaded_length": lambda self, a, b, c, d: 1.0})


def test_one_rule_where_one_is_taken():
    batch = EvenBreak(width=np.array([0.01, 0.03]))
    for taker in TAKERS[3:]:
        with pytest.raises(ValueError, match=r"EvenBreak\.width has shape \(2,\)"):
            taker(batch)


@pytest.mark.ci
def test_on_a_block():
    """A law of its own, against the rule of the package that it halves the width of; no whole event."""
    block = sp.Block(10.0, 0.03, 0.3)
    own, half, as_wide = (
        float(sp.precursor_length(block, rule=rule, sites=48))
        for rule in (NarrowBreak(0.04), sp.SmoothBreak(0.02), sp.SmoothBreak(0.04))
    )
    assert own == pytest.approx(half, abs=1e-12)
    assert abs(own - as_wide) > 0.1
    with pytest.raises(ValueError, match="event = 'full': under a smooth rule"):
        sp.precursor_length(block, rule=RULE, event="full")


@pytest.mark.ci
def test_static_fields_are_kept(plain):
    assert sp.precursor_lengths(FIG2, rule=NamedBreak(width=0.03, lean=0.5)) == pytest.approx(plain.length, abs=1e-9)
