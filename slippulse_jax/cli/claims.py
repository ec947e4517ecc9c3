"""``slippulse claims``."""

from pathlib import Path

import click

from slippulse_jax.cli.shared import as_json, page_path, print_json, refuse


@click.command()
@click.argument("numbers", nargs=-1, metavar="[C1 C2 …]")
@click.option("--write", callback=page_path, metavar="PAGE.md", help="Also write the documentation page.")
@as_json
def command(numbers: tuple[str, ...], write: Path | None, as_json: bool) -> None:
    """Measure the paper's claims, and report whether each holds."""
    from slippulse_jax.base.files import write_atomically
    from slippulse_jax.paper.claims import examine, page

    results = []
    try:
        for result in examine(list(numbers) or None):
            results.append(result)
            if not as_json:
                click.echo(f"{result.number}  {result.says}\n    holds if {result.criteria}")
                click.echo(f"    {result.measured}\n    {result.verdict.upper()}\n")
    except ValueError as error:
        refuse(error)
    if as_json:
        print_json({"claims": [result._asdict() for result in results]})
    if write is not None:
        write_atomically(write, page(results).encode())
