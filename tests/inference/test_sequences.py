"""Fits of whole sequences: tables, series, response surfaces, verdicts, and what the truth is."""

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from blocks.test_pressure import pressed

import slippulse_jax as sp
from slippulse_jax.inference.model.fronts import BlockSequence
from slippulse_jax.inference.model.sequence import CONTACTS, GEOMETRY, Cloud, Surface, followed
from slippulse_jax.inference.result.verdict import Identifiability
from slippulse_jax.inference.table.columns import MeasurementError

HEIGHT, LENGTHS, AT, WIDE = 36, 3.0, 0.15, 0.1
UNIT = 3e9 / (2 * 1.3 * 0.03)
"""Areal stiffness, in Pa/m, of b = 1 at H = 30 mm, E = 3 GPa and ν = 0.3."""


def table_of(b, friction, *, seed=0, ageing=None, threshold=None, numbered=False, places=10):
    """A table as a laboratory writes it, from a series on contacts of another size than the fit's; 1 % of noise."""
    block, random = pressed(HEIGHT, b, sp.Push(AT, WIDE), friction, LENGTHS), np.random.default_rng(seed)
    n, contact = block.sites, 30 / HEIGHT
    interface = None if threshold is None else sp.Profile(threshold=random.normal(1, threshold, n), prestress=np.zeros(n))
    found = sp.series(block, events=600, ageing=ageing, interface=interface)
    ends = np.minimum(np.asarray(found.length)[: int(found.number)], n)
    if numbered:
        far = np.maximum.accumulate(ends)
        seen = np.flatnonzero(np.diff(far, prepend=0) > 1.5)
        place, force = far[seen], np.asarray(found.force_before)[seen] / float(block.stiffness) / n
    else:
        place = np.append(np.linspace(0.1, 0.95, places) * n, n)
        force = np.asarray(found.force_at(place)) * float(found.strength) / float(block.stiffness) / n
    force, spans = 1000 * friction * force, place >= n
    sigma = np.where(spans, np.nan, (0.03 if numbered else 0.005) * place * contact)
    place = np.where(spans, place, np.minimum(place + np.nan_to_num(sigma) * random.standard_normal(place.size) / contact, n))
    columns = {"event": range(1, 1 + place.size)} if numbered else {}
    return pd.DataFrame(
        columns
        | {
            "height_mm": 30, "block_length_mm": n * contact, "block_width_mm": 10, "correlation_length_um": 1e3 * contact,
            "poisson": 0.3, "young_GPa": 3, "push_height_mm": 30 * AT, "push_width_mm": 30 * WIDE, "normal_load_N": 1000,
            "force_N": force * (1 + 0.01 * random.standard_normal(place.size)), "force_sigma_N": 0.01 * force,
            "length_mm": place * contact, "length_sigma_mm": sigma, "spans": np.where(spans, "yes", "no"),
        }
    )  # fmt: skip


BOTH = ["stiffness", "friction"]


@pytest.fixture(scope="module")
def places():
    return sp.fit(table_of(0.8, 0.35), BOTH)


# --- tables ---------------------------------------------------------------------------------------------------------------


def test_a_table_of_a_sequence(tmp_path):
    table = table_of(0.8, 0.35, numbered=True)
    table.loc[table.spans == "yes", "length_mm"] = np.nan  # is that of the block
    path = tmp_path / "sequence.csv"
    table.to_csv(path, index=False)
    m = sp.read_measurements(path)
    assert m.is_sequence
    assert m.kind[-1] == "at_least"
    assert m.length[-1] == m.block_length[-1]
    np.testing.assert_allclose(m.force * m.unit_of_force[0], table.force_N)
    np.testing.assert_allclose(m.normal_load, 1000 / 0.01)
    assert m.unit_of_force[1] == "N"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"force_N": None}, "force_sigma_N is given without force_N"),
        ({"block_width_mm": None}, "needs the column block_width_mm"),
        ({"force_sigma_N": None}, "force_N is given without force_sigma_N"),
        ({"spans": "perhaps"}, "row 0, column spans: .*one of no, yes"),
        ({"event": 0}, "row 0, column event: .*events are numbered from 1"),
        ({"normal_load_N": -1}, "row 0, column normal_load_N: -1"),
    ],
)
def test_a_bad_table_is_named(changed, message):
    table = table_of(0.8, 0.35, numbered=True)
    for name, value in changed.items():
        table = table.drop(columns=name) if value is None else table.assign(**{name: value})
    with pytest.raises(MeasurementError, match=message):
        sp.Measurements.from_dataframe(table)


