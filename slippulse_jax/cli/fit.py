"""``slippulse fit``."""

import warnings
from typing import TYPE_CHECKING, Any

import click

from slippulse_jax.cli.shared import NOT_CONVERGED, as_json, choice, figure_path, print_json, refuse, save_figure
from slippulse_jax.inference.choices import Body, IntervalsBy, Loss, MeasuredEvent, Method, Sigma, Template

if TYPE_CHECKING:
    from slippulse_jax.inference.fit import FitResult


def _pairs(ctx: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, list[float]]:
    """``poisson=0.3,0.02`` as {"poisson": [0.3, 0.02]}."""
    found = {}
    for text in values:
        name, _, numbers = text.partition("=")
        try:
            found[name.strip()] = [float(x) for x in numbers.split(",")]
        except ValueError:
            raise click.BadParameter(f"{text!r}: NAME=NUMBER or NAME=NUMBER,NUMBER", ctx, parameter) from None
    return found


def _error(ctx: click.Context, parameter: click.Parameter, text: str | None) -> float | str | None:
    """A number, or a word that `fit` understands."""
    try:
        return text if text is None else float(text)
    except ValueError:
        return text


def _print_template(ctx: click.Context, parameter: click.Parameter, kind: Template | None) -> None:
    """Print a table to fill in, and no more."""
    if kind is not None:
        from slippulse_jax.inference.table.columns import template

        click.echo(template(kind), nl=False)
        ctx.exit()


class WithColumns(click.Command):
    """A command whose help lists the columns of its tables."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List them, with their usual units."""
        from slippulse_jax.inference.table.columns import COLUMNS, OF_GAUGES

        for name, columns in (("LENGTHS.CSV", COLUMNS), ("GAUGES.CSV", OF_GAUGES)):
            with formatter.section(f"Columns of {name}"):
                formatter.write_dl([(one.name(in_si=True), one.sentence.replace("`", "")) for one in columns.values()])


@click.command(cls=WithColumns)
@click.argument("csv", metavar="LENGTHS.CSV")
@choice(
    "--template",
    Template,
    "Print a table to fill in instead: lengths on sliders or on blocks, or the events of a block up to sliding.",
    callback=_print_template,
    is_eager=True,
    expose_value=False,
)
@click.option("--gauges", metavar="GAUGES.CSV", help="Slip and stress along the interface after arrest, fitted too.")
@click.option("--free", multiple=True, metavar="NAME", help="Parameter to fit; repeat for several. Default: stiffness.")
@click.option(
    "--bounds",
    type=float,
    nargs=2,
    metavar="LOW HIGH",
    help="Range of stiffness to search, in the unit of the result: Pa/m for data in SI with young_GPa, 1/m without, else k/K.",
)
@click.option(
    "--prior", multiple=True, callback=_pairs, metavar="NAME=MEAN,DEVIATION", help="Gaussian prior of a parameter, in SI."
)
@click.option("--range", "ranges", multiple=True, callback=_pairs, metavar="NAME=LOW,HIGH", help="Range to search, in SI.")
@click.option("--fix", multiple=True, callback=_pairs, metavar="NAME=VALUE", help="Hold a parameter at a value, in SI.")
@click.option("--each-specimen", multiple=True, metavar="NAME", help="Fit one value per specimen.")
@choice("--loss", Loss, "Loss function.")
@choice("--sigma", Sigma, "Take σ as given, or only the ratios of σ.")
@choice("--method", Method, "Levenberg-Marquardt, or optax's L-BFGS or Adam.")
@choice("--intervals", IntervalsBy, "Profile (chi-squared) or simulated intervals; auto simulates where chi-squared misleads.")
@choice(
    "--event",
    MeasuredEvent,
    "What was measured: domino = length of the first front, full = of the whole event, crack = of a crack-like front, "
    "sequence = forces up to sliding.",
)
@choice(
    "--body",
    Body,
    "The paper's slider; or a block under two-dimensional elasticity, the default where the table says where it is pushed.",
)
@click.option(
    "--model-error",
    callback=_error,
    metavar="VALUE|fitted",
    help="Of a sequence: what the model leaves out, in μF_N; or fitted, from how far the forces lie from the fit.",
)
@click.option("--seed", type=int, help="Seed of starts, bootstrap and sampling.")
@click.option("--request", metavar="FILE", help="TOML file of parameters and settings, or JSON of a fit to repeat.")
@click.option("--bootstrap", type=click.IntRange(min=2), metavar="COUNT", help="Refit this many simulated data sets.")
@click.option("--case", is_flag=True, help="Bootstrap by resampling the measurements.")
@click.option(
    "--posterior",
    type=click.IntRange(min=2),
    metavar="COUNT",
    help="Sample the posterior by NUTS, this many in each of 4 chains.",
)
@click.option("--figure", callback=figure_path, metavar="FILE", help="Draw data and fit; .png, .pdf or .svg.")
@click.option("--profiles", callback=figure_path, metavar="FILE", help="Draw a profile for each parameter, and residuals.")
@click.option("--corner", callback=figure_path, metavar="FILE", help="Draw the allowed region of each pair of parameters.")
@click.option("--gauge-figure", callback=figure_path, metavar="FILE", help="Draw slip and stress along the interface and fit.")
@click.option("--verbose", is_flag=True, help="Add the model, the ranges searched, all intervals, fitted inputs, correlations.")
@click.option("--methods", is_flag=True, help="Add a sentence for a paper, with these numbers.")
@as_json
@click.pass_context
def command(ctx: click.Context, csv: str, **options: Any) -> None:
    """Fit the interface to measured first precursors.

    LENGTHS.CSV has one precursor per line, or one event of a sequence, and units in its column names, listed below; without
    them lengths are in λc.

    GAUGES.CSV has one reading per line, by the label of the precursor. Then fit strength too: --free stiffness --free strength.

    A request file holds what the options say, as [parameters.poisson] prior = [0.3, 0.02], and loss, sigma, method, seed,
    max_steps. Options are added to it.

    Exit status: 0 also where the data do not determine a parameter, which the report says; 3 if the search did not converge.
    """
    from slippulse_jax.inference.fit import fit
    from slippulse_jax.inference.result.record import from_request, read_request
    from slippulse_jax.inference.table.measurements import MeasurementWarning, read_measurements

    _check(options)
    try:
        request = read_request(options["request"]) if options["request"] else {}
        measurements = read_measurements(csv, gauges=options["gauges"])
        settings = from_request(_with_options(request, options))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeasurementWarning)
            result = fit(measurements, bounds=options["bounds"] or None, **settings)
        for suspicion in result.suspicions:
            click.echo(f"check first: {suspicion}", err=True)
        drawn = {}
        if options["bootstrap"]:
            kind = "case" if options["case"] else "parametric"
            drawn["bootstrap"] = result.bootstrap(options["bootstrap"], kind=kind, seed=result.request["seed"])
        if options["posterior"]:
            drawn["posterior"] = result.posterior(samples=options["posterior"], seed=result.request["seed"])
    except (ValueError, OSError, ModuleNotFoundError) as error:
        refuse(error)
    if options["as_json"]:
        print_json(result.to_dict() | {name: one.to_dict() for name, one in drawn.items()})
    else:
        parts = [
            result.report(verbose=options["verbose"]),
            *([result.methods()] if options["methods"] else []),
            *map(str, drawn.values()),
        ]
        click.echo("\n\n".join(parts))
    _draw(result, drawn, options)
    if not result.converged:
        ctx.exit(NOT_CONVERGED)


