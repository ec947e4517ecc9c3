"""The documentation names what there is, and what it shows can be run."""

import doctest
import enum
import importlib
import importlib.util
import inspect
import os
import pkgutil
import re
import typing
from pathlib import Path

import documented
import jax
import pytest
from records import described

import slippulse_jax as sp
from slippulse_jax.base.status import FRONT_OUTCOMES, Outcome
from slippulse_jax.bodies.chain import Chain
from slippulse_jax.events.catalogue import Catalogue, EventClass
from slippulse_jax.events.inertia import Motion
from slippulse_jax.inference.result.verdict import ANSWERS, FAQ, Identifiability
from slippulse_jax.slider import Slider

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
FOLDERS = ("learn", "howto", "fit", "model", "appendix")
WRITTEN = [DOCS / "index.md", *sorted(path for folder in FOLDERS for path in (DOCS / folder).glob("*.md"))]
"""Pages that are written here; notebooks, worked fits and the help of commands are copied in when the site is built."""


def module_of(name):
    return importlib.import_module(name)


def modules():
    return sorted(m.name for m in pkgutil.walk_packages(sp.__path__, "slippulse_jax."))


def in_reference():
    """What the reference documents, by name: a public name by itself, any other thing by its module and name."""
    found = {}
    for path in (DOCS / "reference").glob("*.md"):
        text = path.read_text(encoding="utf-8")
        for kind, name in re.findall(r"^\.\. auto(\w+):: (\S+)$", text, flags=re.M):
            if kind == "module":
                found[name] = importlib.import_module(name)
            else:
                module, _, last = name.rpartition(".")
                found[name] = getattr(importlib.import_module(module or "slippulse_jax"), last)
    return found


REFERENCE = in_reference()


def test_every_public_name_is_in_the_reference():
    public = {name: getattr(sp, name) for name in sp.__all__ if name != "__version__"}
    assert {name for name, thing in public.items() if not any(thing is known for known in REFERENCE.values())} == set()
    short = {name for name in REFERENCE if "." not in name}
    assert short <= set(public), "documented as public, but not public"


def test_the_front_page_of_the_reference_lists_every_public_name():
    """Once each, linked to the page that documents it."""
    index = (DOCS / "reference" / "index.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| \[`(\w+)`\]\((\w+\.md)\) \| \S.* \|$", index, flags=re.M)
    assert sorted([*(name for name, _ in listed), "__version__"]) == sorted(sp.__all__)
    for name, page in listed:
        text = (DOCS / "reference" / page).read_text(encoding="utf-8")
        assert re.search(rf"^\.\. auto\w+:: (?:slippulse_jax\.)?{name}$", text, flags=re.M), f"{name} is not on {page}"


def sources():
    """Every text that shows users what to write: pages, README, notebooks, worked fits and the modules with their docstrings."""
    folders = {
        DOCS: "*.md",
        ROOT / "notebooks": "*.ipynb",
        ROOT / "fit_examples": "*.[mp][dy]",
        Path(sp.__file__).parent: "*.py",
    }
    return [ROOT / "README.md", *(path for folder, names in folders.items() for path in sorted(folder.rglob(names)))]


def is_there(name):
    """Whether the package has this name, as far as the parts before each dot are modules or classes."""
    thing = sp
    for part in name.split("."):
        if inspect.isclass(thing):
            return hasattr(thing, part) or part in getattr(thing, "__dataclass_fields__", {})
        if not inspect.ismodule(thing):
            return True
        if not hasattr(thing, part) and not importlib.util.find_spec(f"{thing.__name__}.{part}"):
            return False
        thing = getattr(thing, part) if hasattr(thing, part) else importlib.import_module(f"{thing.__name__}.{part}")
    return True


def test_every_name_of_the_package_that_a_text_uses_exists():
    """Whatever follows ``sp.`` or ``slippulse_jax.``; NAME stands for any of them."""
    used = {
        (os.path.relpath(path, ROOT), name)  # of the installed package, which may lie elsewhere
        for path in sources()
        for name in re.findall(r"(?<![\w./])(?:sp|slippulse_jax)\.((?:\w+\.)*\w+)", path.read_text(encoding="utf-8"))
    }
    assert len(used) > 300
    assert {(path, name) for path, name in used if name != "NAME" and not is_there(name)} == set()
    assert not is_there("Adiabatic")
    assert not is_there("plot.nothing")


INSIDE = {"Inputs", "Linear", "Modes", "Springs", "ParameterSet", "Free", "Problem", "Curve"}
"""Classes that public records hold for their own use."""


