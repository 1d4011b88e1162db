"""Build a small field by hand: a glowing ball in a faint halo, saved as an asset."""

import numpy as np

import lumitree
from lumitree.octree.extract import extract


def glowing_ball(positions):
    """The field: density [N] and spherical-harmonics coefficients [N, 3, 1] at positions [N, 3]."""
    radius = np.linalg.norm(positions, axis=1)
    density = np.where(radius < 0.4, 20.0, np.where(radius < 0.9, 0.15, 0.0))
    core = np.array([6.0, 3.0, 0.0])
    halo = np.array([-8.0, -7.0, -5.0])
    coefficients = np.where(radius[:, None] < 0.4, core, halo)[..., None]
    return density.astype(np.float32), coefficients.astype(np.float32)


children, density, coefficients = extract(glowing_ball, np.ones(3), tree_depth=5)
asset = lumitree.Asset(
    children=children,
    density=density,
    coefficients=coefficients,
    tree_depth=5,
    l_max=0,
    law="linear",
    max_radiance=8.0,
    frame=lumitree.LocalFrame(np.ones(3), np.eye(4)),
    luminaire="a ball in a halo",
)
lumitree.save(asset, "ball.lumitree")
print(f"ball.lumitree: {asset.num_leaves} leaves, {asset.num_bytes / 1e6:.1f} MB")
