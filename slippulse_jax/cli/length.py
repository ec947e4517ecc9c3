"""``slippulse length``."""

import math
from typing import TYPE_CHECKING, Any

import click

from slippulse_jax.cli.shared import (
    Grouped,
    as_json,
    contacts_of_block,
    one_form,
    option,
    print_json,
    push_control,
    refuse,
    residual_strength,
    right_end,
    slider_options,
)
from slippulse_jax.experiments import ALL

if TYPE_CHECKING:
    from slippulse_jax.slider import Slider

UNPRESSED = {"normal_stiffness": None, "friction": None, "contact_law": "amontons", "top": "free"}
"""Defaults of the options of a block."""
OF_EXPERIMENT = {
    "height": ("height_mm", 1e-3), "block_length": ("block_length_mm", 1e-3), "young": ("young_gpa", 1e9),
    "correlation_length": ("correlation_length_um", 1e-6), "areal_stiffness": ("areal_stiffness", 1), "poisson": ("poisson", 1),
    "friction": ("friction", 1), "push_height": ("push_height", None), "push_width": ("push_width", None),
    "machine_stiffness": ("machine", None), "block_width": ("machine", None),
}  # fmt: skip
"""Option for each number of an experiment, and its unit in SI; None where it is over others."""


@click.command(
    cls=Grouped,
    groups={
        "Slider, over λc": "height stiffness poisson",
        "Slider, in SI": "height-mm correlation-length-um areal-stiffness young-gpa experiment",
        "Contacts": "residual-strength threshold-scatter visible draws seed",
        "Ends": "right sites block-length-mm machine",
        "Pushed block": "push-height push-width push-control friction normal-stiffness contact-law top",
        "Output": "json help",
    },
)
@click.option("--experiment", type=click.Choice(list(ALL)), metavar="NAME", help=f"Take a published set-up: {', '.join(ALL)}.")
@slider_options(required=False)
@click.option("--height-mm", type=float, metavar="MM", help="Height of the slider.")
@click.option("--correlation-length-um", type=float, metavar="UM", help="Correlation length λc.")
@click.option("--areal-stiffness", type=float, metavar="PA/M", help="Interfacial shear stiffness per area, k/λc².")
@click.option("--young-gpa", type=float, metavar="GPA", help="Young's modulus.")
@residual_strength(float)
@click.option(
    "--threshold-scatter", type=float, metavar="s", help="Draw thresholds, normal of this standard deviation over the mean."
)
@click.option(
    "--visible", type=float, metavar="λc", help="Least extent of an event that is noticed; a tenth of the height by default."
)
@click.option("--draws", type=click.IntRange(min=2), default=200, show_default=True, help="Number of draws of the thresholds.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the draws.")
@right_end
@click.option("--sites", type=click.IntRange(min=2), metavar="N", help="Number of contacts of a chain with a right end.")
@click.option("--block-length-mm", type=float, metavar="MM", help="Length of the body; its end is free by default.")
@click.option("--machine", type=float, metavar="M/K", help="Stiffness of the machine per width, over E; infinite by default.")
@click.option("--push-height", type=float, metavar="h/H", help="Push a two-dimensional elastic block above this height.")
@click.option("--push-width", type=float, metavar="w/H", help="Height of the pusher, whose middle is then at --push-height.")
@push_control
@contacts_of_block(float)
@as_json
def command(
    experiment: str | None,
    right: str,
    sites: int | None,
    push_control: Any,
    residual_strength: float | None,
    threshold_scatter: float | None,
    visible: float | None,
    draws: int,
    seed: int,
    as_json: bool,
    **given: Any,
) -> None:
    """Compute the first precursor of one slider or pushed block.

    Give Poisson's ratio and either --height and --stiffness or the four SI values. With --experiment give only the values that
    its source lacks; other values replace those of the source.
    """
    import jax

    if visible is not None and threshold_scatter is None:
        raise click.UsageError("--visible is of contacts that differ: give --threshold-scatter too")
    if experiment is not None:
        given = _completed(experiment, given)
    pressed = {name: given.pop(name) for name in UNPRESSED}
    _check(given, pressed != UNPRESSED, push_control is not None, sites is not None or right != "semi-infinite")
    beside = ("poisson", "block_length_mm", "machine", "push_height", "push_width")
    poisson, block_length_mm, machine, push_height, push_width = (given.pop(name) for name in beside)
    si = "height_mm", "correlation_length_um", "areal_stiffness", "young_gpa"
    form = one_form(given, "slider", ("height", "stiffness"), si)
    length = sites if block_length_mm is None else _in_sites(block_length_mm, sites, given["correlation_length_um"])
    with jax.enable_x64(True):
        from slippulse_jax.interface import Interface
        from slippulse_jax.slider import Slider

        try:
            interface = None if residual_strength is None else Interface(residual_strength=residual_strength)
            slider = (Slider if "height" in form and "stiffness" in form else Slider.from_material)(**form, poisson=poisson)
            numbers = slider.height, slider.stiffness, slider.poisson
            asked = {"height": float(slider.height), "stiffness": float(slider.stiffness), "poisson": poisson}
            asked["residual_strength"] = residual_strength
            if push_height is None:
                end: Any = None if right == "semi-infinite" else right
                one = Slider(*numbers, length=length, right=end, machine=machine)
                body, result, text = one, asked | _of_slider(one, interface), _text
            else:
                push = {"push_height": push_height, "push_width": push_width, "push_control": push_control or "displacement"}
                pressed |= {"length": None if length is None else round(length), "machine": machine}
                body = _block(slider, push, pressed)
                result, text = asked | push | pressed | _of_block(body, slider, interface), _block_text
            if threshold_scatter is not None:
                how = {
                    "threshold_scatter": threshold_scatter,
                    "visible": 0.1 * asked["height"] if visible is None else visible,
                    "draws": draws,
                    "seed": seed,
                }
                result["scattered"] = how | _of_draws(body, interface, how)
        except ValueError as error:
            refuse(error)
    if "correlation_length" in form:
        result["length_mm"] = result["length"] * form["correlation_length"] * 1e3
    if experiment is not None:
        result |= {"experiment": experiment, "source": ALL[experiment].cite()}
    if as_json:
        print_json(result)
    else:
        click.echo(text(result))
        if "scattered" in result:
            click.echo(_draws_text(result["scattered"]))


