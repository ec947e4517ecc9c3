"""Guess which quantity a column means whose name a table of measurements does not know.

A guess is offered in the error message and never taken by itself: the symbols of one group are the words of another.
"""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import NamedTuple
from unicodedata import normalize

from slippulse_jax.units import UNITS_OF_LENGTH, UNITS_OF_MODULUS

SYMBOLS = {
    "H": ("height",),
    "h": ("height", "push_height"),
    "L": ("length", "block_length"),
    "l": ("length",),  # ℓ too, in its compatible form
    "Λ": ("length",),  # of the paper
    "E": ("young",),
    "ν": ("poisson",),
    "φ": ("prestress",),
    "ϕ": ("prestress",),
    "λ": ("correlation_length",),
}
"""Quantities by symbol, in which case matters; several where authors differ."""

WORDS = {
    "height": "höhe hoehe hauteur block_height blockhöhe blockhoehe slider_height sample_height",
    "length": "länge laenge longueur precursor_length front_length arrest_length",
    "block_length": "blocklänge blocklaenge sample_length slider_length longueur_du_bloc",
    "correlation_length": "λc λ_c lambda_c lambdac lambda lc l_c korrelationslänge korrelationslaenge longueur_de_corrélation",
    "poisson": "nu poisson_ratio poissons_ratio poisson's_ratio poissonzahl querkontraktionszahl coefficient_de_poisson",
    "young": "young_modulus youngs_modulus young's_modulus youngsmodul e_modul emodul e_modulus e_mod emod elastic_modulus "
    "elastizitätsmodul elastizitaetsmodul module_de_young module_d_young",
    "prestress": "phi vorspannung précontrainte precontrainte",
    "displacement": "verschiebung déplacement deplacement",
    "push_height": "druckhöhe druckhoehe schubhöhe schubhoehe stoßhöhe stosshöhe angriffshöhe lasthöhe hauteur_de_poussée "
    "hauteur_d'appui load_height loading_height indenter_height",
    "specimen": "block blocks specimens sample probe probekörper prüfkörper échantillon echantillon éprouvette eprouvette bloc",
}
"""Words and spelled symbols of a quantity, in English, German and French."""

_MEANT: dict[str, tuple[str, ...]] = {
    **{word: (quantity,) for quantity, words in WORDS.items() for word in words.split()},
    "pusher_height": ("push_height", "push_width"),  # where it is, or how high it is itself
}
_ERROR = re.compile(
    r"(?:^|_)(?:sigma|σ|error|err|std|sd|stderr|uncertainty|fehler|unsicherheit|erreur|incertitude)(?=_|$)", re.IGNORECASE
)
_BETWEEN = re.compile(r"[\s()\[\]{}/.,:-]+")
_UNITS = {unit.casefold().replace("µ", "μ"): unit.replace("µ", "u") for unit in (*UNITS_OF_LENGTH, *UNITS_OF_MODULUS)}
_PER = re.compile(r"_(k?n_per_m{1,2})$", re.IGNORECASE)
_NOT_READ = ("in", "inch", "ft", "dm", "km", "psi", "n", "kn", "n_per_m", "kn_per_m", "n_per_mm", "kn_per_mm")
ALIKE = 0.8
"""Similarity (difflib) above which a name counts as a typing error."""
LONGEST = 60
"""Length of the longest name whose meaning is guessed."""


class Meant(NamedTuple):
    """The quantities that a name may mean, best first."""

    quantities: tuple[str, ...] = ()
    unit: str = ""  # as columns spell it; a unit that cannot be read as the name does
    sure: bool = False  # whether the name is a known word or symbol, not just similar to one


def meant(column: str, known: Iterable[str]) -> Meant:
    """Quantities among `known` that a column called `column` may mean.

    Examples
    --------
    >>> meant("Höhe (cm)", ["height", "length"])
    Meant(quantities=('height',), unit='cm', sure=True)
    """
    if len(column) > LONGEST:
        return Meant()
    name = _BETWEEN.sub("_", normalize("NFKC", column)).strip("_")
    word = _ERROR.sub("", name).strip("_")
    error = "_sigma" * (word != name)
    per = _PER.search(word)
    rest, _, last = (word[: per.start()], "", per[1]) if per else word.rpartition("_")
    unit = _UNITS.get(last.casefold(), last if last.casefold() in _NOT_READ else "") if rest or error else ""
    if unit:
        word = rest.removesuffix("_in")
    known = list(known)
    folded = word.casefold()
    found = SYMBOLS.get(word) or _MEANT.get(folded) or ((folded,) if folded in known else ())
    if not word and error:
        found = ("length",)
    sure = bool(found)
    if not sure and len(word) > 3:
        alike = get_close_matches(folded + error, [one for one in known if one[0] == folded[0]], n=1, cutoff=ALIKE)
        return Meant(tuple(alike), unit, False)
    return Meant(tuple(one + error for one in found if one + error in known), unit, sure)
