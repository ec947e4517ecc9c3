"""The slider's numbers against the paper's formulas in many digits, and what it refuses."""

import re
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import slippulse_jax as sp
from slippulse_jax import Slider, precursor, precursor_length
from slippulse_jax.base.units import quantities
from slippulse_jax.exact.front import exact_front_stress
from slippulse_jax.slider import of_one_type

SLIDER = Slider(25.0, 0.03, 0.3)


def formulas(height, stiffness, poisson):
    """Definitions as printed (alpha with its bracket put right), in mpmath at the current precision."""
    height, q, nu = (mpmath.mpf(float(x)) for x in (height, stiffness, poisson))
    K_L, K_T = height, 1 / (2 * (1 + nu) * height)
    beta, kappa_T, kappa = K_T / (K_T + q), mpmath.sqrt(K_T / K_L), mpmath.sqrt(q + K_T)
    root = mpmath.sqrt((kappa**2 - kappa_T**2) ** 2 + 4 * beta * kappa**2 * kappa_T**2)
    kappa_1, kappa_2 = (mpmath.sqrt((kappa**2 + kappa_T**2 + sign * root) / 2) for sign in (1, -1))
    return {
        "K_L": K_L, "K_T": K_T, "b": q / K_T, "beta": beta, "kappa": kappa, "kappa_T": kappa_T, "mode_splitting": root,
        "kappa_1": kappa_1, "kappa_2": kappa_2, "alpha_1": 1 - kappa_1**2 / kappa_T**2, "alpha_2": 1 - kappa_2**2 / kappa_T**2,
    }  # fmt: skip


def test_derived_quantities_without_cancellation():
    rng = np.random.default_rng(3)
    n = 300
    sliders = 1 + 10 ** rng.uniform(-1, 5, n), 10 ** rng.uniform(-8, 0, n), rng.uniform(-0.9, 0.5, n)
    found = {name: np.asarray(getattr(Slider(*sliders), name)) for name in formulas(25.0, 0.03, 0.3)}
    with mpmath.workdps(60):
        for i, one in enumerate(zip(*sliders, strict=True)):
            for name, expected in formulas(*one).items():
                assert abs(found[name][i] / float(expected) - 1) < 5e-15, (name, one)


def test_every_quantity_has_symbol_unit_and_label():
    marked = quantities(Slider)
    public = {name for name, value in vars(Slider).items() if isinstance(value, property) and not name.startswith("_")}
    assert set(marked) == {"height", "stiffness", "poisson"} | (public - {"shape", "sites"})
    for name, quantity in marked.items():
        assert quantity.symbol, name
        assert quantity.unit, name
        assert quantity.label.startswith("cra"), name


def test_from_material():
    """PMMA-like block: H/λc and k/K by hand."""
    slider = Slider.from_material(height=75e-3, correlation_length=1e-6, areal_stiffness=2e10, poisson=0.3, young=3e9)
    assert float(slider.height) == pytest.approx(75_000)
    assert float(slider.stiffness) == pytest.approx(2e10 * 1e-6 / 3e9)
    # b = (areal stiffness) H / G, whatever λc
    assert float(slider.b) == pytest.approx(2e10 * 75e-3 / (3e9 / 2.6))


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("height", 1.0, r"Slider\.height = 1: must exceed 1"),
        ("height", np.inf, r"Slider\.height = inf: must exceed 1"),
        ("stiffness", 0.0, r"Slider\.stiffness = 0: must be positive"),
        ("stiffness", [0.1, -2.0, -3.0], r"Slider\.stiffness = -2 at index 1 \(2 such values\): must be positive"),
        ("stiffness", [[0.1, np.nan]], r"Slider\.stiffness = nan at index \(0, 1\): must be positive"),
        ("poisson", -1.0, r"Slider\.poisson = -1: must lie in \(-1, 0\.5\]"),
        ("poisson", 0.51, r"Slider\.poisson = 0\.51: must lie in"),
    ],
)
def test_refuses_what_is_not_physical(field, value, message):
    with pytest.raises(ValueError, match=message):
        Slider(**({"height": 25.0, "stiffness": 0.03, "poisson": 0.3} | {field: value}))


