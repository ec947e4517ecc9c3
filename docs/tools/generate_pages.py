"""Write the pages whose content is read from the code: docs/evidence/errata.md and docs/reference/equations.md.

python docs/tools/generate_pages.py            writes them
python docs/tools/generate_pages.py --check    fails if one is out of date
"""

import sys
from pathlib import Path

import equations
import errata

DOCS = Path(__file__).resolve().parents[1]


def main() -> None:
    """Write, or compare, each page."""
    if missing := equations.missing():
        sys.exit("\n".join(missing))
    for name, text in (("reference/equations", equations.page()), ("evidence/errata", errata.page())):
        page = DOCS / f"{name}.md"
        if sys.argv[1:] != ["--check"]:
            page.write_text(text, encoding="utf-8")
        elif page.read_text(encoding="utf-8") != text:
            sys.exit(f"{page} is out of date: run python docs/tools/generate_pages.py")


if __name__ == "__main__":
    main()