def handed_out(thing):
    """Classes of the package that a public function takes or returns, or a public class holds or returns."""
    members = [thing]
    if inspect.isclass(thing):
        held = {name: member for name, member in vars(thing).items() if not name.startswith("_")}
        members += [getattr(member, "fget", None) or getattr(member, "__func__", member) for member in held.values()]
    for member in (inspect.unwrap(member) for member in members):
        if inspect.isclass(member) or inspect.isfunction(member):
            for hint in inspect.get_annotations(member).values():
                yield from classes_in(hint)


def classes_in(hint):
    """Classes of the package in an annotation, a written one too."""
    if isinstance(hint, str):  # written out where importing would be slow
        named = set(re.findall(r"\w+", hint))
        yield from (thing for name, thing in REFERENCE.items() if name.rpartition(".")[2] in named and inspect.isclass(thing))
    if inspect.isclass(hint) and hint.__module__.startswith("slippulse_jax."):
        yield hint
    for part in typing.get_args(hint):
        yield from classes_in(part)


def test_what_users_are_handed_is_in_the_reference():
    handed = [cls for thing in REFERENCE.values() for cls in handed_out(thing)]
    assert Catalogue in handed, "returned by a function"
    assert Slider in handed, "returned by a property"
    assert {cls.__name__ for cls in handed if cls not in REFERENCE.values()} <= INSIDE


def test_statuses_and_fields_have_words():
    """Every number that a record holds as its status has its enumeration in the reference, and fields their comments."""
    statuses = [x for x in REFERENCE.values() if inspect.isclass(x) and issubclass(x, enum.Enum)]
    assert {Outcome, EventClass, Identifiability} <= set(statuses)
    for status in statuses:
        assert len(described(status)) == len(status)
    assert f"- ``DONE = 12``: {Outcome.DONE.message}" in described(Outcome)
    assert "- ``first_break``: time at which each contact first broke; inf if it did not" in described(Motion)
    assert "- ``contact``: :math:`k_i`, in :math:`K`" in described(Chain)
    assert described(sp.Slider) == []  # its docstring lists them


@pytest.mark.parametrize("room", ["bodies", "front", "exact", "events"])
def test_the_map_of_a_room_has_every_module(room):
    of_room = module_of(f"slippulse_jax.{room}")
    on_the_map = re.findall(r"^ *`(\w+)`", of_room.__doc__, flags=re.MULTILINE)
    assert sorted(on_the_map) == sorted(m.name for m in pkgutil.iter_modules(of_room.__path__))


