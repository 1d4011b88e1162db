"""Small lamps that tests of several targets of `lumitree export` share."""

import dataclasses

import numpy as np

from lumitree.asset.asset import Asset, light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.frames import LocalFrame, rotation, similarity
from support.light_fields import random_light_field

# All cells are inside its box.
FRAME = LocalFrame([1, 1, 1], similarity(rotation([0, 1, 0], 90), 2.0, [1.0, 2, 3]))
GAIN = (2.0, 1.0, 0.5)


def lamp(name: str = "lamp", gain: tuple[float, float, float] = GAIN, count: int = 20) -> Asset:
    """A lamp of random intensities, with a gain, that its frame turns, scales and moves."""
    field = random_light_field(1, depth=3, resolution=8, count=count)
    return dataclasses.replace(light_field_asset(field, FRAME, name), light_factors=gain)


def beam(mi, direction: tuple[float, float, float], colour=(1.0, 1.0, 1.0)) -> Asset:
    """A lamp at (1, 2, 3) whose light leaves in one direction of its file."""
    from lumitree.core.octahedral import bin_of

    intensity = np.zeros((1, 256, 3))
    intensity[0, int(np.array(bin_of(mi.Vector3f(*direction), 16))[0])] = colour
    field = make_light_field(np.zeros((1, 3), int), intensity, 1)
    return light_field_asset(
        field, LocalFrame(np.ones(3), similarity(np.eye(3), 0.1, [1, 2, 3])), "beam"
    )
