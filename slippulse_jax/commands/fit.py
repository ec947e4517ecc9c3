"""``slippulse fit``."""

from pathlib import Path

import click

from slippulse_jax.commands.shared import NOT_CONVERGED, as_json, figure_path, print_json, refuse, save_figure


@click.command()
@click.argument("csv", metavar="LENGTHS.CSV")
@click.option("--figure", callback=figure_path, metavar="FILE", help="Draw data and fit; .png, .pdf or .svg.")
@click.option(
    "--bounds",
    type=float,
    nargs=2,
    metavar="LOW HIGH",
    help="Range of stiffness to search, in the unit of the result: Pa/m for data in SI with young_GPa, 1/m without, else k/K.",
)
@as_json
@click.pass_context
def command(ctx: click.Context, csv: str, figure: Path | None, bounds: tuple[float, float] | None, as_json: bool) -> None:
    """Fit the interface stiffness to measured first-precursor lengths.

    LENGTHS.CSV has one length a line and units in its column names: height_mm, correlation_length_um, poisson, length_mm,
    length_sigma_mm (and young_GPa for a result in Pa/m), or in units of λc height, poisson, length, length_sigma. Optional:
    specimen, provenance.

    Exit status: 0 also when the data cannot tell the stiffness, which is then said; 3 if the search did not converge.
    """
    from slippulse_jax.inference.fit import fit
    from slippulse_jax.inference.measurements import read_measurements

    try:
        result = fit(read_measurements(csv), bounds=bounds)
    except ValueError as error:
        refuse(error)
    if as_json:
        print_json(result.to_dict())
    else:
        click.echo(result.report())
    if figure is not None:
        save_figure(result.plot(), figure)
        click.echo(f"figure written to {figure}", err=True)
    if not result.converged:
        ctx.exit(NOT_CONVERGED)