def test_refuses_shapes_that_do_not_broadcast_and_bad_materials():
    with pytest.raises(ValueError, match=r"must broadcast together: height \(3,\), stiffness \(2,\), poisson \(\)"):
        Slider([10.0, 20.0, 30.0], [0.1, 0.2], 0.3)
    with pytest.raises(ValueError, match=r"from_material: young = -3e\+09: Young's modulus must be positive"):
        Slider.from_material(height=0.05, correlation_length=1e-6, areal_stiffness=1e10, poisson=0.3, young=-3e9)
    with pytest.raises(ValueError, match=r"Slider\.height = 0\.5"):
        Slider.from_material(height=1e-6, correlation_length=2e-6, areal_stiffness=1e10, poisson=0.3, young=3e9)


def test_limits_of_poisson_ratio_are_allowed_where_physical():
    assert np.isfinite(precursor_length(Slider(25, 0.03, 0.5)))
    assert np.isfinite(precursor_length(Slider(25, 0.03, -0.5)))


@pytest.mark.ci
def test_slider_is_a_pytree_that_broadcasts():
    heights, stiffnesses = np.array([[10.0], [25.0]]), np.array([0.003, 0.01, 0.03])
    batch = Slider(heights, stiffnesses, 0.3)
    assert batch.shape == (2, 3)
    lengths = precursor_length(batch)
    assert lengths.shape == (2, 3)
    one_by_one = jax.vmap(lambda h: jax.vmap(lambda q: precursor_length(Slider(h, q, 0.3)))(stiffnesses))(heights[:, 0])
    np.testing.assert_array_equal(lengths, one_by_one)
    gradient = jax.grad(lambda slider: precursor_length(slider))(Slider(jnp.array(25.0), jnp.array(0.03), jnp.array(0.3)))
    assert isinstance(gradient, Slider)


def test_python_numbers_keep_double_precision_until_jax_asks(float32):
    """A Slider made in single-precision mode is not rounded: precursor_lengths works in double whatever the flag."""
    from slippulse_jax import precursor_lengths

    value = precursor_lengths(Slider(25.0, 0.03, 0.3))
    with jax.enable_x64(True):
        np.testing.assert_allclose(value, precursor_length(Slider(25.0, 0.03, 0.3)), rtol=1e-13)
    assert value.dtype == np.float64


NO_NUMBERS = [
    "25", b"25", ["25", "26"], np.datetime64("2020-01-01"), np.timedelta64(3, "s"), 25 + 1j, None, {}, object(),
    np.ma.masked_array([25.0, 26.0], [0, 1]),
]  # fmt: skip


@pytest.mark.parametrize("bad", NO_NUMBERS, ids=lambda x: type(x).__name__)
def test_what_is_no_number_is_refused(bad):
    slider = Slider(25.0, 0.03, 0.3)
    calls = [
        lambda: Slider(bad, 0.03, 0.3),
        lambda: sp.Interface(bad),
        lambda: sp.Profile(np.ones(2), bad),
        lambda: exact_front_stress(slider, bad),
        lambda: Slider(25.0, 0.03, 0.3, length=bad if bad is not None else "x"),
        lambda: sp.chain(slider, sites=4, upper=bad if bad is not None else "x"),
        lambda: Slider(25.0, 0.03, 0.3, machine=bad if bad is not None else "x"),
    ]
    for call in calls:
        with pytest.raises((TypeError, ValueError)):
            call()


class Own(eqx.Module):
    """A body of one's own: a slider's contacts."""

    slider: Slider

    @property
    def stiffness(self):
        return self.slider.stiffness

    def contacts(self, interface, sites):
        return self.slider.contacts(interface, sites)


