"""The page about a measured interface: its numbers again, from its table and by other programs."""

import re
from pathlib import Path

import documented
import make_measured_interface as tool
import numpy as np
import pytest
from scipy import stats
from scipy.special import gamma

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "appendix" / "measured_interface.md"
TABLE = ROOT / "docs" / "tables" / "measured_interface.md"


def measured():
    lines = (ROOT / "docs" / "tables" / "measured_interface.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("# Derived figures of 19 runs")
    assert lines[1].split(",")[2:] == ["peak_force_N", "sliding_force_N", "half_slope_force_N"]
    return np.array([line.split(",") for line in lines[2:]], float)


def prose():
    return " ".join(PAGE.read_text(encoding="utf-8").split())


def rows():
    """Share kept, thresholds, width and ratio of every row of the table."""
    found = re.findall(r"^\| ([\d.]+) \| (.+) \| ([\d.]+) \| ([\d.]+) \|$", TABLE.read_text(encoding="utf-8"), flags=re.M)
    return [(float(kept), kind, float(width), float(ratio)) for kept, kind, width, ratio in found]


def weibull(width):
    return stats.weibull_min(1 / width, scale=1 / gamma(1 + width))


def by_quadrature(width, reach=6.0, points=1201):
    """The master equation by the trapezoidal rule, and what its curve tends to by the moments of the law."""
    x = np.linspace(0, reach, points)
    law = weibull(width)
    density, alone = law.pdf(x), x * law.sf(x)
    force = np.zeros(points)
    for n in range(1, points):  # neither end counts: the density vanishes at 0, and so does F
        force[n] = alone[n] + (x[1] - x[0]) * density[1:n] @ force[n - 1 : 0 : -1]
    return x, force, law.moment(2) / (2 * law.mean())


def of_asperities(kept, width, reach=4.0, points=401, many=100_000):
    """One asperity for every quantile, each with a sawtooth of its own."""
    x, threshold = np.linspace(0, reach, points), weibull(width).ppf((np.arange(many) + 0.5) / many)

    def mean(pulled):
        again = kept * threshold + (pulled - threshold) % ((1 - kept) * threshold)
        return np.where(pulled < threshold, pulled, again).mean()

    return x, np.array([mean(one) for one in x]), threshold.mean() * (1 + kept) / 2


def ratios(x, force, sliding):
    """Half slope and sliding force over the peak."""
    slope, between = np.gradient(force, x), np.argmax(np.gradient(force, x) < 0.5)
    half = np.interp(0.5, slope[[between, between - 1]], force[[between, between - 1]])
    peak = max(force.max(), sliding)
    return half / peak, sliding / peak


def test_what_was_measured():
    load, _, peak, sliding, half = measured().T
    assert len(peak) == 19
    for value, with_load in ((sliding / peak, "−0.51"), (half / peak, "−0.81")):
        said = f"{value.min():.3f} to {value.max():.3f} of the peak, median {np.median(value):.3f}"
        assert said in prose(), said
        assert f"{stats.spearmanr(load, value).statistic:.2f}".replace("-", "−") == with_load
        assert with_load in prose()
    assert f"rank correlation of the ratios {stats.spearmanr(sliding / peak, half / peak).statistic:.2f}" in prose()
    assert f"1 mN, {0.1 / peak.max():.1f} to {0.1 / peak.min():.1f} % of the peaks" in prose()
    assert f"at {1 - (1 - 3 / 4) ** 1.5:.3f} of the peak" in prose(), "slope √(1 − x), force 1 − (1 − x)^{3/2}"


@pytest.mark.ci
def test_the_table_is_that_of_its_program():
    half = np.median(measured()[:, 4] / measured()[:, 2])
    assert tool.laws_table(float(half)) == TABLE.read_text(encoding="utf-8")


@pytest.mark.ci
@pytest.mark.parametrize("row", range(6))
def test_laws_of_the_table(row):
    """Each has the measured half slope, and the sliding force written beside it."""
    *_, peak, _, half = measured().T
    assert len(rows()) == 6
    kept, kind, width, ratio = rows()[row]
    law = by_quadrature(width) if kind == "new at each break" else of_asperities(kept, width)
    at_half, at_last = ratios(*law)
    assert abs(at_half - np.median(half / peak)) < 0.005, "the width has two digits"
    assert abs(at_last - ratio) < 0.002


@pytest.mark.ci
def test_widths_of_the_text():
    _, _, peak, sliding, half = measured().T
    widths = np.linspace(0.5, 0.92, 22)
    at_half, at_last = np.transpose([ratios(*by_quadrature(width)) for width in widths])
    by_half = np.interp([np.median(half / peak), (half / peak).max(), (half / peak).min()], at_half[::-1], widths[::-1])
    assert "gives the width 0.60 (standard deviation 0.61 of the mean), and the sliding force alone 0.58" in prose()
    assert "widths of 0.53 to 0.90" in prose()
    assert abs(by_half - [0.60, 0.53, 0.90]).max() < 0.006
    assert abs(weibull(by_half[0]).std() - 0.61) < 0.006
    narrow = widths < 0.7  # where it rises with the width
    assert abs(np.interp(np.median(sliding / peak), at_last[narrow], widths[narrow]) - 0.58) < 0.006


@pytest.mark.ci
def test_two_laws_coincide_and_narrow_ones_fall():
    x, renewed, _ = by_quadrature(rows()[0][2])
    at, keeping, limit = of_asperities(0.99, rows()[-1][2])
    x, renewed = x / renewed.max(), renewed / renewed.max()
    apart = abs(np.interp(at / limit, x, renewed) - keeping / limit)[at / limit < 4].max()
    assert abs(apart - 0.007) < 0.0025, "the widths have two digits"
    assert "differ by at most 0.7 % of the peak" in prose()
    fallen = []
    for width in (0.05, 0.1, 0.2, 0.4, 0.6):
        _, force, _ = by_quadrature(width, points=2401)
        fallen.append(force[force.argmax() :].min() / force.max())
    assert ", ".join(f"{one:.2f}" for one in fallen[:-1]) + f" and {fallen[-1]:.2f} of it" in prose()


def test_a_soft_machine_hides_the_drop():
    """A contact k, pulled by a machine k_M that stays where it is, breaks at θ = 1 and repins with r."""
    assert r"$r = 1 - (1 + k/k_M)\,\Delta F/F$" in prose()
    k, machine, kept = 1.7, 4.2, 0.35
    stretched = 1 / k
    moved = np.linalg.solve([[1, machine], [1, -k]], [1 + machine * stretched, kept - k * stretched])  # F and place after
    assert abs(1 - (1 + k / machine) * (1 - moved[0]) - kept) < 1e-12


@pytest.mark.slow
def test_output_and_claim_of_the_page(capsys):
    """What its program prints is what it shows."""
    ((_, program),), ((_, shown),) = (
        documented.blocks(PAGE, "python"),
        re.findall(r"^```(text)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), flags=re.M | re.S),
    )
    documented.run_python(program, PAGE, {"__name__": "__main__"})
    assert capsys.readouterr().out == shown
    claim = re.search(r"^\| C12 .*$", (PAGE.parent / "claims.md").read_text(encoding="utf-8"), flags=re.M)
    assert claim
    assert claim[0].rpartition("beyond")[2].split("|")[0].split()[-1] == "0.198", "of the whole chain, Weibull"
    assert abs(0.198 / rows()[0][2] - 1 / 3) < 0.01
