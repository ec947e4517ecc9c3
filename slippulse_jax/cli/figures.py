"""``slippulse figures``."""

import click

from slippulse_jax.base.files import FIGURE_FORMATS
from slippulse_jax.cli.shared import as_json, print_json

FIGURES = ("fig2", "fig3")


@click.command()
@click.argument("directory", type=click.Path(file_okay=False), default="figures")
@click.option(
    "--format",
    "formats",
    multiple=True,
    type=click.Choice(FIGURE_FORMATS),
    default=FIGURE_FORMATS,
    help="Write this format; all three by default.",
)
@click.option(
    "--figure", "names", multiple=True, type=click.Choice(FIGURES), default=FIGURES, help="Draw this figure; both by default."
)
@as_json
def command(directory: str, formats: tuple[str, ...], names: tuple[str, ...], as_json: bool) -> None:
    """Draw the paper's Figures 2 and 3 into DIRECTORY, with CSV."""
    from slippulse_jax.paper.figures import draw_figures

    files = [str(path) for path in draw_figures(directory, formats, names)]
    if as_json:
        print_json({"files": files})
    else:
        click.echo("\n".join(files))
