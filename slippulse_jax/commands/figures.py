"""`slippulse figures`."""

import json

import click


@click.command()
@click.argument("directory", type=click.Path(file_okay=False), default="figures")
@click.option("--format", "formats", multiple=True, type=click.Choice(["png", "pdf", "svg"]), help="Default: all three.")
@click.option("--figure", "names", multiple=True, type=click.Choice(["fig2", "fig3"]), help="Default: both.")
@click.option("--json", "as_json", is_flag=True, help="List the files as JSON.")
def figures(directory: str, formats: tuple[str, ...], names: tuple[str, ...], as_json: bool) -> None:
    """Draw the paper's Figures 2 and 3 into DIRECTORY, with their numbers as CSV."""
    from slippulse_jax.figures import FORMATS, draw_figures

    files = [str(path) for path in draw_figures(directory, formats or FORMATS, names or ("fig2", "fig3"))]
    click.echo(json.dumps({"files": files}) if as_json else "\n".join(files))
