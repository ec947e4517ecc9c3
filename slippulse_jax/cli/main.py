"""The command ``slippulse``: data on stdout, messages on stderr.

Exit status: 0 done; 1 failure; 2 bad usage or input; 3 did not converge; 4 sweep incomplete; 130 interrupted. A command is
imported when it is run, so that ``--help`` and ``--version`` answer without JAX.
"""

import importlib
import io
import os
import sys
import warnings
from typing import Any

import click

from slippulse_jax.base.status import NotConverged
from slippulse_jax.cli.cache import compile_everything_anew, delete_unreadable, keep_compiled_programs
from slippulse_jax.cli.shared import FAILURE, INTERRUPTED, NOT_CONVERGED, leave_when_interrupted

COMMANDS = {
    "claims": "Measure the paper's claims and compare.",
    "design": "Choose the next experiment to determine the interface stiffness.",
    "figures": "Draw the paper's Figures 2 and 3, with their numbers as CSV.",
    "fit": "Fit the interface stiffness to measured precursor lengths.",
    "length": "Compute the first precursor of one slider or block.",
    "series": "Compute a series of precursors as a catalogue of events.",
    "sweep": "Compute first precursors over ranges of parameters.",
}


class LazyGroup(click.Group):
    """A group whose commands are modules of slippulse_jax.cli, imported when needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands."""
        return sorted(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import the command."""
        if cmd_name not in COMMANDS:
            return None
        return importlib.import_module(f"slippulse_jax.cli.{cmd_name}").command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(sorted(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="slippulse_jax", message="slippulse %(version)s")
@click.option(
    "--cache/--no-cache",
    default=True,
    envvar="SLIPPULSE_CACHE",
    help="Keep compiled programs for the next call, the default; SLIPPULSE_CACHE=off keeps none.",
)
def slippulse(cache: bool) -> None:
    """Self-healing slip pulses at the onset of frictional sliding."""
    if cache:
        keep_compiled_programs()
    else:
        compile_everything_anew()


def main() -> None:
    """Run the command line and exit with its status."""
    leave_when_interrupted()
    _print_in_any_encoding()
    warnings.showwarning = _show
    try:
        status = slippulse.main(standalone_mode=False)  # of ctx.exit; None where a command ran to its end
        if sys.stdout is not None:
            sys.stdout.flush()
        if status:
            sys.exit(status)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except NotConverged as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(NOT_CONVERGED)
    except click.Abort:
        click.echo("interrupted", err=True)
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # the reader closed the pipe, as head does
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.exit(FAILURE)
    except OSError as error:
        click.echo(f"Error: {error}", err=True)
        sys.exit(FAILURE)
    except (MemoryError, RuntimeError) as error:
        click.echo(f"Error: {_in_words(error)}", err=True)
        sys.exit(FAILURE)


def _in_words(error: MemoryError | RuntimeError) -> str:
    """Word a failure of the machine, or of a setting; raise others."""
    said = str(error)
    if isinstance(error, MemoryError) or said.startswith("RESOURCE_EXHAUSTED"):  # as XLA reports it
        return f"not enough memory ({said}); a sweep with --store needs it for a few chunks only"
    if said.startswith("jax_disable_jit"):  # as `check_jit` reports it
        return said
    raise error


def _show(warning: Warning | str, *_: Any) -> None:
    if not delete_unreadable(warning):
        click.echo(f"Warning: {warning}", err=True)


def _print_in_any_encoding() -> None:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # Latin-1 has no λ
            stream.reconfigure(errors="replace")


if __name__ == "__main__":
    main()
