"""What loading a contact and breaking it do to the chain, contact by contact.

Sites are cut into the blocks of `slippulse_jax.lattice.response`, a block a row.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from slippulse_jax.lattice.chain import Chain
from slippulse_jax.lattice.response import Response, into_blocks


class Contacts(NamedTuple):
    """B blocks of M contacts."""

    threshold: Float[Array, "B M"]  # of a contact never broken; inf where there is none
    per_load: Float[Array, "B M"]  # stress per load
    hastened: Float[Array, "B 4"]  # most by which a contact's break comes sooner, in load, per displacement at a block's edges
    gains: Float[Array, "B M 3"]  # per stress given up: force lost at the edge, slip, stress lost by the whole chain
    energy: Float[Array, "B M"]  # k²/2k_i
    edge_stiffness: Float[Array, ""]  # force on the edge per load


def contacts_of(chain: Chain, resp: Response) -> Contacts:
    """Tables of a chain's contacts."""
    size = resp.near.shape[1]
    q, k = into_blocks(chain.contact, size), chain.stiffness
    per_load = (resp.at_load[:, :, None] * resp.read).sum(1)
    pulled = per_load[:, None] > 0
    soft = k / jnp.where(q > 0, q, jnp.inf)
    # stress that a break adds to the other contacts: in its own block, and in those that what leaves it gets to
    felt = resp.pass_on * resp.read.sum(-1)[None, :, :, None]
    beyond = jnp.concatenate([felt[:, :, :2].sum((1, 2)), felt[:, :, 2:].sum((1, 2))], -1)
    lost = 1 - resp.near.sum(-1) - (resp.leave * beyond[:, None]).sum(-1)
    return Contacts(
        threshold=into_blocks(jnp.where(chain.contact > 0, chain.threshold, jnp.inf), size, jnp.inf),
        per_load=per_load,
        hastened=jnp.where(pulled, resp.read / jnp.where(pulled, per_load[:, None], 1), 0).max(-1),
        gains=jnp.stack([k * per_load * soft, soft, lost], -1),
        energy=soft * k / 2,
        edge_stiffness=resp.edge_stiffness,
    )
