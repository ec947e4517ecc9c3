"""Your own table: copy this folder, replace lengths.csv, run fit.py."""

import sys
from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.inference.fit import FitResult

TABLE = Path(__file__).with_name("lengths.csv")


def main(table: str | Path = TABLE, figure: str | Path | None = None) -> FitResult:
    """Read, fit, report; draw into `figure` if one is named."""
    result = sp.fit(sp.read_measurements(table))
    print(result.report())
    if figure is not None:
        sp.plot.save(sp.plot.fit(result), figure)
    assert result.converged
    return result


if __name__ == "__main__":
    main(*sys.argv[1:])
