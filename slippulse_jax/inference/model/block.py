"""The whole event on a block that is pushed at a height."""

from collections.abc import Collection
from typing import ClassVar

import numpy as np

from slippulse_jax.base.domains import FRICTION
from slippulse_jax.block import RIGID, USUAL_NORMAL_STIFFNESS
from slippulse_jax.inference.model.family import FLAGS, SEARCHED, Families, geometry_of
from slippulse_jax.inference.model.front import (
    STIFFEST,
    Front,
    Regime,
)
from slippulse_jax.inference.model.inputs import KEPT, Input, Inputs
from slippulse_jax.inference.table.measurements import Measurements
from slippulse_jax.theory import block_decay_length


class BlockEvent(Front):
    """The whole event on a block that is pushed at a height."""

    event = "full"
    body = "block"
    inputs = {
        "log_push": Input("h/H", -np.inf, 0.0, "the push must lie below the top of the block"),
        "log_push_width": Input("w/H", -np.inf, np.inf, ""),
        "log_sites": Input("L/λc", np.log(2.0), np.inf, "must be at least 2"),
        "friction": Input("μ", 0.0, np.inf, FRICTION.requirement, 1e-4, (0.0, np.inf)),
        "log_normal_stiffness": Input("k_n/k", -np.inf, np.inf, ""),
        **{name: Input("", 0.0, 1.0, "") for name in FLAGS},
        "residual_strength": KEPT,
    }
    interpolated = True
    most_off = np.inf
    observes = ("length", "count", "limit")
    name = "first precursor"
    carrier = "a block under two-dimensional elasticity"
    body_modelled = "semi-infinite block under two-dimensional elasticity, pushed at a height"
    length_modelled = "length of the whole event, in which contacts may break again"
    held = "the pusher"
    uncertain_as = "lengths on a block are interpolated, between coarser blocks and across falls to a few contacts,"
    refused: ClassVar[dict[str, str]] = {
        "displacement": "from lengths alone: leave it out",
        "force": "from lengths alone: leave it out",
        "gauges": "from lengths alone: leave it out",
        "machine_stiffness": "whose pusher is held: leave it out. The stiffness is then too large, as a machine takes part of "
        "the load; by about what factor, the row of machines in the report of a table without the columns of the push says",
    }
    """What measurements may state beside lengths, and a fit of a block cannot take; and what a block it takes instead."""

    def __init__(self, *tables: Measurements, tried: bool = False) -> None:
        """Follow blocks like those measured from theirs, in any of the tables.

        Blocks that are `tried`, for what they would make of a fit, are followed at fewer stiffnesses.
        """
        self.followed = Families(tried=tried)
        whole = [m for m in tables if m.push_height is not None and not np.isnan(m.push_height).any()]
        for m in whole:
            kept = {"residual_strength": m.or_zero("residual_strength")}
            own = Inputs.of(m.height, 1.0, m.poisson, m.or_zero("prestress")).given(**self.stated(m), **kept)
            self.followed.add(geometry_of(own), m.length / m.height, m.height)
        if whole:
            m = whole[0]
            if m.block_length is not None:
                self.body_modelled = self.body_modelled.replace("semi-infinite block", "block with a free end")
            if m.friction is not None:
                stiffness = " and stiffnesses" * ("multicontact" in m.contact_law)
                self.thresholds = f"thresholds{stiffness} that follow the pressure"
            if "held" in m.top:
                self.held = "the pusher and the top of the block"

    def check(self, m: Measurements, names: Collection[str]) -> None:
        """Ask for a push, and refuse what blocks cannot take."""
        if m.push_height is None:
            raise ValueError(f"{m.source}: a block needs the height of the push: give push_height (push_height_mm in a table)")
        if np.isnan(m.push_height).any():
            blank = m.place(int(np.argmax(np.isnan(m.push_height))))
            raise ValueError(f"{blank}, column push_height: missing: a block needs the height of the push of every measurement")
        if "friction" in names and m.friction is None:
            raise ValueError("parameter friction: the measurements state no friction to start from; a guess is enough")
        for name, why in self.refused.items():
            if getattr(m, name) is not None:
                own, push = m.heading(name), m.heading("push_height")
                raise ValueError(f"{m.source}: {own} beside {push}: a fit of a block takes one {why} (docs/fit/own_csv.md)")
        if "threshold_slope" in names or m.or_zero("threshold_slope").any():
            raise ValueError(f"{m.source}: threshold_slope: a fit of a block takes level thresholds")

    def stated(self, m: Measurements) -> dict[str, np.ndarray]:
        """The push on each block, its end, and what the pressure does."""
        assert m.push_height is not None

        def log(x: np.ndarray | None) -> np.ndarray:
            return np.full(len(m), np.inf) if x is None else np.log(np.where(np.isnan(x), np.inf, x))

        ended, normal = {} if m.block_length is None else {"log_sites": log(m.block_length)}, log(m.normal_stiffness)
        if m.friction is not None:
            usual = np.full(len(m), np.log(USUAL_NORMAL_STIFFNESS))
            normal = usual if m.normal_stiffness is None else np.minimum(normal, np.log(RIGID))
        texts = zip(FLAGS, (m.push_control, m.contact_law, m.top), ("force", "multicontact", "held"), strict=True)
        return ended | {
            "log_push": np.log(m.push_height / m.height),
            "log_push_width": log(m.push_width) - np.log(m.height),
            "friction": m.or_zero("friction"),
            "log_normal_stiffness": normal,
            **{name: np.array([one == word for one in text] or [False] * len(m), float) for name, text, word in texts},
        }

    def left_out(self, m: Measurements, names: Collection[str]) -> list[str]:
        """The block's end, a compliant machine, and force control."""
        return ["block end"] * (m.block_length is None) + ["compliant machine"] + ["force control"] * (not m.push_control)

    def values(self, inputs: Inputs) -> np.ndarray:
        """Interpolated ℓ in λc."""
        return self.followed(inputs)[0]

    def uncertainty(self, inputs: Inputs) -> np.ndarray | None:
        """How far lengths may be off, for their contacts and near falls."""
        return self.followed(inputs)[1]

    def softest(self, m: Measurements) -> np.ndarray:
        """k/K at the least b searched."""
        return SEARCHED[0] / (2 * (1 + m.poisson) * m.height)

    def stiffest(self, m: Measurements) -> np.ndarray:
        """Largest k/K searched by default."""
        return np.minimum(STIFFEST, SEARCHED[1] / (2 * (1 + m.poisson) * m.height))

    def regime(self, inputs: Inputs) -> Regime:
        """Find b, and over what length an edge load decays."""
        found = super().regime(inputs)
        decay = np.exp(inputs.log_height) * block_decay_length(found.b, inputs.poisson)
        return found._replace(slow_decay_length=decay)
