"""The table of claims, for the command line and the documentation."""

from collections.abc import Iterator
from typing import NamedTuple

import jax

from slippulse_jax.paper.claims import discussion, front
from slippulse_jax.paper.claims.claim import FAILS, HOLDS, WITHIN, Claim, Verdict

CLAIMS: dict[str, Claim] = {
    one.number: one
    for one in (
        front.count, front.displacements, front.stress, front.height, front.stiffness, front.threshold, front.formulas,
        discussion.prestress, discussion.threshold_slope, discussion.repinning_delay, discussion.inertia,
        discussion.distribution, discussion.without_ageing, discussion.with_ageing, discussion.simulation,
        front.no_upper_layer, front.long_length, front.stiffness_ratio,
    )
}  # fmt: skip


class Result(NamedTuple):
    """One row of the table of claims."""

    number: str
    says: str
    criteria: str
    measured: str
    verdict: Verdict


def examine(numbers: list[str] | None = None) -> Iterator[Result]:
    """Measure the claims one by one, in double precision; all by default.

    Raises
    ------
    ValueError
        If a number is not that of a claim.
    """
    for number in numbers or []:
        if number not in CLAIMS:
            raise ValueError(f"no claim {number!r}: must be one of {', '.join(CLAIMS)}")
    for one in CLAIMS.values():
        if numbers is None or one.number in numbers:
            with jax.enable_x64(True):
                measured, verdict = one.measure()
            criteria = one.holds + (f"; within limits: {one.limits}" if one.limits else "")
            yield Result(one.number, one.says, criteria, measured, verdict)


def page(results: list[Result]) -> str:
    """Write the table of claims as a page of the documentation."""
    count = {verdict: sum(r.verdict == verdict for r in results) for verdict in (HOLDS, WITHIN, FAILS)}
    head = (
        "# The paper's claims, measured\n\n"
        "Written by `slippulse claims --write docs/evidence/claims.md`; every number is measured when the page is written, and every verdict "
        "follows from the numbers by the criterion stated beside it. Where the paper gives no number (*almost*, *roughly*), the "
        "criterion is this project's. Unless stated otherwise: $H/\\lambda_c = 25$, $k/K = 0.03$, $\\nu = 0.3$.\n\n"
        f"{count[HOLDS]} hold, {count[WITHIN]} hold within limits, {count[FAILS]} does not hold as worded.\n\n"
        "| | the paper says | it holds if | measured | verdict |\n|---|---|---|---|---|\n"
    )
    return head + "\n".join(row(result) for result in results) + "\n"


def row(result: Result) -> str:
    """Format one line of the page."""
    return f"| {' | '.join(result)} |"