@pytest.mark.parametrize(
    ("dropped", "options", "message"),
    [
        ("block_length_mm", {}, "give block_length"),
        ("normal_load_N", {}, "parameter normal_load: neither stated"),
        (None, {"free": "stiffness"}, "parameter friction: neither stated"),
        (None, {"free": [*BOTH, "time_constant"]}, "parameter time_constant: contacts that age need newborn too"),
        (None, {"free": [*BOTH, "machine_stiffness"]}, "parameter machine_stiffness: the measurements state none"),
        (None, {"free": [*BOTH, "threshold_slope"]}, "threshold_slope"),
        (None, {"event": "full", "free": "stiffness"}, "force_N beside push_height_mm"),
        (None, {"fixed": {"model_factor": 1.0}}, "parameter model_factor: of lengths"),
    ],
)
def test_a_request_without_meaning_is_refused(dropped, options, message):
    table = table_of(0.8, 0.35)
    if dropped is not None:
        table = table[:-1].drop(columns=[dropped, "spans"])
    with pytest.raises((ValueError, TypeError), match=message):
        sp.fit(table, **{"free": BOTH} | options)


@pytest.mark.parametrize(("row", "kind", "length"), [(10, "at_least", 60.0), (3, "at_least", None), (0, "whole", 9.1666666667)])
def test_a_length_that_is_no_place_is_refused(row, kind, length):
    """A front that only left the field of view, or a count; an event that spans may have a length read near the end."""
    table = table_of(0.8, 0.35)
    kinds = ["length"] * 10 + ["at_least"]
    lengths = table.length_mm.to_numpy().copy()
    kinds[row], lengths[row] = kind, lengths[row] if length is None else length
    wrong = table.drop(columns="spans").assign(kind=kinds, length_mm=lengths, length_sigma_mm=table.length_sigma_mm.fillna(0))
    with pytest.raises(ValueError, match=rf"row {row}: .* mm, {kind}: a sequence has places"):
        sp.fit(wrong, BOTH)
    near = sp.Measurements.from_dataframe(table.assign(length_mm=np.where(table.spans == "yes", 89.5, table.length_mm)))
    BlockSequence(near).check(near, {"friction"})


def test_rough_contacts_are_refused():
    rough = table_of(0.8, 0.35).assign(friction=0.35, contact_law="multicontact")
    with pytest.raises(ValueError, match="contact_law = 'multicontact'"):
        sp.fit(rough, BOTH)


def test_ageing_is_refused_where_no_data_tell():
    table = table_of(0.8, 0.35)
    near = table[table.length_mm < 0.44 * table.block_length_mm]
    with pytest.raises(ValueError, match=r"parameter newborn: the farthest place is 0.3\d* L"):
        sp.fit(near, [*BOTH, "newborn", "time_constant"])
    with pytest.raises(ValueError, match="parameter newborn: of sequences"):
        sp.fit(sp.Measurements([20.0, 35.0], 0.3, [12.7, 24.6], 0.3), ["stiffness", "newborn"])


# --- series and surfaces ----------------------------------------------------------------------------------------------------


@pytest.mark.ci
@pytest.mark.parametrize("ageing", [None, sp.Ageing(0.6, 1.0)])
def test_series_followed_are_those_of_the_package(ageing):
    """The same block by `series`: farthest places, forces by place, first length and its force."""
    block = pressed(24, 0.7, sp.Push(AT, WIDE), 0.3, LENGTHS)
    found = sp.series(block, events=512, ageing=ageing)
    numbers = dict(zip((*GEOMETRY, *CONTACTS), (0.3, np.log(3), np.log(AT), np.log(WIDE), np.log(1.2)), strict=False))
    numbers |= {"log_b": np.log(0.7), "friction": 0.3, "prestress": 0.0, "log_machine": np.inf, "newborn": 1.0, "log_time": 0.0}
    if ageing is not None:
        numbers["newborn"] = 0.6
    own = np.array([[*numbers.values()]])
    got = followed(own[:, : len(GEOMETRY)], own[:, len(GEOMETRY) :], 24.0)
    n = int(found.number)
    far = np.maximum.accumulate(np.asarray(found.length)[:n]) / block.sites
    np.testing.assert_allclose(got.reached[0, :n], far, rtol=1e-7)
    np.testing.assert_allclose(got.force[0, :n], np.asarray(found.force_before)[:n] / float(found.strength), rtol=1e-7)
    place = np.array([0.203, 0.507, 0.806, 1 - 1e-9])
    np.testing.assert_allclose(got.force_at(place, 0 * place)[0, 0], found.force_at(place * block.sites), rtol=1e-7)
    mean, spread = got.force_at(place, np.full(4, 0.02))[:, 0]
    assert (spread >= 0).all()
    assert (mean >= got.force[0, :n].min()).all()
    length, force = got.first(1.5 / block.sites)
    jump = int(np.argmax(np.diff(far, prepend=0) > 1.5 / block.sites))
    assert (float(length[0]), float(force[0])) == pytest.approx((far[jump], got.force[0, jump]))