def _draws_text(found: dict[str, Any]) -> str:
    """The lines about contacts that differ."""
    several, spread = f"{found['low']:.5g} to {found['high']:.5g}", found["spread"]
    mean = f"{found['length']:.5g}" + ("" if spread is None else f" ± {spread:.2g}") + " λc, mean and spread; "
    return "\n".join(
        [
            f"thresholds that scatter by {100 * found['threshold_scatter']:g} %, {found['draws']} draws of seed {found['seed']}"
            f"; events visible from {found['visible']:g} λc on:",
            f"ℓ   = {mean}median {found['median']:.5g}, 68 % {several}",
            f"U   = {found['load']:.5g} u_s as it begins; {100 * found['touching_the_edge']:.0f} % touch the edge; "
            f"{found['events_before']:.2g} events before it that nobody sees",
        ]
    )


def _check(given: dict[str, Any], is_pressed: bool, is_controlled: bool, has_end: bool) -> None:
    """Check that the options go together."""
    if given["poisson"] is None:
        raise click.MissingParameter(param_hint="'--poisson'", param_type="option")
    if given["push_height"] is None and (is_controlled or given["push_width"] is not None):
        raise click.UsageError("--push-width and --push-control describe a push: give --push-height too")
    if given["push_height"] is None and is_pressed:
        raise click.UsageError("--friction, --normal-stiffness, --contact-law and --top are a block's: give --push-height too")
    if given["push_height"] is not None and has_end:
        raise click.UsageError("--sites and --right are a slider's: the end of a pushed block is free, at --block-length-mm")


def _completed(experiment: str, given: dict[str, Any]) -> dict[str, Any]:
    """Add the numbers of an experiment to the options that are given."""
    source = ALL[experiment]
    known = {name: getattr(source, name) for name in OF_EXPERIMENT if name not in source.lacks}
    found = {own: known[name] / unit for name, (own, unit) in OF_EXPERIMENT.items() if unit and name in known}
    found |= {own: value for own, value in given.items() if value is not None}
    height = found.get("height_mm", math.nan) * 1e-3
    found = {name: known[name] / height for name in ("push_height", "push_width") if name in known} | found
    if "young_gpa" in found and {"machine_stiffness", "block_width"} <= known.keys():
        found = {"machine": known["machine_stiffness"] / known["block_width"] / (found["young_gpa"] * 1e9)} | found
    if missing := [name for name in source.lacks if OF_EXPERIMENT[name][0] not in found]:
        told = ", ".join(f"{name} ({option(OF_EXPERIMENT[name][0])})" for name in missing)
        raise click.UsageError(f"{experiment} lacks {told}: give these options too")
    return given | found


def _in_sites(block_length_mm: float, sites: int | None, correlation_length_um: float | None) -> float:
    """Length of the block over λc."""
    if sites is not None:
        raise click.UsageError("--sites and --block-length-mm both say where the block ends: give one")
    if correlation_length_um is None:
        raise click.UsageError("--block-length-mm belongs to the SI form of the slider; give --sites")
    return block_length_mm / (correlation_length_um * 1e-3)


