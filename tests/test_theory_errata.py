"""The page of errata says what the code computes today."""

import importlib.util
from pathlib import Path

DOCS = Path(__file__).parent.parent / "docs"


def test_errata_page_is_up_to_date():
    spec = importlib.util.spec_from_file_location("generate_errata", DOCS / "generate_errata.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert module.page() == (DOCS / "errata.md").read_text(encoding="utf-8")
