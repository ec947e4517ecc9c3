"""``slippulse series``."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slippulse_jax.cli.shared import (
    NOT_CONVERGED,
    Grouped,
    as_json,
    figure_path,
    output_path,
    print_json,
    refuse,
    residual_strength,
    right_end,
    save_figure,
    slider_options,
)

if TYPE_CHECKING:
    from slippulse_jax.events.catalogue import Catalogue

BREAKS_AN_EVENT = 50
"""Breaks recorded at first per event, where they are drawn."""


@click.command(
    cls=Grouped,
    groups={
        "Chain": "height stiffness poisson sites right",
        "Loading": "events step spring",
        "Contacts after a break": "repin-delay residual-strength newborn recovery",
        "Output": "out figure json help",
    },
)
@slider_options(required=True)
@click.option("--sites", type=click.IntRange(min=2), default=150, metavar="N", show_default=True, help="Number of contacts.")
@click.option("--events", type=click.IntRange(min=1), default=100, metavar="N", show_default=True, help="Number of events.")
@right_end
@click.option("--step", type=float, metavar="U_S", help="Load in steps of this size; adiabatically by default.")
@click.option("--spring", type=float, metavar="K", help="Drive the edge through a spring of this stiffness.")
@click.option("--newborn", type=float, metavar="RATIO", help="Ageing: threshold of a new contact, over that of an old one.")
@click.option("--recovery", type=float, metavar="U_S", help="Ageing: displacement over which thresholds recover.")
@click.option(
    "--repin-delay", type=click.IntRange(min=0), default=0, metavar="N", help="Breaks during which a contact stays detached."
)
@residual_strength(float)
@click.option("--out", callback=output_path("csv"), metavar="FILE", help="Write the catalogue to a .csv instead of stdout.")
@click.option("--figure", callback=figure_path, metavar="FILE", help="Draw the friction curve and the space–time map.")
@as_json
def command(
    height: float, stiffness: float, poisson: float, sites: int, events: int, right: str, step: float | None,
    spring: float | None, newborn: float | None, recovery: float | None, repin_delay: int,
    residual_strength: float | None, out: Path | None, figure: Path | None, as_json: bool,
) -> None:  # fmt: skip
    """Compute a series of precursors of a slider, as CSV.

    Columns: load and force_before as an event begins; site, the contact that broke first; leftmost and extent, between
    which contacts broke, counted from the edge; length, where the front stopped, also from the edge; breaks; slip and
    stress_drop, sums over contacts; the energies work, stored, broken and relaxed; kind: edge, interior, renucleated
    (began where an earlier event was arrested) or spanning.

    For a series of a block use sp.series in Python.
    """
    _check(step, spring, newborn, recovery)
    if click.get_current_context().parent is not None:  # only in a process of slippulse itself
        from slippulse_jax.bulk.compiler import compile_loops_whole

        compile_loops_whole()
    import jax

    from slippulse_jax.base.files import write_atomically
    from slippulse_jax.base.status import Outcome
    from slippulse_jax.bodies.chain import chain
    from slippulse_jax.events.ageing import Ageing
    from slippulse_jax.events.catalogue import heading
    from slippulse_jax.events.series import Adiabatic, Spring, Steps, series
    from slippulse_jax.slider import Slider

    with jax.enable_x64(True):
        try:
            protocol = Steps(step) if step is not None else Spring(spring) if spring is not None else Adiabatic()
            ageing = None if newborn is None or recovery is None else Ageing(newborn, recovery)
            end: dict[str, Any] = {} if right == "semi-infinite" else {"length": sites, "right": right}
            one = chain(Slider(height, stiffness, poisson, **end), sites=sites, residual_strength=residual_strength)
            run = partial(series, one, protocol, events=events, ageing=ageing, repin_delay=repin_delay)
            room = BREAKS_AN_EVENT * events if figure else 0
            found = run(recorded_breaks=room)
            breaks = int(found.breaks.sum())
            if figure and breaks > room:  # repeat the series with room for all breaks
                found = run(recorded_breaks=breaks)
        except ValueError as error:
            refuse(error)
        status = Outcome(int(found.status))
        text = found.to_dataframe().rename(columns=heading).to_csv(na_rep="nan", lineterminator="\n")
        if out is not None:
            write_atomically(out, text.encode())
        if figure is not None:
            _draw(found, figure)
        if as_json:
            print_json({"status": status.name.lower(), **found.table()})
        elif out is None:
            click.echo(text, nl=False)
    click.echo(status.message, err=True)
    if status == Outcome.LIMIT:
        click.get_current_context().exit(NOT_CONVERGED)


def _check(step: float | None, spring: float | None, newborn: float | None, recovery: float | None) -> None:
    """Check, before any computation, that the options go together."""
    if step is not None and spring is not None:
        raise click.UsageError("--step and --spring are two protocols: give one")
    if (newborn is None) != (recovery is None):
        raise click.UsageError("ageing needs both --newborn and --recovery")


def _draw(found: "Catalogue", path: Path) -> None:
    from matplotlib.figure import Figure

    from slippulse_jax.plot import friction_curve, space_time, style

    with style.use():
        picture = Figure(figsize=(style.PAGE, 2.8))
        left, right = picture.subplots(1, 2)
        friction_curve(found, ax=left)
        space_time(found, ax=right)
        save_figure(picture, path)
