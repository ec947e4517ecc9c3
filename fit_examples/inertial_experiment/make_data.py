"""Write lengths.csv: what the chain does with mass and little damping, at seven heights; k/K = 0.01. Takes a minute."""

import sys
from pathlib import Path

import jax

import slippulse_jax as sp

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))
from independent_lattice import write  # noqa: E402

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    rows = []
    for height in (10, 14, 18, 22, 26, 30, 34):
        chain = sp.chain(sp.Slider(height, 0.01, 0.3), sites=300)
        extent = int(sp.simulate_inertial(chain, duration=600.0, damping=0.05).extent)
        rows.append((height, 0.3, extent - 0.5, 0.3, "synthetic"))
    header = ("height", "poisson", "length", "length_sigma", "provenance")
    write(
        HERE / "lengths.csv",
        header,
        rows,
        "synthetic: make_data.py, the inertial chain, damping 0.05, k/K = 0.01; counts less a half",
    )
