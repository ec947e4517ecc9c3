"""A sample of every campaign of `attack`; the whole of them by ``python tests/attack.py``."""

import attack
import pytest

pytestmark = pytest.mark.ci

SAMPLE = {
    "lengths": 2000, "beside run-away": 600, "single precision": 200, "blocks": 5, "tables": 150, "gauges": 150, "requests": 300, "stores": 6, "command lines": 15,
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name == "blocks" else ()) for name in attack.CAMPAIGNS]
)
def test_nothing_falls(name):
    found = attack.run(name, SAMPLE[name], seed=21)
    assert not found.fell
    assert found.attempts == SAMPLE[name]
    assert found.refused < found.attempts
