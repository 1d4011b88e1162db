"""The devices that share a training step: each takes an equal part of the rays (data-parallel).

Every device holds the weights, Adam's moments and the occupancy grid. A random number belongs to a
ray's place in its chunk, not to a device. So the number of devices changes only the order of sums.
"""

from typing import TypeVar

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

Tree = TypeVar("Tree")
_RAYS = "rays"


def ray_mesh(num_rays: int) -> Mesh:
    """The devices that share `num_rays` rays: as many of this process as divide their number."""
    devices = jax.local_devices()
    count = max(n for n in range(1, len(devices) + 1) if num_rays % n == 0)
    return Mesh(np.array(devices[:count]), (_RAYS,))


def divided(mesh: Mesh, chunks: Tree) -> Tree:
    """Within a jitted function: arrays [C, R, ...] of C chunks, whose R rays are divided."""
    return jax.lax.with_sharding_constraint(chunks, NamedSharding(mesh, PartitionSpec(None, _RAYS)))


def on_all(mesh: Mesh) -> NamedSharding:
    """The sharding of arrays that every device holds as a whole."""
    return NamedSharding(mesh, PartitionSpec())