def _of_slider(slider: "Slider", interface: Any) -> dict[str, Any]:
    import jax

    from slippulse_jax.base.status import NotConverged, Outcome
    from slippulse_jax.bodies.modes import lattice_modes
    from slippulse_jax.front.arrest import MOST_BREAKS, arrest

    ended, load = jax.jit(  # one program: op by op JAX would compile sixty
        lambda slider, interface: (arrest(slider, interface), lattice_modes(slider).load)
    )(slider, interface)
    status = Outcome(int(ended.status))
    if status is Outcome.LIMIT:
        raise NotConverged(f"{status.message}: {MOST_BREAKS}")
    if status is Outcome.INVALID:
        refuse(status.message)
    return {
        "right": slider.right,
        "sites": None if slider.length is None else float(slider.length),
        "machine": None if slider.machine is None else float(slider.machine),
        "length": float(ended.length),
        "contacts_broken": int(ended.contacts_broken),
        "load": float(load),
        "edge_stress": float(ended.edge_stress),
        "status": status.name.lower(),
        "message": status.message,
    }


def _block(slider: "Slider", push: dict[str, Any], contacts: dict[str, Any]) -> Any:
    from slippulse_jax.block import Block, Push

    return Block(slider.height, slider.stiffness, slider.poisson, Push(*push.values()), **contacts)


def _of_block(block: Any, slider: "Slider", interface: Any) -> dict[str, Any]:
    from slippulse_jax.exact.front import exact_length
    from slippulse_jax.precursor import precursor_length

    lengths = {"length": precursor_length(block, interface), "length_of_slider": exact_length(slider, interface)}
    return {"sites": block.sites, **{name: float(x) for name, x in lengths.items()}}


def _of_draws(body: Any, interface: Any, how: dict[str, Any]) -> dict[str, Any]:
    """What would be noticed on contacts that differ, in numbers."""
    import numpy as np

    from slippulse_jax.events.scattered import scattered

    found = scattered(body, interface, **how)
    length, left = np.asarray(found.length), np.asarray(found.left)
    low, middle, high = np.quantile(length, [0.16, 0.5, 0.84], method="inverted_cdf").tolist()
    return {
        "length": float(length.mean()), "spread": float(length.std(ddof=1)) if np.isfinite(length).all() else None,
        "low": low, "median": middle, "high": high, "load": float(found.load.mean()), "force": float(found.force.mean()),
        "touching_the_edge": float((left == 0).mean()), "events_before": float(found.before.mean()),
    }  # fmt: skip


def _block_text(result: dict[str, Any]) -> str:
    where = f"above {result['push_height']:g} H"
    if result["push_width"] is not None:
        where = f"over {result['push_width']:g} H about {result['push_height']:g} H"
    length = f"{result['length']:.6g} λc{_in_mm(result)}"
    if not result["length"]:
        length = "none: the neighbour of the first contact holds"
    if math.isnan(result["length"]):  # any other reason is an error
        length = "none: the block lifts off"
    if math.isinf(result["length"]):
        length = "none: the front runs through the block"
    normal, friction = result["normal_stiffness"], result["friction"]
    pressed = "" if normal is None else f"; k_n/k = {normal:g}"
    pressed += "" if friction is None else f"; thresholds of μ = {friction:g} times the pressure"
    ends = f"; {result['sites']} contacts long" * bool(result["sites"])
    ends += f"; machine M/K = {result['machine']:g}" if result["machine"] else ""
    of_slider = f"{result['length_of_slider']:.6g} λc" if math.isfinite(result["length_of_slider"]) else "none"
    lines = [
        f"block: {_numbers(result)}{ends}; pushed {where}, {result['push_control']} held{pressed}",
        f"ℓ   = {length}",
        f"      {of_slider} with the slider of the same contacts",
        *([f"numbers of {result['experiment']}: {result['source']}"] if "experiment" in result else []),
    ]
    return "\n".join(lines)


def _text(result: dict[str, Any]) -> str:
    count = f"Λ   = {result['contacts_broken']} λc"
    driven = "machine" if result["machine"] else "left edge"
    lines = [
        f"slider: {_numbers(result)}; right end {result['right']}"
        + (f", {result['sites']:g} sites" if result["sites"] else "")
        + (f"; machine M/K = {result['machine']:g}" if result["machine"] else ""),
        f"ℓ   = {result['length']:.6f} λc{_in_mm(result)}" if math.isfinite(result["length"]) else "ℓ   = none",
        f"{count:20s} whole contacts broken",
        f"U0  = {result['load']:.6g} u_s".ljust(20) + f" displacement of the {driven} at nucleation",
        f"status: {result['message']}",
    ]
    return "\n".join(lines)


def _numbers(result: dict[str, Any]) -> str:
    kept = "" if result["residual_strength"] is None else f", r = {result['residual_strength']:g}"
    return f"H/λc = {result['height']:.6g}, k/K = {result['stiffness']:.6g}, ν = {result['poisson']:g}{kept}"


def _in_mm(result: dict[str, Any]) -> str:
    return f"  ({result['length_mm']:.6g} mm)" if "length_mm" in result else ""
