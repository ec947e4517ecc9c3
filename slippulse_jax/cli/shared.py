"""Shared by the commands: JSON, errors, figures."""

import io
import json
import os
import signal
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from slippulse_jax.files import FIGURE_FORMATS, plain, shortened

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAILURE, BAD_INPUT, NOT_CONVERGED, INCOMPLETE, INTERRUPTED = 1, 2, 3, 4, 130
"""Exit statuses."""


as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")

right_end = click.option(
    "--right",
    type=click.Choice(["semi-infinite", "free", "clamped"]),
    default="semi-infinite",
    show_default=True,
    help="Right end of the chain.",
)

contact_law = click.option(
    "--contact-law",
    type=click.Choice(["amontons", "multicontact"]),
    default="amontons",
    help="What follows the pressure with --friction: thresholds, or thresholds and stiffnesses.",
)
top_of_block = click.option(
    "--top", type=click.Choice(["free", "held"]), default="free", help="Whether the top of a block may tilt."
)


def slider_options(*, required: bool) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Options of one slider in λc; `required` unless it may be given in SI instead."""

    def add(command: Callable[..., Any]) -> Callable[..., Any]:
        poisson = click.option("--poisson", type=float, required=True, metavar="ν", help="Poisson's ratio.")
        stiffness = click.option(
            "--stiffness", type=float, required=required, metavar="k/K", help="Contact stiffness over bond stiffness K = Eλc."
        )
        height = click.option(
            "--height", type=float, required=required, metavar="H/λc", help="Height of the slider over the correlation length."
        )
        return height(stiffness(poisson(command)))

    return add


def option(name: str) -> str:
    """Option whose value has this name: ``--push-height`` of push_height."""
    return "--" + name.replace("_", "-")


class BadInput(click.ClickException):
    """Invalid input; exit status 2."""

    exit_code = BAD_INPUT


last_words: list[str] = []
"""Lines printed when the command is interrupted; a command adds its own."""


def leave_when_interrupted() -> None:
    """Let Ctrl-C print a last message and end the program at once, with status 130.

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
    click.echo(json.dumps(plain(content), indent=2, ensure_ascii=not prints_unicode(), allow_nan=False))


def prints_unicode() -> bool:
    """Whether stdout takes every character."""
    return (getattr(sys.stdout, "encoding", None) or "utf-8").lower().startswith("utf")


def refuse(error: Exception) -> NoReturn:
    """Exit with status 2 and the message of an error about the input, or of a file that cannot be read."""
    if isinstance(error, OSError) and error.filename is not None:
        raise BadInput(f"{error.filename}: {error.strerror}") from None
    raise BadInput(shortened(str(error))) from None


def output_path(*formats: str) -> Callable[[click.Context, click.Parameter, str | None], Path | None]:
    """Callback of an option that checks, before any computation, format and folder of a file to be written."""

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
        return path

    return check


figure_path, table_path, page_path = output_path(*FIGURE_FORMATS), output_path("csv", "nc"), output_path("md")


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure atomically, in the format of its suffix, and report it on stderr."""
    from slippulse_jax.files import write_atomically

    content = io.BytesIO()
    figure.savefig(content, format=path.suffix.lstrip(".").lower(), dpi=200)
    write_atomically(path, content.getvalue())
    click.echo(f"figure written to {path}", err=True)
