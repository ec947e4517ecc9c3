"""Names, symbols and units on pictures, and text of the user's."""

import unicodedata

NAMES = {
    "height": ("height", "H"),
    "push_height": ("height of the push", "h"),
    "height_above": ("height", "y"),
    "stiffness": ("contact stiffness", "k/K"),
    "areal_stiffness": ("areal stiffness", r"k/\lambda_c^2"),
    "areal_stiffness_over_young": ("areal stiffness over $E$", r"k/(\lambda_c^2 E)"),
    "correlation_length": ("correlation length", r"\lambda_c"),
    "young": ("Young's modulus", "E"),
    "poisson": ("Poisson's ratio", r"\nu"),
    "prestress": ("prestress", r"\varphi"),
    "threshold_slope": ("threshold gradient", r"\epsilon"),
    "residual_strength": ("residual strength", "r"),
    "threshold_scatter": ("scatter of thresholds", "s"),
    "strength": ("strength", r"\sigma_s"),
    "friction": ("friction behind the front", r"\sigma_k"),
    "friction_coefficient": ("friction coefficient", r"\mu"),
    "newborn": ("strength of newborn over old contacts", ""),
    "time_constant": ("time constant of ageing", r"\tau"),
    "machine_stiffness": ("stiffness of the machine", "M"),
    "normal_load": ("normal load", "F_N"),
    "force": ("force", "F"),
    "offset": ("offset of the lengths", ""),
    "model_factor": ("factor on the model's lengths", ""),
    "arrest": (r"contacts broken beyond $\ell$", ""),
    "length": ("precursor length", r"\ell"),
    "position": ("distance from the trailing edge", "x"),
    "displacement": ("displacement", "u"),
    "stress": ("contact stress", "t"),
    "front_stress": ("front stress", "t(s)"),
    "load": ("load", "U"),
}
"""Name and symbol of each quantity."""

UNITS = {"λc": r"\lambda_c", "lambda_c": r"\lambda_c", "σ_s": r"\sigma_s", "sigma_s": r"\sigma_s", "u_s": "u_s", "E": "E"}
"""Units of the model."""

COMBINED = {
    "um": "µm",
    "1/λc": r"$1/\lambda_c$",
    "σ_s per site": r"$\sigma_s$ per site",
    "lambda_c/sigma_s": r"$\lambda_c/\sigma_s$",
}


def symbol(name: str, unit: str = "") -> str:
    """Symbol of a quantity, over its unit if that is the model's."""
    sign = NAMES[name][1]
    return f"${sign}/{UNITS[unit]}$" if unit in UNITS else f"${sign}$"


def axis_label(name: str, unit: str = "") -> str:
    """Label of an axis.

    Examples
    --------
    >>> axis_label("height", "mm")
    'height, $H$ (mm)'
    >>> axis_label("load", "u_s")
    'load, $U/u_s$'
    """
    words, sign = NAMES[name]
    if not sign:
        return in_unit(words, unit)
    return f"{words}, {symbol(name, unit)}" if unit in UNITS else in_unit(f"{words}, {symbol(name)}", unit)


def equation(name: str, value: float, unit: str = "") -> str:
    """A quantity and its value, for legends.

    Examples
    --------
    >>> equation("height", 2.5, "cm")
    '$H$ = 2.5 cm'
    >>> equation("load", 2.5, "u_s")
    '$U/u_s$ = 2.5'
    """
    after = "" if unit in UNITS else f" {printed(unit)}".rstrip()
    return f"{symbol(name, unit)} = {float(f'{value:.4g}'):g}{after}"


def in_unit(words: str, unit: str) -> str:
    """Append a unit in parentheses, if there is one."""
    return f"{words} ({printed(unit)})" if unit not in ("", "1") else words


def printed(unit: str) -> str:
    """A unit as Matplotlib prints it."""
    return f"${UNITS[unit]}$" if unit in UNITS else COMBINED.get(unit, unit)


def as_written(text: str, most: int = 40) -> str:
    r"""Text of the user's, for Matplotlib to draw it as written.

    A name of a specimen, say, is neither read as a formula nor hidden from legends. White space is blank, a character that the
    font does not have is drawn as its escape, and "…" replaces the middle of a long text.

    Examples
    --------
    >>> as_written("$x_{"), as_written("_a\n7\x07")
    ('\\$x_{', ' _a 7\\x07')
    """
    text = "".join(map(_drawn_as, text))
    if len(text) > most:
        text = f"{text[: most // 2]}…{text[1 - most // 2 :]}"
    return " " * text.startswith("_") + text.replace("$", r"\$")  # a legend leaves out what begins with "_"


def _drawn_as(character: str) -> str:
    from matplotlib.font_manager import FontProperties, findfont, get_font

    if character.isspace():
        return " "
    if unicodedata.category(character) == "Cf":  # invisible; Matplotlib's PDF fails on some
        return ""
    fonts = () if character <= "~" else (findfont(FontProperties(family=[one])) for one in FontProperties().get_family())
    if " " < character <= "~" or any(get_font(font).get_char_index(ord(character)) for font in fonts):
        return character
    return character.encode("unicode_escape").decode()


POSITION = NAMES["position"][0]
DISTANCE, DISTANCE_MM = axis_label("position", "λc"), axis_label("position", "mm")
"""Labels of every axis along the interface."""

OVER_LOAD = "force over normal load, $F/F_N$"
EXTENT = "extent over length, $x/L$"
"""Labels of what is measured of sequences of precursors."""

KEPT = r"kept, $r\theta$"
"""Legend entry of the stress that contacts keep as they break."""

AGAIN = "edge breaks again"
"""Legend entry where the length is the front's, not the event's."""
