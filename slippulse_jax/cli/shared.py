"""Shared by the commands: JSON, errors, figures."""

import json
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, get_args

import click

from slippulse_jax.base.choices import ContactLaw, Control, RightEnd, Top
from slippulse_jax.base.files import FIGURE_FORMATS, plain, shortened

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure

FAILURE, BAD_INPUT, NOT_CONVERGED, INCOMPLETE, INTERRUPTED = 1, 2, 3, 4, 130
"""Exit statuses."""

as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")


Option = Callable[[Callable[..., Any]], Callable[..., Any]]
"""Decorator of a command."""


def choice(name: str, of: Any, text: str, **options: Any) -> Option:
    """Option that takes one of the values of a ``Literal``."""
    return click.option(name, type=click.Choice(get_args(of)), help=text, **options)


right_end = choice("--right", RightEnd, "Right end of the chain.", default="semi-infinite", show_default=True)
push_control = choice("--push-control", Control, "Hold the displacement (default) or the force during an event.")


class Grouped(click.Command):
    """A command whose help lists its options in titled groups.

    Parameters
    ----------
    groups
        Names of options, without dashes, by title.
    """

    def __init__(self, *args: Any, groups: dict[str, str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.groups = groups

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the options; what tables refuse as a number is none here."""
        given = self.make_parser(ctx).parse_args(args=list(args))[0]
        for one in self.params:
            written = given.get(one.name or "", ())
            for text in written if isinstance(written, tuple) else (written,):
                if isinstance(one.type, click.types.FloatParamType | click.types.IntParamType) and isinstance(text, str):
                    try:
                        number(text)
                    except ValueError as error:
                        raise click.BadParameter(str(error), ctx, one) from None
        return super().parse_args(ctx, args)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the options, their texts below each other in all groups."""
        records = {
            max(one.opts, key=len)[2:]: one.get_help_record(ctx) for one in self.get_params(ctx) if one.opts[0][0] == "-"
        }
        for title, names in self.groups.items():
            with formatter.section(title):
                formatter.write_dl(
                    [(f"{one[0]:<{WIDTH_OF_NAMES}}", one[1]) for name in names.split() if (one := records[name])],
                    col_max=WIDTH_OF_NAMES,
                )


def number(text: str) -> float:
    """Read a number as tables write it, ``2_5`` being none."""
    from slippulse_jax.inference.table.columns import NUMBER

    if not NUMBER.fullmatch(text.strip()):
        raise ValueError(f"{text!r} is not a number")
    return float(text)


def whole(text: str) -> int:
    """Read a whole number likewise."""
    number(text)
    return int(text)


WIDTH_OF_NAMES = 28
"""Characters of an option's name and value in a list of groups."""


class Values(click.ParamType):
    """A number, a list ``a,b,c``, or a range ``first:last:count[:log]``."""

    name = "values"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> "np.ndarray":
        """Array of shape () or (n,)."""
        import numpy as np

        parts = str(value).split(":")
        try:
            if len(parts) == 1:
                numbers = [number(x) for x in parts[0].split(",")]
                return np.array(numbers[0] if len(numbers) == 1 else numbers)
            first, last, count = *map(number, parts[:2]), whole(parts[2])
            if count > MOST_VALUES:
                self.fail(f"{value!r}: more than {MOST_VALUES} values", param, ctx)
            if parts[3:] == ["log"] and min(first, last) <= 0:
                self.fail(f"{value!r}: even steps of the logarithm need both ends above 0", param, ctx)
            if count < 1 or parts[3:] not in ([], ["log"]):
                raise ValueError
        except (ValueError, IndexError):
            self.fail(f"{value!r} is not a number, a list a,b,c or a range first:last:count[:log]", param, ctx)
        return np.geomspace(first, last, count) if parts[3:] else np.linspace(first, last, count)


MOST_VALUES = 10_000_000
"""Values of one range."""
VALUES = Values()


def together(*options: Option) -> Option:
    """Several options as one, listed in this order."""

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        for one in reversed(options):
            command = one(command)
        return command

    return add


def contacts_of_block(kind: Any) -> Option:
    """Options of a block and its contacts; numbers of a `kind`."""
    law = "What follows the pressure: thresholds (amontons), or stiffnesses too (multicontact)."
    several = "" if kind is float else ",…"
    return together(
        click.option(
            "--friction",
            type=kind,
            metavar=f"μ{several}",
            help="Friction coefficient: thresholds follow the pressure.",
        ),
        click.option(
            "--normal-stiffness",
            type=kind,
            metavar=f"k_n/k{several}",
            help="Normal over shear stiffness of the contacts; 1.2 by default with --friction.",
        ),
        choice("--contact-law", ContactLaw, law, default="amontons", metavar="LAW"),
        choice("--top", Top, "Let the top of the block tilt (free), or keep it level (held).", default="free"),
    )


def residual_strength(kind: Any) -> Option:
    """Option of what a contact keeps; a number of a `kind`."""
    text = "Share of its strength that a contact keeps as it breaks."
    return click.option("--residual-strength", type=kind, metavar="r", help=text)


def slider_options(*, required: bool) -> Option:
    """Options of one slider in λc, `required` or not."""
    return together(
        click.option(
            "--height", type=float, required=required, metavar="H/λc", help="Height of the slider, over the correlation length."
        ),
        click.option(
            "--stiffness",
            type=float,
            required=required,
            metavar="k/K",
            help="Contact stiffness, over the bond stiffness K = Eλc.",
        ),
        click.option("--poisson", type=float, required=required, metavar="ν", help="Poisson's ratio."),
    )


def option(name: str) -> str:
    """Option whose value has this name: ``--push-height`` of push_height."""
    return "--" + name.replace("_", "-")


def one_form(
    given: Mapping[str, Any], of: str, plain: Sequence[str], si: Sequence[str], optional: Sequence[Sequence[str]] = ((), ())
) -> dict[str, Any]:
    """Read the one form that was given, λc or SI, into SI.

    All of `plain`, or of `si`, are needed.
    """
    from slippulse_jax.inference.table.columns import SI

    forms = ((*plain, *optional[0]), (*si, *optional[1]))
    in_plain, in_si = ([name for name in form if given[name] is not None] for form in forms)
    if in_si and in_plain:
        raise click.UsageError(f"{option(in_si[0])} and {option(in_plain[0])} belong to two forms of the {of}: give one")
    missing = [option(name) for name in (si if in_si else plain) if given[name] is None]
    if missing:
        raise click.UsageError(f"missing {', '.join(missing)} (or give the other form of the {of}: see --help)")
    sizes = {f"_{unit.lower()}": size for unit, size in SI.items()}
    ends = {name: next((end for end in sizes if name.endswith(end)), "") for name in in_si or in_plain}
    return {name.removesuffix(end): given[name] * sizes.get(end, 1.0) for name, end in ends.items()}


last_words: list[str] = []
"""Lines printed when the command is interrupted; a command adds its own."""


def leave_when_interrupted() -> None:
    """Let Ctrl-C print a last message and exit with status 130.

    A KeyboardInterrupt would be swallowed in a callback of JAX's compiler, and unloading JAX during a compilation can crash.
    Files are written whole or not at all, so nothing is lost.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # in the background of a shell
        return

    def leave(*_: Any) -> None:
        message = "\n" * os.isatty(2) + "".join(line + "\n" for line in (*last_words, "interrupted"))
        os.write(2, message.encode())  # bypass Python's buffers, which may be in use
        os._exit(INTERRUPTED)

    signal.signal(signal.SIGINT, leave)


def print_json(content: dict[str, Any]) -> None:
    """Print strict JSON, with null for numbers that are not finite."""
    every_character = (getattr(sys.stdout, "encoding", None) or "utf-8").lower().startswith("utf")
    click.echo(json.dumps(plain(content), indent=2, ensure_ascii=not every_character, allow_nan=False))


def refuse(error: Exception | str, status: int = BAD_INPUT) -> NoReturn:
    """Exit with a message and a status, that of bad input."""
    if isinstance(error, OSError) and error.filename is not None:
        error = f"{error.filename}: {error.strerror}"
    refused = click.ClickException(shortened(str(error)))
    refused.exit_code = status  # pyright: ignore[reportAttributeAccessIssue]
    raise refused from None


def output_path(*formats: str) -> Callable[[click.Context, click.Parameter, str | None], Path | None]:
    """Callback of an option that checks a file to be written."""

    def check(ctx: click.Context, parameter: click.Parameter, value: str | None) -> Path | None:
        if value is None:
            return None
        path = Path(value)
        if path.suffix.lstrip(".").lower() not in formats:
            raise click.BadParameter(f"{value}: must end in {', '.join('.' + f for f in formats)}", ctx, parameter)
        if not path.parent.is_dir():
            raise click.BadParameter(f"{value}: there is no folder {path.parent}", ctx, parameter)
        if path.is_dir():
            raise click.BadParameter(f"{value}: is a folder", ctx, parameter)
        if path.suffix == ".nc" and find_spec("h5netcdf") is None:
            raise click.BadParameter(f"{value}: needs h5netcdf; pip install 'slippulse_jax[netcdf]'", ctx, parameter)
        other = ctx.meta.setdefault(f"{__name__}.{path.resolve()}", parameter)
        if other is not parameter:
            raise click.BadParameter(f"{value}: is the file of {other.opts[-1]} too", ctx, parameter)
        return path

    return check


figure_path, table_path, page_path = output_path(*FIGURE_FORMATS), output_path("csv", "nc"), output_path("md")


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure, and say where."""
    from slippulse_jax.plot.style import save

    save(figure, path, dpi=200)
    click.echo(f"figure written to {path}", err=True)
