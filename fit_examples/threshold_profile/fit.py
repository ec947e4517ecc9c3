"""What twelve lengths say of a threshold that varies along the interface."""

import runpy
from pathlib import Path

import numpy as np

import slippulse_jax as sp
from slippulse_jax.inference.recover import RecoveredProfile

HERE = Path(__file__).resolve().parent


def main() -> RecoveredProfile:
    """Recover the profile, and compare it with the true one where it is determined."""
    truth = runpy.run_path(str(HERE / "make_data.py"))["threshold"]
    data = sp.read_measurements(HERE / "lengths.csv")
    found = sp.recover_profile(data, stiffness=0.03)
    print(found.report())
    low, high = found.interval(0.95)
    inside = (low < truth(found.position)) & (truth(found.position) < high)
    places, right = found.determined.sum(), inside[found.determined].sum()
    print(f"{places} places determined; the true profile in the 95 % band at {right}")
    assert found.determined.sum() >= 8
    assert inside[found.determined].mean() >= 0.85
    assert np.ptp(found.profile[found.determined]) > 0.1
    return found


if __name__ == "__main__":
    main()
