"""Models by body and event, and their choice by a table."""

import functools

import numpy as np

from slippulse_jax.base.domains import check_choice
from slippulse_jax.inference.choices import Body, MeasuredEvent
from slippulse_jax.inference.model.block import BlockEvent
from slippulse_jax.inference.model.crack import CrackFront
from slippulse_jax.inference.model.front import (
    Front,
)
from slippulse_jax.inference.model.scattered import ScatteredBlock, ScatteredEvent
from slippulse_jax.inference.model.series import BlockSeries
from slippulse_jax.inference.model.slider import FirstFront, WholeEvent
from slippulse_jax.inference.table.measurements import Measurements

_EVERY = (FirstFront, WholeEvent, CrackFront, BlockEvent, BlockSeries, ScatteredEvent, ScatteredBlock)
FRONTS: dict[tuple[Body, MeasuredEvent], type[Front]] = {(front.body, front.event): front for front in _EVERY}
"""Models by body and event."""
_shared = functools.cache(lambda model: model())


def front_for(body: Body, event: MeasuredEvent, *tables: Measurements) -> Front:
    """A model by body and event; with a table, for these measurements."""
    model = FRONTS[body, event]
    return model(*tables) if model.interpolated else _shared(model)  # whose compiled programs all fits share


def front_of(m: Measurements, event: MeasuredEvent | Front | None = None, body: Body | None = None) -> Front:
    """Choose the model of measurements; a ValueError if there is none."""
    chosen = model_of(m, event, body)
    return chosen if isinstance(chosen, Front) else front_for(chosen.body, chosen.event, m)


def model_of(m: Measurements, event: MeasuredEvent | Front | None = None, body: Body | None = None) -> Front | type[Front]:
    """Choose the class of the model, or return one's own model.

    By default a block and its whole event where every measurement states how its side is pushed, or its series where it has
    forces, unless the event is one of sliders only; else a slider and its first front.
    """
    if isinstance(event, Front):
        if type(event).length is Front.length and type(event).values is Front.values:
            raise TypeError(f"event: {type(event).__name__} has neither a length nor values (docs/howto/extend.md)")
        return event
    if isinstance(event, type) and issubclass(event, Front):
        raise TypeError(f"event: give {event.__name__}(), a model, and not its class")
    if event is not None:
        check_choice("event", event, MeasuredEvent)
    forces = m.force is not None and m.push_height is not None
    if event == "sequence" and not forces:
        raise ValueError(f"{m.source}: event = 'sequence' needs forces of a block: columns force, force_sigma, push_height")
    if body is not None:
        check_choice("body", body, Body)
    else:
        said = m.push_height is not None and not np.isnan(m.push_height).any()
        body = "block" if said and event in (None, "full", "sequence") else "slider"
    event = event or ("sequence" if body == "block" and forces else "full" if body == "block" else "domino")
    if (body, event) not in FRONTS:
        raise ValueError(
            f"event = {event!r}: contacts of a block break in any order, so its length is that of the whole event: 'full'"
        )
    return FRONTS[body, event]
