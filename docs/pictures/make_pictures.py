"""Draw the pictures of README.md with the package itself. Run: python docs/pictures/make_pictures.py."""

import io
from pathlib import Path

import slippulse_jax as sp
from slippulse_jax.files import write_atomically

HERE = Path(__file__).resolve().parent


def main() -> None:
    """Draw every picture again."""
    result = sp.fit(sp.read_measurements(HERE.parents[1] / "fit_examples/pmma_block/lengths.csv"))
    content = io.BytesIO()
    result.plot().savefig(content, format="png", dpi=110)
    write_atomically(HERE / "fit.png", content.getvalue())


if __name__ == "__main__":
    main()
