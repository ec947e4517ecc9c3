"""Every claim is measured, and the verdicts are those that the physics notes say should come out."""

import pytest

from slippulse_jax.claims import CLAIMS, FAILS, HOLDS, examine, page

QUICK = ["C1", "C2", "C3", "C4", "C5", "C6", "C7", "C16", "C17", "C18"]


def test_there_are_eighteen():
    assert list(CLAIMS) == [f"C{n}" for n in range(1, 19)]


def test_quick_claims():
    results = {r.number: r for r in examine(QUICK)}
    assert list(results) == QUICK
    for number in ("C1", "C3", "C4", "C6", "C16", "C18"):
        assert results[number].verdict == HOLDS, results[number]
    assert "26 contacts" in results["C1"].measured
    text = page(list(results.values()))
    assert text.count("\n| C") == len(QUICK)


def test_series_claim_reports_its_failure():
    (result,) = examine(["C13"])
    assert result.verdict == FAILS
    assert "U = 3.90" in result.measured


def test_unknown_claim():
    with pytest.raises(ValueError, match="no claim 'C19'"):
        list(examine(["C19"]))


@pytest.mark.slow
def test_all_claims():
    assert len(list(examine())) == 18