def test_a_surface_is_a_polynomial_with_its_scatter():
    random, numbers = np.random.default_rng(3), np.tile(np.linspace(0.1, 0.2, 11), (200, 1))
    b, friction = random.uniform(-0.2, 0.2, 200), random.uniform(0.25, 0.35, 200)
    at = len(GEOMETRY) + CONTACTS.index("log_b"), len(GEOMETRY) + CONTACTS.index("friction")
    numbers[:, at[0]], numbers[:, at[1]] = b, friction
    exact = 1 + b - 2 * np.log(friction) + 3 * b * np.log(friction) ** 2
    cloud = Cloud()
    cloud.add(numbers, np.column_stack([exact, exact + 0.01 * random.standard_normal(200)]))
    surface = Surface(cloud, np.ones(200))
    value, apart = surface(numbers)
    np.testing.assert_allclose(value[:, 0], exact, atol=1e-6)
    assert np.abs(value[:, 1] - exact).max() < 0.01
    assert surface.scatter[1] == pytest.approx(0.01, rel=0.2)
    assert apart.max() == pytest.approx(1)


# --- fits -------------------------------------------------------------------------------------------------------------------


@pytest.mark.ci
def test_a_sequence_gives_stiffness_and_friction(places):
    truth = {"areal_stiffness": 0.8 * UNIT, "friction": 0.35}
    assert places.identifiability in (Identifiability.IDENTIFIED, Identifiability.SKEWED)
    for name, (off, error) in {"areal_stiffness": (0.08, 0.08), "friction": (0.02, 0.02)}.items():
        assert places.values[name] == pytest.approx(truth[name], rel=off)
        (piece,) = places.intervals[name][0.95]
        assert piece.low < truth[name] < piece.high
        assert piece.high - piece.low < 4 * error * truth[name]
    text = places.report()
    assert "forces" in text
    assert "lengths alone" not in text
    assert "spans" in text
    assert "normal load" not in places.methods()


@pytest.mark.ci
def test_what_a_fit_of_a_sequence_can_do(places, tmp_path):
    """Saved and read, resampled, and moved by its inputs."""
    path = tmp_path / "fit.json"
    places.save(path)
    again = sp.load_fit(path)
    assert again.values == places.values
    assert again.report() == places.report()
    np.testing.assert_allclose(again.problem(places.theta[None]).value, places.problem(places.theta[None]).value, rtol=1e-9)
    drawn = places.bootstrap(60, seed=1)
    spread = np.std(np.log(drawn.values[:, 0]))
    error = float(np.sqrt(places.covariance[0, 0]))
    assert 0.5 * error < spread < 2 * error
    moves = {change.name: change for change in places.changes}
    assert moves["young"].moves["areal_stiffness"][0] == pytest.approx(np.log(1.05), abs=0.02)
    assert abs(moves["push_height"].moves["areal_stiffness"][0]) > 0.01


@pytest.mark.ci
def test_objective_of_a_sequence():
    table = table_of(0.8, 0.35)
    with jax.enable_x64(True):
        f = sp.objective(table, BOTH)
        start = f.start()
        best = jax.jit(f)(start)
        assert np.isfinite(best)
        slope = jax.grad(f)(start)
        for name in f.names:
            step = 1e-3
            up, down = ({**start, name: start[name] + side * step} for side in (1, -1))
            assert float(slope[name]) == pytest.approx(float(f(up) - f(down)) / 2 / step, rel=0.05, abs=0.5)
        many = jax.vmap(lambda x: f({**start, "friction": x}))(start["friction"] + jnp.array([0.0, 0.002]))
        assert float(many[0]) == pytest.approx(float(best))


