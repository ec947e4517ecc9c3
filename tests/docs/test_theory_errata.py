"""The page of errata states what the code computes."""

from pathlib import Path

import errata
import pytest

pytestmark = pytest.mark.ci

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_errata_page_is_up_to_date():
    assert errata.page() == (DOCS / "appendix" / "errata.md").read_text(encoding="utf-8")
