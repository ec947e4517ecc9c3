"""``slippulse sweep``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from slippulse_jax.base.choices import Control
from slippulse_jax.cli.shared import (
    INCOMPLETE,
    VALUES,
    Grouped,
    as_json,
    choice,
    contacts_of_block,
    figure_path,
    last_words,
    option,
    print_json,
    refuse,
    residual_strength,
    right_end,
    save_figure,
    table_path,
    whole,
)

if TYPE_CHECKING:
    import xarray as xr


def _pair(ctx: click.Context, parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    try:
        index, count = map(whole, value.split("/"))
    except ValueError:
        raise click.BadParameter(f"{value!r} is not index/number, such as 0/4", ctx, parameter) from None
    return index, count


@click.command(
    cls=Grouped,
    groups={
        "Slider": "height stiffness poisson prestress threshold-slope residual-strength width right sites",
        "Pushed block": "push-height push-width push-control friction normal-stiffness contact-law top",
        "Output": "outputs points out figure json",
        "Store and workers": "store resume chunk share scheduler help",
    },
)
@click.option("--height", type=VALUES, required=True, metavar="H/λc", help="Height of the slider, such as 10:50:41.")
@click.option("--stiffness", type=VALUES, required=True, metavar="k/K", help="Contact stiffness, such as 1e-3:0.1:60:log.")
@click.option("--poisson", type=VALUES, required=True, metavar="ν", help="Poisson's ratio.")
@click.option("--prestress", type=VALUES, metavar="φ", help="Prestress of the contacts, in σ_s.")
@click.option("--threshold-slope", type=VALUES, metavar="ε", help="Threshold gradient, in σ_s per site.")
@residual_strength(VALUES)
@click.option("--width", type=VALUES, metavar="w", help="Width of the smooth break rule, for smooth_length.")
@click.option("--push-height", type=VALUES, metavar="h/H", help="Height of the push, for block_precursor_length.")
@click.option(
    "--push-width", type=VALUES, metavar="w/H", help="Height of the pusher; everything above --push-height by default."
)
@choice(
    "--push-control",
    Control,
    "Hold the displacement (default) or the force during an event.",
    default="displacement",
)
@contacts_of_block(VALUES)
@click.option("--outputs", default="length,status", show_default=True, metavar="A,B", help="Compute these at each point.")
@click.option("--points", is_flag=True, help="Pair the values as points, instead of combining all of them.")
@right_end
@click.option("--sites", type=click.IntRange(min=2), metavar="N", help="Number of contacts of a chain with a right end.")
@click.option("--store", metavar="FOLDER", help="Write the result there as it is computed; s3://… and such work too.")
@click.option("--resume/--no-resume", default=True, show_default=True, help="Resume the sweep in --store, if there is one.")
@click.option("--chunk", type=click.IntRange(min=1), metavar="N", help="Largest number of points per chunk or task.")
@click.option("--share", callback=_pair, metavar="I/N", help="Compute share I of N only, from 0, into the store.")
@click.option("--scheduler", metavar="ADDRESS", help="Compute on the workers of this Dask scheduler: tcp://node0:8786.")
@click.option("--out", callback=table_path, metavar="FILE", help="Write the result to .csv or .nc.")
@click.option("--figure", callback=figure_path, metavar="FILE", help="Draw the first output as a map or a family of lines.")
@as_json
def command(
    outputs: str, store: str | None, scheduler: str | None, out: Path | None, figure: Path | None, as_json: bool, **request: Any
) -> None:
    """Compute first precursors over ranges, as CSV or into a resumable store.

    Each value is a number, a list a,b,c or a range first:last:count[:log].

    \b
    Names for --outputs:
      length, exact_length, smooth_length, block_precursor_length,
      contacts_broken, status, exact_status,
      edge_stress, nucleation_load, b, slow_decay_length,
      gradients (dlength_dheight …),
      theory (length_eq25, length_eq58, length_frozen, length_continuum,
        length_envelope, length_macroscopic, runaway_prestress),
      validity (is_one_domino, is_continuous, is_frozen, is_far_from_edge).
    """  # noqa: D301  (click's mark of a paragraph that keeps its lines)
    share = request["share"]
    if store is None and (share or (request["chunk"] and not scheduler)):
        raise click.UsageError("--share and --chunk go with --store")
    if share and scheduler:
        raise click.UsageError("--share is for processes without a scheduler: leave it out with --scheduler")
    if figure is not None:
        _check_drawable(request, store)
    found = _sweep(store, **request, outputs=outputs.split(","), client=scheduler)
    if not found.attrs["complete"]:
        done = "share {}/{} is done".format(*share)
        if out is not None or figure is not None:
            refuse(f"{done}; for the whole, other shares of {store} are not there yet", INCOMPLETE)
        click.echo(f"{done}; other shares of {store} are not there yet", err=True)
        if not as_json:
            return
    _hand_over(found, out, figure, as_json, store)


def _check_drawable(request: dict[str, Any], store: str | None) -> None:
    """Refuse a figure that could not be drawn, before anything is computed."""
    from slippulse_jax.plot.maps import not_drawn

    sizes = {name: one.size for name, one in request.items() if getattr(one, "size", 1) > 1}
    axes = sorted(sizes, key=lambda name: sizes[name])
    if request["points"]:
        raise click.UsageError(not_drawn([], "leave out --points"))
    if len(axes) > 2:
        first = {name: repr(float(request[name][0])) for name in axes[:-2]}
        chosen = " ".join(f"{option(name)} {value}" for name, value in first.items())
        selected = ", ".join(f"{name}={value}" for name, value in first.items())
        stored = 'write --out FILE.nc and draw sp.plot.sweep(xarray.open_dataset("FILE.nc")'
        if store is not None:
            stored = f'draw sp.plot.sweep(sp.open_sweep("{store}")'
        also = f"or {stored}.sel({selected})) in Python"
        raise click.UsageError(not_drawn(axes, f"give one value of the others, such as {chosen}; {also}"))
    if not axes:
        raise click.UsageError(not_drawn(axes, "give several values of a parameter, such as --height 10:50:41"))


def _sweep(store: str | None, **request: Any) -> "xr.Dataset":
    """Run the sweep and turn its errors into messages and exit statuses."""
    from slippulse_jax.sweeps.run import sweep

    if store is not None:
        last_words.append(_kept(store))
    try:
        found = sweep(store=store, **request)
    except (ValueError, ModuleNotFoundError) as error:
        refuse(error)
    except OSError as error:
        if store is None:
            raise
        refuse(f"{error}; {_kept(store)}", INCOMPLETE)
    return found


def _kept(store: str) -> str:
    return f"what was computed is kept in {store}; the same command resumes it"


def _hand_over(found: "xr.Dataset", out: Path | None, figure: Path | None, as_json: bool, store: str | None) -> None:
    from slippulse_jax.sweeps import dataset

    if out is not None:
        dataset.write(found, out)
    if figure is not None:
        from matplotlib.figure import Figure

        from slippulse_jax import plot
        from slippulse_jax.plot import style

        with style.use():
            picture = Figure(figsize=(4.6, 3.2))
            try:
                plot.sweep(found, ax=picture.subplots())
            except ValueError as error:
                refuse(error)
            save_figure(picture, figure)
    if as_json:
        print_json(dataset.as_json(found, values=store is None and out is None))
    elif store is None and out is None:
        dataset.write_csv(found, sys.stdout)
    else:
        click.echo(dataset.summary(found, str(out or store)))
