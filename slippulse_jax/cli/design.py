"""``slippulse design``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from slippulse_jax.base.choices import EventKind
from slippulse_jax.cli.shared import (
    VALUES,
    Grouped,
    as_json,
    choice,
    contacts_of_block,
    figure_path,
    one_form,
    option,
    print_json,
    push_control,
    refuse,
    save_figure,
)

if TYPE_CHECKING:
    import numpy as np


@click.command(
    cls=Grouped,
    groups={
        "Candidates, over λc": "height sigma push-height push-width",
        "Candidates, tables": "table",
        "Candidates, in SI": "height-mm sigma-mm correlation-length-um young-gpa push-height-mm push-width-mm",
        "Candidates in both": "poisson prestress push-control friction normal-stiffness contact-law top event whole",
        "Prior knowledge": "stiffness log-sd measured bounds",
        "Plan and output": "next seed figure json help",
    },
)
@click.option("--table", "tables", multiple=True, metavar="CSV", help="Table as it would be measured; once for each candidate.")
@click.option("--height", type=VALUES, metavar="H/λc,…", help="Heights of the available blocks.")
@click.option("--sigma", type=VALUES, metavar="σ/λc,…", help="Standard errors of the lengths.")
@click.option("--height-mm", type=VALUES, metavar="MM,…", help="Heights of the available blocks.")
@click.option("--sigma-mm", type=VALUES, metavar="MM,…", help="Standard errors of the lengths.")
@click.option("--correlation-length-um", type=VALUES, metavar="UM,…", help="Correlation length λc.")
@click.option("--young-gpa", type=VALUES, metavar="GPA,…", help="Young's modulus.")
@click.option("--push-height", type=VALUES, metavar="h/H,…", help="Height of the push: the candidates are blocks.")
@click.option("--push-width", type=VALUES, metavar="w/H,…", help="Height of the pusher; everything above the push by default.")
@click.option("--push-height-mm", type=VALUES, metavar="MM,…", help="Height of the push: the candidates are blocks.")
@click.option(
    "--push-width-mm", type=VALUES, metavar="MM,…", help="Height of the pusher; everything above the push by default."
)
@push_control
@contacts_of_block(VALUES)
@click.option("--poisson", type=VALUES, metavar="ν,…", help="Poisson's ratio; needed beside heights.")
@click.option("--prestress", type=VALUES, metavar="φ,…", help="Prestress, in σ_s; 0 by default.")
@click.option("--stiffness", type=VALUES, metavar="K,…", help="Stiffness, or its several roots: k/K, or k/λc² in Pa/m.")
@click.option("--log-sd", type=VALUES, metavar="SD,…", help="Standard deviation of ln(stiffness) about each root.")
@click.option("--measured", metavar="LENGTHS.CSV", help="Table of earlier measurements, as for slippulse fit.")
@click.option("--bounds", type=float, nargs=2, metavar="LOW HIGH", help="Range of stiffness to search with --measured.")
@choice("--event", EventKind, "What lengths are: domino = first front (default), full = whole event.")
@click.option("--whole", is_flag=True, help="Count whole contacts, to within σ, which may be 0.")
@click.option(
    "--next", "experiments", type=click.IntRange(1, 12), default=1, metavar="N", show_default=True, help="Experiments to plan."
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random shifts, for two and more.")
@click.option("--figure", callback=figure_path, metavar="FILE", help="Draw gains and lengths: .png, .pdf or .svg.")
@as_json
def command(
    stiffness: "np.ndarray | None",
    log_sd: "np.ndarray | None",
    measured: str | None,
    bounds: tuple[float, float] | None,
    event: Any,
    whole: bool,
    experiments: int,
    seed: int,
    figure: Path | None,
    as_json: bool,
    tables: tuple[str, ...],
    **conditions: Any,
) -> None:
    """Rank candidate experiments by expected information about the interface.

    Give one entry per candidate, or one for all: a number, a list a,b,c or a range first:last:count[:log]; or tables of what
    would be measured. --stiffness with --log-sd, --measured, or both say what is known before.
    """
    from slippulse_jax.inference.design import design
    from slippulse_jax.inference.table.measurements import read_measurements

    candidates: dict[str, Any] = (
        {"candidates": dict(zip(_names(tables), tables, strict=True))} if tables else _conditions(conditions)
    )
    source = click.get_current_context().get_parameter_source
    if tables and (given := [name for name in conditions if source(name) is ParameterSource.COMMANDLINE]):
        raise click.UsageError(f"{option(given[0])} beside --table: a table states it")
    if measured is None and stiffness is None:
        raise click.UsageError("missing --stiffness (with --log-sd) or --measured: prior knowledge of the stiffness")
    if (stiffness is None) != (log_sd is None):
        raise click.UsageError("--stiffness and --log-sd must be given together")
    if bounds and measured is None:
        raise click.UsageError("--bounds is the range of the stiffness that --measured is searched for")
    try:
        in_si = read_measurements(tables[0]).in_si if tables else "correlation_length" in candidates
        known = _knowledge(stiffness, log_sd, measured, in_si, bounds=bounds, event=event)
        kind = "whole" if whole else "length"
        found = design(known, **candidates, kind=kind, experiments=experiments, seed=seed)
    except (ValueError, OSError) as error:
        refuse(error)
    if as_json:
        print_json(found.to_dict())
    else:
        click.echo(found.report())
    if figure is not None:
        from slippulse_jax import plot

        save_figure(plot.design_figure(found), figure)


def _names(tables: tuple[str, ...]) -> list[str]:
    """Name tables by their files; by paths if two are alike."""
    stems = [Path(name).stem for name in tables]
    if len({*tables}) < len(tables):
        raise click.UsageError("--table: the same table twice")
    return stems if len({*stems}) == len(stems) else list(tables)


def _conditions(given: dict[str, Any]) -> dict[str, Any]:
    """Conditions of the candidates, as `design` takes them."""
    import numpy as np

    plain, si = ("height", "sigma"), ("height_mm", "sigma_mm", "correlation_length_um", "young_gpa")
    pushes = ("push_height", "push_width"), ("push_height_mm", "push_width_mm")
    found = one_form(given, "candidates", plain, si, pushes)
    if given["poisson"] is None:
        raise click.UsageError("missing --poisson")
    for name in ("push_height", "push_width") if "young" in found else ():  # over the height of the block
        x, heights = found.get(name, np.zeros(1)), found["height"]
        if x.size != heights.size and 1 not in (x.size, heights.size):
            raise click.UsageError(f"{option(name)}-mm: {x.size} values for {heights.size} of --height-mm")
        with np.errstate(divide="ignore", invalid="ignore"):  # a height of 0 is refused by name
            found |= {name: x / heights} if name in found else {}
    of_both = {name: x for name, x in given.items() if name not in (*plain, *si, *pushes[0], *pushes[1])}
    return found | {name: x for name, x in of_both.items() if x is not None}


def _knowledge(
    stiffness: "np.ndarray | None", log_sd: "np.ndarray | None", measured: str | None, in_si: bool, *, bounds: Any, event: Any
) -> Any:
    import dataclasses

    from slippulse_jax.inference.fit import fit
    from slippulse_jax.inference.knowledge import Knowledge
    from slippulse_jax.inference.model.models import front_of
    from slippulse_jax.inference.table.measurements import read_measurements

    prior = None
    if stiffness is not None and log_sd is not None:
        if log_sd.size not in (1, stiffness.size):
            raise ValueError(f"--log-sd: {log_sd.size} values for {stiffness.size} roots")
        prior = Knowledge.lognormal(stiffness, log_sd, in_si=in_si)
        prior = dataclasses.replace(prior, event=event or prior.event)
    if measured is None:
        return prior
    measurements = read_measurements(measured)
    if front_of(measurements).event == "sequence":
        if prior is not None:
            raise ValueError(f"{measured}: forces of a sequence, beside --stiffness: give one of the two")
        return Knowledge.from_fit(fit(measurements, bounds=bounds))
    if measurements.in_si != in_si:
        raise ValueError(f"{measured}: the measurements and the candidates must both be in SI form, or neither")
    return Knowledge.from_measurements(measurements, prior=prior, bounds=bounds, event=event)
