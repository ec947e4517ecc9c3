"""Write the pages and tables whose content is read from the code: errata, equations, columns of a table.

python docs/tools/generate_pages.py            writes them
python docs/tools/generate_pages.py --check    fails if one is out of date
"""

import sys
from pathlib import Path

import equations
import errata

from slippulse_jax.inference.table.columns import COLUMNS, OF_GAUGES

DOCS = Path(__file__).resolve().parents[1]


def table(columns: dict, heads: tuple[str, ...]) -> str:
    """Names of the columns, in SI and in λc, and what each holds."""
    lines = [heads, ["---"] * len(heads)]
    for one in columns.values():
        names = [f"`{one.name(form)}`" if one.names(form) else "" for form in (True, False)]
        lines.append([*names[: len(heads) - 1], one.sentence])
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


TABLES = {
    "tables/columns": table(COLUMNS, ("SI", "lengths in λc", "what")),
    "tables/gauges": table(OF_GAUGES, ("column", "what")),
}


def main() -> None:
    """Write, or compare, each page."""
    if missing := equations.missing():
        sys.exit("\n".join(missing))
    pages = {"reference/equations": equations.page(), "appendix/errata": errata.page(), **TABLES}
    for name, text in pages.items():
        page = DOCS / f"{name}.md"
        if sys.argv[1:] != ["--check"]:
            page.write_text(text, encoding="utf-8")
        elif page.read_text(encoding="utf-8") != text:
            sys.exit(f"{page} is out of date: run python docs/tools/generate_pages.py")


if __name__ == "__main__":
    main()