def sections(doc):
    """Sections of a numpydoc docstring, by title."""
    parts = re.split(r"^(\w[\w ]*)\n-{3,}$\n?", doc, flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.parametrize("name", sorted(name for name, thing in REFERENCE.items() if not inspect.ismodule(thing)))
def test_parameters_are_those_of_the_function(name):
    """What a docstring lists under Parameters are arguments, all of them or none."""
    thing = REFERENCE[name]
    doc = inspect.cleandoc(thing.__doc__ or "")
    assert doc, f"{name} has no docstring"
    listed = sections(doc).get("Parameters")
    if listed is None:
        return
    found = [x for line in re.findall(r"^(\S.*)$", listed, flags=re.M) for x in line.partition(" : ")[0].split(", ")]
    arguments = [x.lstrip("*") for x in inspect.signature(thing).parameters]
    found = [x.lstrip("*") for x in found]
    assert set(found) <= set(arguments), f"{name}: {sorted(set(found) - set(arguments))} are not arguments"
    assert set(arguments) <= set(found), f"{name}: {sorted(set(arguments) - set(found))} are not described"


def test_examples_in_docstrings():
    ran = 0
    for name in modules():
        if "__main__" not in name and ">>>" in Path(module_of(name).__file__).read_text(encoding="utf-8"):
            found = doctest.testmod(module_of(name), optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
            assert found.failed == 0, name
            ran += found.attempted
    assert ran >= 5


PAGES = [p.relative_to(DOCS).as_posix() for p in WRITTEN if documented.blocks(p, "python", "sh", "csv")]


@pytest.fixture
def jax_as_it_is():
    """JAX as a reader's process has it: in single precision, and with ranks promoted. By its flags: a page may set them too."""
    jax.config.update("jax_enable_x64", False)
    jax.config.update("jax_numpy_rank_promotion", "allow")
    yield
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_numpy_rank_promotion", "raise")


QUICK = ("index.md",)
"""Pages of which README's command runs the programs; CI runs those of the others too."""
LONG = {
    "fit/block.md", "fit/design.md", "fit/gauges.md", "fit/inputs.md", "fit/jax.md", "fit/own_csv.md", "fit/sequence.md",
    "howto/pictures.md", "learn/gallery.md", "model/block.md", "model/gradients.md", "model/series.md",
    "appendix/block_theory.md", "appendix/experiments.md",
}  # fmt: skip
"""Pages whose programs take longest and call what other tests hold: they run every night."""


def marks_of(page):
    return () if page in QUICK else pytest.mark.slow if page in LONG else pytest.mark.ci


def test_long_pages_are_there():
    assert set(PAGES) >= LONG


@pytest.mark.parametrize("page", [pytest.param(page, marks=marks_of(page)) for page in PAGES])
def test_examples_of_a_page_run(page, tmp_path, monkeypatch, jax_as_it_is):
    """Programs, commands and tables in their order, in one folder; pages mark what cannot run here as another kind of block."""
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    plt.switch_backend("Agg")
    scope = {"__name__": "__main__"}
    for kind, text in documented.blocks(DOCS / page, "python", "sh", "csv"):
        if kind == "csv":
            name = "my_gauges.csv" if text.startswith("label,position") else "my_lengths.csv"
            Path(name).write_text(text, encoding="utf-8")
        elif kind == "sh":
            documented.run_shell(text)
        else:
            documented.run_python(text, page, scope)
    plt.close("all")


def test_every_how_to_ends_in_an_assertion_of_its_point():
    """In its last program, if it has one that runs here."""
    pages = [page for page in PAGES if page.startswith(("howto/", "fit/"))]
    assert len(pages) >= 11
    for page in pages:
        *_, (_, last) = documented.blocks(DOCS / page, "python")
        assert re.search(r"^\s*assert ", last, flags=re.M), page


def test_what_is_not_run_says_so():
    """Blocks of another kind than those above are output, are put in from elsewhere, or need a cluster."""
    for path in (*WRITTEN, ROOT / "README.md"):
        kinds = re.findall(r"^```(.*)\n(?:.*\n)*?```$", path.read_text(encoding="utf-8"), flags=re.M)
        other = {
            kind
            for kind in kinds
            if kind not in ("python", "sh", "csv", "text") and not kind.startswith(("{toctree", "{include"))
        }
        allowed = {
            "sweeps.md": {"bash", "{code-block} python"},
            "jax.md": {"{code-block} python"},
            "series.md": {"bash"},
            "install.md": {"bash"},
        }
        assert other <= allowed.get(path.name, set()), path.name


def test_every_status_is_on_the_page_of_sweeps():
    page = (DOCS / "howto" / "sweeps.md").read_text(encoding="utf-8")
    listed = dict(re.findall(r"^\| (\d) \| (.+) \|$", page, flags=re.M))
    assert {int(number) for number in listed} == {int(status) for status in FRONT_OUTCOMES}
    for status in FRONT_OUTCOMES:
        assert status.message[:7].lower() in listed[str(int(status))], status


def test_links_between_pages_lead_somewhere():
    """Every page is reached from the front page, or from that of the reference, and every relative link exists."""
    listed = set()
    for folder in ("", "reference/"):
        front = (DOCS / folder / "index.md").read_text(encoding="utf-8")
        listed |= {folder + page for page in re.findall(r"^([\w/]+)$", front, flags=re.M)}
    reference = [path for path in (DOCS / "reference").glob("*.md") if path.stem != "commands"]
    pages = {path.relative_to(DOCS).with_suffix("").as_posix(): path for path in (*WRITTEN, *reference)}
    assert set(pages) - listed == {"index"}
    for page, path in pages.items():
        for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", path.read_text(encoding="utf-8")):
            if not link.startswith("http"):
                assert path.parent.joinpath(link).exists(), f"{page}: {link}"


def test_sentence_for_a_paper(worked):
    """The page quotes what `FitResult.methods` writes, but for the version."""
    page = (DOCS / "fit" / "report.md").read_text(encoding="utf-8")
    without = re.compile(r"slippulse_jax [0-9.a-z]+\)")
    said = worked("pmma_block").methods()
    assert without.sub("", said) in [without.sub("", quoted) for quoted in re.findall(r"^> (.*)$", page, flags=re.M)]


def test_addresses_of_reports_lead_to_answers():
    """Every slug that a report prints is a heading of the page of questions."""
    page = (DOCS / "fit" / "faq.md").read_text(encoding="utf-8")
    slugs = {heading.lower().replace(" ", "-") for heading in re.findall(r"^#+ (.+)$", page, flags=re.M)}
    assert FAQ == "docs/fit/faq.md"
    assert set(ANSWERS.values()) <= slugs
