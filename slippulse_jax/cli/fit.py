"""``slippulse fit``."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import slippulse_jax
from slippulse_jax.base.choices import did_you_mean
from slippulse_jax.cli.shared import (
    NOT_CONVERGED,
    Grouped,
    as_json,
    choice,
    figure_path,
    number,
    print_json,
    refuse,
    save_figure,
)
from slippulse_jax.inference.choices import Body, IntervalsBy, Loss, MeasuredEvent, Method, Sigma, Template

if TYPE_CHECKING:
    from slippulse_jax.inference.fit import FitResult
    from slippulse_jax.inference.table.measurements import Measurements


def _pairs(ctx: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, list[float]]:
    """``poisson=0.3,0.02`` as {"poisson": [0.3, 0.02]}."""
    found = {}
    for text in values:
        name, _, numbers = text.partition("=")
        try:
            found[name.strip()] = [number(x) for x in numbers.split(",")]
        except ValueError:
            raise click.BadParameter(f"{text!r}: NAME=NUMBER or NAME=NUMBER,NUMBER", ctx, parameter) from None
    return found


def _error(ctx: click.Context, parameter: click.Parameter, text: str | None) -> float | str | None:
    """A number, or a word that `fit` understands."""
    try:
        return text if text is None else number(text)
    except ValueError:
        return text


def _print_template(ctx: click.Context, parameter: click.Parameter, kind: Template | None) -> None:
    """Print a table to fill in, and no more."""
    if kind is not None:
        from slippulse_jax.inference.table.columns import template

        click.echo(template(kind), nl=False)
        ctx.exit()


def _print_columns(ctx: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    """Print the columns of both tables, and no more."""
    if wanted:
        from slippulse_jax.inference.table.columns import COLUMNS, OF_GAUGES

        formatter = ctx.make_formatter()
        for name, columns in (("LENGTHS.CSV", COLUMNS), ("GAUGES.CSV", OF_GAUGES)):
            with formatter.section(f"Columns of {name}"):
                rows = [(one.name(in_si=True), one.sentence.replace("`", "")) for one in columns.values()]
                formatter.write_dl(rows, col_max=32)
        click.echo(formatter.getvalue(), nl=False)
        ctx.exit()


def _example(ctx: click.Context, parameter: click.Parameter, name: str | None) -> Path | None:
    """Find the table of a worked fit in wheel or source."""
    if name is None:
        return None
    package = Path(slippulse_jax.__file__).parent
    tables = {one.parent.name: one for home in (package.parent, package) for one in home.glob("fit_examples/*/lengths.csv")}
    if name not in tables:
        known = ", ".join(sorted(tables)) or "none is installed"
        raise click.BadParameter(f"{name!r}: one of {known}{did_you_mean(name, tables)}", ctx, parameter)
    return tables[name]


@click.command(
    cls=Grouped,
    groups={
        "Input": "template columns example gauges request",
        "What is fitted": "free bounds range prior fix each-specimen",
        "Body and lengths": "body event model-error",
        "Errors and intervals": "loss sigma intervals bootstrap case posterior",
        "Output": "verbose methods json figure profiles corner gauge-figure",
        "Running": "method seed help",
    },
)
@click.argument("csv", metavar="[LENGTHS.CSV]", required=False)
@choice(
    "--template",
    Template,
    "Print a table to fill in, for a slider, block or sequence.",
    callback=_print_template,
    is_eager=True,
    expose_value=False,
    metavar="KIND",
)
@click.option(
    "--columns",
    is_flag=True,
    callback=_print_columns,
    is_eager=True,
    expose_value=False,
    help="List the columns of LENGTHS.CSV and GAUGES.CSV.",
)
@click.option("--example", callback=_example, metavar="NAME", help="Fit the table of a worked fit, such as pmma_block.")
@click.option("--gauges", metavar="GAUGES.CSV", help="Fit slip and stress along the interface after arrest too.")
@click.option("--request", metavar="FILE", help="Read parameters and settings from TOML, or from a fit's JSON.")
@click.option(
    "--free",
    multiple=True,
    metavar="NAME",
    help="Fit this parameter; repeat for several. By default stiffness, and what a sequence needs.",
)
@click.option(
    "--bounds", type=float, nargs=2, metavar="LOW HIGH", help="Stiffness range: Pa/m in SI, 1/m without young_GPa, else k/K."
)
@click.option(
    "--range",
    "ranges",
    multiple=True,
    callback=_pairs,
    metavar="NAME=LOW,HIGH",
    help="Search this range of a parameter, in SI.",
)
@click.option(
    "--prior", multiple=True, callback=_pairs, metavar="NAME=MEAN,DEVIATION", help="Give a parameter a Gaussian prior, in SI."
)
@click.option("--fix", multiple=True, callback=_pairs, metavar="NAME=VALUE", help="Hold a parameter at a value, in SI.")
@click.option("--each-specimen", multiple=True, metavar="NAME", help="Fit one value of a parameter per specimen.")
@choice("--body", Body, "Body; by default a block where the table has push_height.")
@choice(
    "--event",
    MeasuredEvent,
    "What the lengths are: domino = first front, full = whole event, crack = crack-like front; sequence = events up to "
    "sliding.",
    metavar="KIND",
)
@click.option(
    "--model-error",
    callback=_error,
    metavar="VALUE|fitted",
    help="Error of the model of a sequence, in μF_N; or fit it to the scatter of the forces.",
)
@choice("--loss", Loss, "Loss function; student is robust to outliers.")
@choice("--sigma", Sigma, "Take σ as given, or only the ratios of σ.")
@choice(
    "--intervals",
    IntervalsBy,
    "profile (chi-squared), calibrated (simulated), or auto: simulated where chi-squared misleads.",
    metavar="KIND",
)
@click.option("--bootstrap", type=click.IntRange(min=2), metavar="COUNT", help="Refit this many simulated data sets.")
@click.option("--case", is_flag=True, help="Resample the measurements in --bootstrap instead of simulating.")
@click.option("--posterior", type=click.IntRange(min=2), metavar="COUNT", help="Sample the posterior by NUTS, in 4 chains.")
@click.option("--verbose", is_flag=True, help="Add the model, ranges, all intervals, inputs and correlations.")
@click.option("--methods", is_flag=True, help="Add a sentence for a paper.")
@click.option("--figure", callback=figure_path, metavar="FILE", help="Draw data and fit: .png, .pdf or .svg.")
@click.option("--profiles", callback=figure_path, metavar="FILE", help="Draw the profile of each parameter, and residuals.")
@click.option("--corner", callback=figure_path, metavar="FILE", help="Draw the allowed region of each pair of parameters.")
@click.option("--gauge-figure", callback=figure_path, metavar="FILE", help="Draw slip and stress along the interface.")
@choice("--method", Method, "Search by Levenberg-Marquardt, or by optax's L-BFGS or Adam.")
@click.option("--seed", type=int, help="Seed of starts, bootstrap and sampling.")
@as_json
@click.pass_context
def command(ctx: click.Context, csv: str | None, example: Path | None, **options: Any) -> None:
    """Fit the interface stiffness to measured precursor lengths.

    LENGTHS.CSV, or - for standard input, has one precursor per line, or one event of a sequence, and units in its column
    names. Readings of gauges need --free stiffness --free strength. A request has [parameters.poisson] prior = [0.3, 0.02],
    and loss, sigma, method, seed, max_steps; options are added to it.

    Exit status: 0 also where the data do not determine a parameter; 3 if the search did not converge.
    """
    from slippulse_jax.inference.fit import fit
    from slippulse_jax.inference.result.record import from_request, read_request
    from slippulse_jax.inference.table.measurements import MeasurementWarning, read_measurements

    _check({**options, "csv": csv})
    table = _table(ctx, csv, example)
    try:
        request = read_request(options["request"]) if options["request"] else {}
        measurements = read_measurements(table, gauges=options["gauges"])
        settings = from_request(_with_options(request, options, measurements))
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


def _table(ctx: click.Context, csv: str | None, example: Path | None) -> str | Path:
    """The table to fit, of the user or of an example."""
    if csv is not None and example is not None:
        raise click.UsageError(f"--example {example.parent.name} and {csv} are two tables to fit: give one", ctx)
    if csv is None and example is None:
        raise click.UsageError("Missing argument 'LENGTHS.CSV': give a table, or --example pmma_block", ctx)
    return csv or example  # pyright: ignore[reportReturnType]


def _check(options: dict[str, Any]) -> None:
    """Check that the options go together."""
    if [options["csv"], options["gauges"], options["request"]].count("-") > 1:
        raise click.UsageError("- is standard input, which can be read once: give a file for the other")
    if options["gauge_figure"] and not options["gauges"]:
        raise click.UsageError("--gauge-figure needs --gauges")
    if options["case"] and not options["bootstrap"]:
        raise click.UsageError("--case says how --bootstrap draws: give --bootstrap COUNT too")
    for name in ("verbose", "methods"):
        if options["as_json"] and options[name]:
            raise click.UsageError(f"--{name} adds to the report, and --json prints none: give one of them")


def _with_options(request: dict[str, Any], options: dict[str, Any], m: "Measurements") -> dict[str, Any]:
    """Add the options to the request."""
    from slippulse_jax.inference.model.models import model_of
    from slippulse_jax.inference.parameters import default_free
    from slippulse_jax.inference.result.record import SETTINGS

    parameters = {name: dict(settings) for name, settings in request.get("parameters", {}).items()}
    for name in options["free"]:
        parameters.setdefault(name, {})
    named = bool(parameters)
    for name, values in options["fix"].items():
        if len(values) != 1:
            raise ValueError(f"--fix {name}: one value is needed")
        parameters.setdefault(name, {})["value"] = values[0]
    for key, given in (("prior", options["prior"]), ("bounds", options["ranges"])):
        for name, values in given.items():
            parameters.setdefault(name, {})[key] = values
    for name in options["each_specimen"]:
        parameters.setdefault(name, {})["each"] = "specimen"
    if parameters and not named:
        front = model_of(m, options.get("event"), options.get("body"))
        parameters = dict.fromkeys(default_free(m, options["fix"], front), {}) | parameters
    settings = {name: options[name] for name in SETTINGS if options.get(name) is not None}
    return {**request, **settings, "parameters": parameters or None}
