"""Published set-ups by name, with the numbers that their sources give.

Names are those of columns of a table of measurements; what a source does not give is None.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from slippulse_jax.base.shown import in_a_line, listed

if TYPE_CHECKING:
    from slippulse_jax.block import Block

NEEDED = (
    "height", "block_length", "block_width", "young", "poisson", "correlation_length", "areal_stiffness", "push_height",
    "push_width", "friction", "machine_stiffness",
)  # fmt: skip
"""Numbers without which there is no block."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Experiment:
    """A published set-up: its source, and the numbers read there, in SI."""

    name: str
    authors: tuple[str, ...]  # surname first
    title: str
    journal: str  # empty for source code
    year: int
    link: str
    where: str  # the place in the source, and what it describes
    height: float | None = None  # H, in m
    block_length: float | None = None  # L, in m
    block_width: float | None = None  # in m
    cross_section: float | None = None  # height times width, in m²
    young: float | None = None  # E, in Pa
    poisson: float | None = None  # ν
    correlation_length: float | None = None  # λc, in m
    areal_stiffness: float | None = None  # k/λc², in Pa/m
    normal_load: float | None = None  # F_N, in N
    push_height: float | None = None  # of the middle of the pusher, in m
    push_width: float | None = None  # height of the pusher itself, in m
    machine_stiffness: float | None = None  # of the whole machine, in N/m
    friction: float | None = None  # μ_s, at which contacts break
    kinetic_friction: float | None = None  # μ_d of sliding contacts, which have none in this model

    def __repr__(self) -> str:
        return in_a_line(self, "name", "cross_section", "normal_load", "kinetic_friction", *NEEDED)

    @property
    def lacks(self) -> tuple[str, ...]:
        """Numbers that `block` needs and the source does not give."""
        return tuple(name for name in NEEDED if getattr(self, name) is None)

    def cite(self, bibtex: bool = False) -> str:
        """Return the reference as text, or for BibTeX."""
        if bibtex:
            fields = {"author": " and ".join(self.authors), "title": self.title, "journal": self.journal, "year": self.year}
            fields |= {"url": self.link, "note": self.where}
            lines = "".join(f",\n  {name} = {{{value}}}" for name, value in fields.items() if value)
            return f"@{'article' if self.journal else 'misc'}{{{self.name}{lines}\n}}"
        authors = listed([" ".join(reversed(one.split(", "))) for one in self.authors])
        return f"{authors}, {self.title}, {self.journal or 'source code'} ({self.year}), {self.link}: {self.where}"

    def block(self, **given: Any) -> "Block":
        """Make the block, with what its source does not give.

        Parameters
        ----------
        **given
            Numbers under the names of the record, in SI, which replace its own; all that it `lacks` must be there. None is a
            `block_length` without end, a `push_width` up to the top, a `machine_stiffness` that holds the edge, and no
            `friction`. Others are those of `Block.from_material`, such as `normal_stiffness`, `contact_law` and `top`.

        Raises
        ------
        ValueError
            If numbers are missing, all of which it names; or if one lies outside its domain.
        """
        from slippulse_jax.base.domains import Domain
        from slippulse_jax.block import Block

        numbers = {name: getattr(self, name) for name in NEEDED} | given
        held = given.get("machine_stiffness", ...) is None  # nothing depends on the width
        missing = [
            name for name in NEEDED if numbers[name] is None and name not in given and not (held and name == "block_width")
        ]
        if missing:
            raise ValueError(f"{self.name} lacks {listed(missing)}: give block({'=…, '.join(missing)}=…), in SI")
        width, numbers["length"] = numbers.pop("block_width"), numbers.pop("block_length")
        if not held:
            Domain(0, math.inf, "the width of a block must be positive").check("block_width", width)
            numbers["machine_stiffness"] /= width
        return Block.from_material(**numbers)


tromborg2014 = Experiment(
    name="tromborg2014", authors=("Trømborg, J. K.", "Sveinsson, H. A.", "Scheibert, J.", "Thøgersen, K.", "Amundsen, D. S.",
                                  "Malthe-Sørenssen, A."),
    title="Slow slip and the transition from fast to slow fronts in the rupture of frictional interfaces",
    journal="Proceedings of the National Academy of Sciences", year=2014, link="https://arxiv.org/abs/1402.4700",
    where="Table S1, parameters of a simulation of a two-dimensional lattice of springs",
    height=0.075, block_length=0.14, block_width=0.006, young=3e9, normal_load=1920.0, push_height=0.005,
    machine_stiffness=4e6, friction=0.4, kinetic_friction=0.17,
)  # fmt: skip
oslo1d = Experiment(
    name="oslo1d", authors=("bokhylle",), title="OneDimensionalFrictionModel", journal="", year=2016,
    link="https://github.com/bokhylle/OneDimensionalFrictionModel",
    where="main.cpp of commit 95c7931, a simulation of a chain of springs; the law that would take the two friction "
          "coefficients is commented out there",
    block_length=0.1, cross_section=1e-4, young=2.5e9, normal_load=400.0, machine_stiffness=8e5, friction=0.7,
    kinetic_friction=0.45,
)  # fmt: skip
katano2014 = Experiment(
    name="katano2014", authors=("Katano, Y.", "Nakano, K.", "Otsuki, M.", "Matsukawa, H."),
    title="Novel friction law for the static friction force based on local precursor slipping",
    journal="Scientific Reports", year=2014, link="https://doi.org/10.1038/srep06324",
    where="caption of Fig. 2, panel a, an experiment", normal_load=400.0, push_height=0.0,
)  # fmt: skip

ALL = {one.name: one for one in (tromborg2014, oslo1d, katano2014)}
"""Every record by its name."""