def _draw(result: "FitResult", samples: dict[str, Any], options: dict[str, Any]) -> None:
    """Draw the requested pictures, with all samples in the corner plot."""
    if not any(options[name] for name in ("figure", "profiles", "gauge_figure", "corner")):
        return
    from slippulse_jax import plot

    pictures = {
        "figure": plot.fit,
        "profiles": plot.fit_profiles,
        "gauge_figure": plot.gauges,
        "corner": lambda found: plot.corner(found, samples),
    }
    for name, draw in pictures.items():
        if options[name] is not None:
            save_figure(draw(result), options[name])


def _check(options: dict[str, Any]) -> None:
    """Check that the options go together."""
    if options["gauge_figure"] and not options["gauges"]:
        raise click.UsageError("--gauge-figure needs --gauges")
    if options["case"] and not options["bootstrap"]:
        raise click.UsageError("--case says how --bootstrap draws: give --bootstrap COUNT too")
    for name in ("verbose", "methods"):
        if options["as_json"] and options[name]:
            raise click.UsageError(f"--{name} adds to the report, and --json prints none: give one of them")


def _with_options(request: dict[str, Any], options: dict[str, Any]) -> dict[str, Any]:
    """Add the options to the request."""
    from slippulse_jax.inference.result.record import SETTINGS

    parameters = {name: dict(settings) for name, settings in request.get("parameters", {}).items()}
    for name in options["free"]:
        parameters.setdefault(name, {})
    if not parameters:
        parameters["stiffness"] = {}
    for name, values in options["fix"].items():
        if len(values) != 1:
            raise ValueError(f"--fix {name}: one value is needed")
        parameters.setdefault(name, {})["value"] = values[0]
    for key, given in (("prior", options["prior"]), ("bounds", options["ranges"])):
        for name, values in given.items():
            parameters.setdefault(name, {})[key] = values
    for name in options["each_specimen"]:
        parameters.setdefault(name, {})["each"] = "specimen"
    settings = {name: options[name] for name in SETTINGS if options.get(name) is not None}
    return {**request, **settings, "parameters": parameters}
