"""Batches in which no bit of a lane depends on the others."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap


def lane_by_lane(f: Callable, *given: Any) -> Any:
    """Evaluate f(*given) lane by lane under ``jax.vmap``.

    On a CPU no bit of a result then depends on the batch, and a finished lane costs nothing. An accelerator runs the lanes
    in step.
    """
    return lax.platform_dependent(*given, cpu=_one_by_one(f), default=f)


def _one_by_one(f: Callable) -> Callable:
    one = custom_vmap(f)

    @one.def_vmap
    def _rule(axis_size, in_batched, *args):  # pyright: ignore[reportUnusedFunction]
        leaves, tree = jax.tree.flatten(args)
        batched = jax.tree.leaves(in_batched)
        # XLA would unroll a loop over a single lane, which might then round differently: run at least two
        twice = [jnp.concatenate([x, x]) if b and axis_size == 1 else x for x, b in zip(leaves, batched, strict=True)]

        def lane(mapped: list) -> Any:
            mapped = list(mapped)
            return one(*jax.tree.unflatten(tree, [mapped.pop(0) if b else x for x, b in zip(twice, batched, strict=True)]))

        out = lax.map(lane, [x for x, b in zip(twice, batched, strict=True) if b])
        return jax.tree.map(lambda x: x[:axis_size], out), jax.tree.map(lambda _: True, out)

    return one
