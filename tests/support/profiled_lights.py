"""Directions of lights with IES profiles, in a program and in the asset, for comparison."""

import numpy as np

from lumitree.core.octahedral import middle_directions, solid_angles
from lumitree.core.photometry import luminance
from lumitree.formats.type_c import node_solid_angles


def profile_vector(profile):
    """Mean direction [3] of a profile's light, in the frame of its light with z up.

    γ is the angle from -z, and C that from +x towards +y.
    """
    c, gamma = np.deg2rad(profile.c)[:, None], np.deg2rad(profile.gamma)
    directions = np.stack(
        np.broadcast_arrays(np.sin(gamma) * np.cos(c), np.sin(gamma) * np.sin(c), -np.cos(gamma)),
        axis=-1,
    )
    flux = profile.intensity * node_solid_angles(profile.c, profile.gamma)
    return (directions * flux[..., None]).sum(axis=(0, 1)) / flux.sum()


def light_vectors(placed):
    """Mean direction [S, 3] of the light of each of `PlacedLights`, in the frame of the program."""
    resolution = placed.local.resolution
    flux = luminance(placed.local.intensity) * solid_angles(resolution)
    means = flux @ middle_directions(resolution) / flux.sum(axis=1, keepdims=True)
    return means @ placed.rotation.T
