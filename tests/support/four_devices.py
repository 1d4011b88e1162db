"""Steps of training on four CPU devices, in a process of its own: `four_devices.py DATASET OUT`.

Writes the weights to OUT, and prints the number of devices that share 64, 66 and 65 rays, and the
operations of a step on each.
"""

import json
import sys

import jax
import numpy as np

from lumitree.fit.network.rays import load_rays
from lumitree.fit.network.step import initial_state, make_step, ray_mesh, state_sharding
from lumitree.lamp.dataset import Dataset
from support.sphere import TINY


def steps(dataset, count=3):
    """Weights before and after some steps, and a step's floating-point operations on a device."""
    rays, occupancy = load_rays(Dataset.open(dataset), TINY.opacity_kind, TINY.skip_empty)
    graph, state = initial_state(TINY, rays.typical_part)
    start = jax.tree.map(np.array, jax.tree.leaves(state.params))
    state, occupancy = jax.device_put((state, occupancy), state_sharding(TINY))
    batches = [rays.draw(0, index, TINY.rays_per_batch) for index in range(count)]
    step = make_step(TINY, graph, rays.max_radiance).lower(state, batches[0], occupancy).compile()
    for batch in batches:
        state, _, _ = step(state, batch, occupancy)
    weights = [np.array(leaf) for leaf in jax.tree.leaves(state.params)]
    return start, weights, step.cost_analysis()["flops"]


if __name__ == "__main__":
    dataset, output = sys.argv[1:]
    _, weights, operations = steps(dataset)
    np.savez(output, *weights)
    shared = [ray_mesh(count).size for count in (64, 66, 65)]
    print(json.dumps({"shared": shared, "operations": operations}))