BLOCK, OWN = sp.Block(3.0, 0.1, 0.3), Own(Slider(3.0, 0.1, 0.3))
WHOLE_SITES = {
    "chain": lambda n: sp.chain(SLIDER, sites=n).threshold,
    "sensitivity": lambda n: sp.sensitivity(SLIDER, sites=n).threshold,
    "length of a block": lambda n: sp.precursor_length(BLOCK, sites=n),
    "record of a block": lambda n: sp.first_precursor(BLOCK, sites=n).length,
    "series of a block": lambda n: sp.series(BLOCK, events=1, sites=n).length,
    "length of an own body": lambda n: sp.precursor_length(OWN, sites=n),
    "series of an own body": lambda n: sp.series(OWN, events=1, sites=n).length,
}


@pytest.mark.ci
@pytest.mark.parametrize("name", WHOLE_SITES)
def test_whole_numbers_of_numpy_are_taken(name):
    call = WHOLE_SITES[name]
    expected = np.asarray(call(16))
    for kind in (np.int32, np.int64):
        np.testing.assert_array_equal(call(kind(16)), expected)


@pytest.mark.ci
def test_a_sweep_takes_whole_numbers_of_numpy():
    given = {"height": [9.0], "stiffness": 0.1, "poisson": 0.3, "right": "free", "progress": False}
    expected = sp.sweep(**given, sites=16)
    assert sp.sweep(**given, sites=np.int64(16)).identical(expected)


@pytest.mark.parametrize("bad", [40.5, float("nan"), "40", -1, True, np.array(40)], ids=repr)
def test_counts_are_whole_numbers(bad):
    slider = Slider(25.0, 0.03, 0.3)
    chain = sp.chain(slider, sites=10)
    for call in (
        *(partial(call, bad) for call in WHOLE_SITES.values()),
        lambda: sp.series(chain, events=bad),
        lambda: sp.first_precursor(slider, sites=bad),
        lambda: sp.rupture(chain, chain.relaxed(4.0), max_breaks=bad),
    ):
        with pytest.raises(ValueError, match="must be a whole number"):
            call()


@pytest.mark.parametrize("bad", [None, 3.0, "x", sp.Steps(1.0)], ids=str)
def test_wrong_objects_are_named(bad):
    slider = Slider(25.0, 0.03, 0.3)
    chain = sp.chain(slider, sites=10)
    functions = sp.precursor_length, sp.precursor_lengths, sp.first_precursor, sp.exact_length, sp.exact_front, sp.exact_lengths
    calls = [lambda f=f: f(bad) for f in functions]
    calls += [lambda: sp.sensitivity(bad, sites=30), lambda: sp.chain(bad, sites=30)]
    calls += [lambda: sp.rupture(bad, chain.relaxed()), lambda: sp.nucleate(bad)]
    calls += [lambda: sp.equilibrium(bad, chain.relaxed()), lambda: sp.series(bad, events=2)]
    if bad is not None:
        calls += [lambda f=f: f(slider, bad) for f in functions]
        calls += [lambda: sp.rupture(chain, bad)]
    if bad != "x":  # the path of a table
        calls += [lambda: sp.fit(bad)]
    for call in calls:
        with pytest.raises(TypeError, match=r"(slider|interface|chain|body|state|measurements) (is|= )|path chain"):
            call()


# --- as JAX takes trees -------------------------------------------------------------------------------------------------


def axes(tree, *mapped):
    """The tree of axes of `jax.vmap` where only the `mapped` fields have one."""
    nothing = jax.tree.map(lambda _: None, tree)
    return eqx.tree_at(lambda x: [field(x) for field in mapped], nothing, [0] * len(mapped), is_leaf=lambda x: x is None)


