"""How much there is to read, how far away it lies, and whether it fits its column."""

import os
import re
from pathlib import Path

import documented
import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
READ = ("learn", "fit", "howto", "model")
"""Folders of pages that are neither appendix nor reference."""


def text_of(path):
    """A page with the tables that it includes."""
    text = path.read_text(encoding="utf-8")
    return re.sub(r"^```\{include\} (\S+)\n```$", lambda found: text_of(path.parent / found[1]), text, flags=re.M)


def words(*paths):
    """Whatever stands between blanks, of programs and tables too."""
    return sum(len(text_of(path).split()) for path in paths)


PAGES = [DOCS / "index.md", *(page for folder in READ for page in sorted((DOCS / folder).glob("*.md")))]
WORKED = sorted((ROOT / "fit_examples").glob("*/README.md"))


def test_words_of_the_readme():
    assert 200 < words(ROOT / "README.md") < 450


def test_words_of_the_pages():
    """Worked fits, of which the site has a page each, included."""
    assert 10_000 < words(*PAGES, *WORKED) <= 20_000
    assert max(words(page) for page in PAGES) <= 1_300


def test_every_page_is_two_clicks_from_the_front_page():
    """By links and lists of contents; worked fits and notebooks are listed on every page of the site."""

    def linked(page):
        text = page.read_text(encoding="utf-8")
        lists = re.findall(r"^```\{toctree\}\n(.*?)^```$", text, flags=re.M | re.S)
        names = [f"{name}.md" for one in lists for name in re.findall(r"^[\w/]+$", one, flags=re.M)]
        return {Path(os.path.normpath(page.parent / name)) for name in (*names, *re.findall(r"\]\(([^)#:]+\.md)", text))}

    front = DOCS / "index.md"
    near = linked(front)
    reached = near.union(*(linked(page) for page in near if page.exists()))
    folders = (*READ, "appendix", "reference")
    assert {page for folder in folders for page in (DOCS / folder).glob("*.md")} - reached == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(DOCS).as_posix())
def test_programs_fit_the_column(page):
    """Of the site, 46 em wide. Commands, tables and output are wrapped there."""
    programs = [block for _, block in documented.blocks(page, "python")]
    assert not [line for block in programs for line in block.splitlines() if len(line) > 88]


def test_change_log():
    """The newest release begins with what an upgrade needs, and takes a few minutes to read."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = next(one for one in re.split(r"^## ", text, flags=re.M)[1:] if not one.startswith("Unreleased"))
    assert re.findall(r"^### (.+)$", newest, flags=re.M) == ["Upgrading from 0.2", "Added", "Changed", "Fixed"]
    upgrading = newest.split("### ")[1]
    assert 5 <= len(re.findall(r"^- ", upgrading, flags=re.M)) <= 10
    assert 300 < len(newest.split()) <= 900