@pytest.mark.ci
def test_numbered_events_and_an_unknown_load():
    numbered = sp.fit(
        table_of(1.2, 0.3, numbered=True, ageing=sp.Ageing(0.6, 1.0)), BOTH, fixed={"newborn": 0.6, "time_constant": 1.0}
    )
    (piece, *more) = numbered.intervals["friction"][0.95]
    assert piece.low < 0.3 < [piece, *more][-1].high
    assert any(one.low < 1.2 * UNIT < one.high for one in numbered.intervals["areal_stiffness"][0.95])
    assert "first length" in numbered.report()
    loose = sp.fit(table_of(0.8, 0.35).drop(columns="normal_load_N"), [*BOTH, "normal_load"])
    assert loose.intervals["normal_load"][0.95][0].low < 1e5 < loose.intervals["normal_load"][0.95][-1].high
    assert any(one.low < 0.8 * UNIT < one.high for one in loose.intervals["areal_stiffness"][0.95])


@pytest.mark.ci
def test_data_of_another_kind_are_rejected():
    """A front whose force is proportional to its length, from far below that of the first contact."""
    table = table_of(0.8, 0.35)
    share = table.length_mm / table.block_length_mm
    found = sp.fit(table.assign(force_N=350 * (0.02 + 0.6 * share)), BOTH)
    assert found.identifiability is Identifiability.POOR_FIT
    assert found.intervals["friction"][0.95] == []


@pytest.mark.slow
@pytest.mark.parametrize("numbered", [False, True])
def test_coverage(numbered):
    """Of 40 sequences: intervals hold the truth, and no number is given that is off by more than three errors."""
    random, held, off = np.random.default_rng(8), [], []
    for seed in range(40):
        truth = {
            "areal_stiffness": np.exp(random.uniform(np.log(0.4), np.log(2.5))) * UNIT,
            "friction": random.uniform(0.2, 0.5),
        }
        table = table_of(truth["areal_stiffness"] / UNIT, truth["friction"], seed=seed, numbered=numbered)
        if len(table) < 4 or table.force_N.isna().any():
            continue
        found = sp.fit(table, BOTH)
        for name, value in truth.items():
            held.append([any(x.low <= value <= x.high for x in found.intervals[name][level]) for level in (0.6827, 0.95)])
            if found.stderrs[name] is not None:
                off.append(abs(found.values[name] - value) / found.stderrs[name])
    share = np.mean(held, axis=0)
    assert share[0] > 0.6
    assert share[1] > 0.88
    assert np.mean(np.array(off) > 3) <= 0.03


@pytest.mark.slow
def test_scattered_thresholds_are_rejected_or_wide():
    rejected = 0
    for seed in range(10):
        table = table_of(0.8, 0.35, seed=seed, threshold=0.05)
        if table.force_N.isna().any():
            continue
        found = sp.fit(table, BOTH)
        rejected += found.identifiability is Identifiability.POOR_FIT
        for name, value in {"areal_stiffness": 0.8 * UNIT, "friction": 0.35}.items():
            error = found.stderrs[name]
            assert error is None or abs(found.values[name] - value) < 4 * error
    assert rejected >= 5


def test_the_front_is_chosen_by_the_table():
    m = sp.Measurements.from_dataframe(table_of(0.8, 0.35))
    front = BlockSequence(m)
    assert front.event == "sequence"
    assert not front.numbered


@pytest.mark.ci
def test_two_sequences_in_one_table():
    """Of two blocks of one interface: a value that both share, or one for each; a block that changes within one is refused."""
    first, second = table_of(0.8, 0.35, seed=1), table_of(0.8, 0.35, seed=2)
    both = pd.concat([first.assign(sequence="a", specimen="A"), second.assign(sequence="b", specimen="B")], ignore_index=True)
    shared = sp.fit(both, BOTH)
    (piece,) = shared.intervals["friction"][0.95]
    assert piece.low < 0.35 < piece.high
    assert piece.high - piece.low < 0.02
    assert "sequence" in shared.report()
    each = sp.fit(both, [sp.Parameter("stiffness", each="specimen"), "friction"])
    assert len(each.names) == 3
    with pytest.raises(ValueError, match=r"row 11, column height_mm: another one than in the first row of its sequence"):
        sp.fit(pd.concat([first, second.assign(height_mm=31)], ignore_index=True), BOTH)
