"""What commands have in common: JSON, errors, figures."""

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FAILURE, BAD_INPUT, NOT_CONVERGED, INTERRUPTED = 1, 2, 3, 130

FIGURE_FORMATS = ("png", "pdf", "svg")

as_json = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")


class BadInput(click.ClickException):
    """Input that cannot be used; exit status 2."""

    exit_code = BAD_INPUT


def print_json(content: dict[str, Any]) -> None:
    """Print strict JSON: a number that is not finite must have been made None before."""
    click.echo(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False))


def refuse(error: Exception) -> NoReturn:
    """Turn an error about the input into one line and exit status 2."""
    raise BadInput(str(error)) from None


def figure_path(ctx: click.Context, parameter: click.Parameter, value: str | None) -> Path | None:
    """Check, before anything is computed, that a figure could be written there."""
    if value is None:
        return None
    path = Path(value)
    if path.suffix.lstrip(".").lower() not in FIGURE_FORMATS:
        raise click.BadParameter(f"{value}: must end in {', '.join('.' + f for f in FIGURE_FORMATS)}", ctx, parameter)
    if not path.parent.is_dir():
        raise click.BadParameter(f"{value}: there is no folder {path.parent}", ctx, parameter)
    if path.is_dir():
        raise click.BadParameter(f"{value}: is a folder", ctx, parameter)
    return path


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure in the format its suffix names, in one step."""
    from slippulse_jax.files import write_atomically

    content = io.BytesIO()
    figure.savefig(content, format=path.suffix.lstrip(".").lower(), dpi=200)
    write_atomically(path, content.getvalue())