@pytest.mark.slow
def test_trees_of_axes():
    """What `jax.vmap` needs where not every field has an axis; and any other leaves."""
    heights = jnp.array([10.0, 25.0, 50.0])
    sliders = Slider(heights, 0.03, 0.3)
    some = axes(sliders, lambda s: s.height)
    one = jax.vmap(precursor_length, in_axes=(some,))
    np.testing.assert_allclose(one(sliders), precursor_length(sliders), rtol=1e-14)
    slopes = jax.vmap(jax.grad(precursor_length), in_axes=(some,))(sliders)
    assert slopes.stiffness.shape == (3,)
    back = jax.vmap(lambda s: s, in_axes=(some,), out_axes=some)(sliders)
    assert (back.height.shape, back.stiffness.shape) == ((3,), ())
    records = jax.vmap(lambda s: sp.first_precursor(s, sites=64), in_axes=(some,))(sliders)
    np.testing.assert_allclose(records.length, precursor_length(sliders), rtol=1e-14)

    stressed = sp.Interface(jnp.array([0.0, 0.1]), 0.01)
    found = jax.vmap(precursor_length, in_axes=(None, axes(stressed, lambda x: x.prestress)))(Slider(25.0, 0.03, 0.3), stressed)
    np.testing.assert_allclose(found, precursor_length(Slider(25.0, 0.03, 0.3), stressed), rtol=1e-14)
    profiles = eqx.tree_at(
        lambda p: p.threshold, sp.Profile(np.ones(60)), jnp.array([1.0, 1.01])[:, None] ** jnp.arange(60)[None]
    )
    found = jax.vmap(precursor_length, in_axes=(None, axes(profiles, lambda x: x.threshold)))(Slider(25.0, 0.03, 0.3), profiles)
    each = [float(precursor_length(Slider(25.0, 0.03, 0.3), sp.Profile(one))) for one in profiles.threshold]
    np.testing.assert_allclose(found, each, rtol=1e-12)

    pushed = jax.vmap(lambda h: sp.Block(12.0 * h, 0.05, 0.3, sp.Push(0.4 * h)))(jnp.array([1.0, 1.1]))
    mixed = sp.Block(jnp.array(12.0), 0.05, 0.3)
    mixed = eqx.tree_at(lambda b: (b.height, b.push.height), mixed, (pushed.height, pushed.push.height))
    pushes = axes(mixed, lambda b: b.height, lambda b: b.push.height)
    lengths = jax.vmap(lambda b: precursor_length(b, sites=64), in_axes=(pushes,))(mixed)
    each = [float(precursor_length(sp.Block(float(h), 0.05, 0.3, sp.Push(float(p))), sites=64))
            for h, p in zip(pushed.height, pushed.push.height, strict=True)]  # fmt: skip
    np.testing.assert_allclose(lengths, each, rtol=1e-12)


@pytest.mark.parametrize(
    "made",
    [
        Slider([10.0, 25.0], 0.03, 0.3),
        sp.Interface([0.0, 0.1], 0.01),
        sp.Profile([1.0, 1.1], 0.1),
        sp.Block(10.0, 0.03, 0.3, sp.Push(0.4, 0.1), length=20, friction=0.3),
        sp.SmoothBreak(0.02),
    ],
    ids=lambda made: type(made).__name__,
)
def test_trees_of_other_leaves(made):
    """JAX and Equinox put any leaves into a tree, and take trees apart again; abstract values too."""
    leaf, leaves = object(), jax.tree.leaves(made)
    for put in (leaf, True, None, 0):
        other = jax.tree.map(lambda _, put=put: put, made)
        assert type(other) is type(made)
        assert jax.tree.leaves(other, is_leaf=lambda x: x is None)[: len(leaves)].count(put) == len(leaves)
    abstract = jax.eval_shape(lambda x: x, made)
    assert [x.shape for x in jax.tree.leaves(abstract)] == [np.shape(x) for x in leaves]
    assert jax.tree.structure(jax.jit(lambda x: x)(made)) == jax.tree.structure(made)
    dynamic, static = eqx.partition(made, eqx.is_array)
    assert jax.tree.leaves(eqx.combine(dynamic, static)) == leaves


@pytest.mark.parametrize(
    "make",
    [
        lambda: Slider(None, 0.03, 0.3),
        lambda: Slider(25.0, None, None),
        lambda: Slider(0, None, None),
        lambda: Slider(object(), object(), object()),
        lambda: sp.Block(10.0, 0.03, 0.3, 0),
        lambda: sp.Interface(None, 0.1),
        lambda: sp.Block(10.0, None, 0.3),
        lambda: Slider(25.0, object(), 0.3),
        lambda: Slider("25", None, None),
    ],
)
def test_a_number_may_not_be_missing(make):
    with pytest.raises(TypeError):
        make()


def test_a_batch_of_records_needs_its_size():
    """The message shows the call that works."""
    with pytest.raises(ValueError, match=r"sites=200\)\)\(sliders\)"):
        jax.vmap(sp.first_precursor)(Slider(jnp.array([10.0, 25.0]), jnp.full(2, 0.03), jnp.full(2, 0.3)))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sp.Parameter("stiffnes"), "arrest; did you mean stiffness?"),
        (lambda: sp.precursor_length(SLIDER, event="ful"), "did you mean full?"),
        (lambda: sp.sweep(height=[9.0], stiffness=1.0, poisson=0.0, outputs="lenght"), "; did you mean length?"),
    ],
)
def test_a_word_that_is_not_known_names_the_one_meant(call, message):
    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        call()


@pytest.mark.parametrize(
    "call",
    [
        lambda: sp.precursor_lengths(Slider(1e170, 0.03, 0.3)),
        lambda: sp.precursor_length(Slider([25.0, 1e30], 0.03, 0.3)),
        lambda: sp.precursor_length(Slider(2000.0, 0.03, 0.3)),
        lambda: sp.exact_lengths(Slider(1e5, 1e-300, 0.3)),
        lambda: sp.objective(sp.Measurements(25.0, 0.3, 24.0, 0.5)),
    ],
)
def test_a_warning_points_at_the_call_not_into_the_package(call):
    precursor._warn_once.cache_clear()
    with jax.enable_x64(False), pytest.warns(RuntimeWarning) as caught:
        call()
    assert caught[0].filename == __file__


HALF = [jnp.bfloat16, jnp.float16, jnp.float8_e4m3fn]


@pytest.mark.parametrize("dtype", HALF)
def test_half_precision_is_taken_as_single(dtype):
    """In every field of every body and interface, also as NumPy has it, traced, and in fields that were converted later."""
    two, parts = jnp.asarray(2, dtype), jnp.asarray([1, 0.5], dtype)
    every = sp.Slider(two, two, 0 * two), sp.Interface(parts[1], two), sp.Profile(parts, parts[1] / 4)
    every = *every, sp.Block(two, two, 0 * two, sp.Push(parts[1], parts[1]), normal_stiffness=two, friction=two)
    numbers = [x for x in jax.tree.leaves(every) if jnp.issubdtype(x.dtype, jnp.floating)]
    assert len(numbers) == 14
    assert {str(x.dtype) for x in numbers} == {"float32"}
    assert jax.jit(lambda x: Slider(x, x, 0 * x).height)(two).dtype == jnp.float32
    assert Slider(np.asarray(two), 1, 0).height == np.float64(2)
    later = jax.tree.map(lambda x: jnp.asarray(x, dtype), sp.Slider(2.0, 2.0, 0.0))
    in_half = sp.chain(later, sites=4, threshold=two, prestress=parts[1], contact=two)
    assert {str(x.dtype) for x in (*of_one_type(later, two), *jax.tree.leaves(in_half))} == {"float32"}


@pytest.mark.ci
@pytest.mark.parametrize("length", [sp.exact_length, sp.precursor_length, lambda *body: sp.first_precursor(*body).length])
def test_lengths_of_half_precision_are_those_of_single(length):
    def body(dtype, convert=jnp.asarray):
        return sp.Slider(*(convert(x, dtype) for x in (25.0, 0.03125, 0.3125))), sp.Interface(
            *(convert(x, dtype) for x in (0.125, 0.0))
        )

    single = float(length(*body(jnp.float32)))
    assert np.isfinite(single)
    for dtype in HALF[:2]:
        found = length(*body(dtype))
        assert (float(found), found.dtype) == (single, jnp.float32)
    in_half = jax.tree.map(lambda x: x.astype(jnp.bfloat16), body(jnp.float32))
    assert float(length(*in_half)) == single
