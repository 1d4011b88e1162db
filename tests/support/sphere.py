"""An opaque sphere that emits, alone in its box, in closed-form views; and a tiny network."""

import dataclasses
from pathlib import Path

import numpy as np

from lumitree.core.frames import LocalFrame, orthographic_rays, view_pose
from lumitree.fit.network.config import TrainConfig
from lumitree.lamp.dataset import Dataset, Frame, Manifest, View

RADIUS = 0.6
CENTRE = np.array([0.3, 0.1, 0.0])
HALF_EXTENTS = (1.0, 0.8, 0.7)
HALF_WIDTH = 1.5

# A network that trains in seconds, by the paper's law.
TINY = dataclasses.replace(
    TrainConfig.preview(),
    law="linear",
    num_layers=2,
    width=16,
    output_width=16,
    num_frequencies=3,
    num_coarse=8,
    num_fine=8,
    rays_per_batch=64,
    num_steps=20,
)


def sphere_dataset(
    folder: Path, views: int = 12, resolution: int = 32, brightness: float = 4.0
) -> Dataset:
    """Radiance grows with height on the sphere, from 0.2 to 1 of `brightness`, red to blue."""
    folder.mkdir(parents=True, exist_ok=True)
    indices = range(1, views + 1)
    frames = tuple(
        Frame(f"view_{i:06d}.exr", i, tuple(map(tuple, view_pose(i, 2.0).tolist())))
        for i in indices
    )
    manifest = Manifest(
        luminaire="sphere",
        fingerprint=f"sphere-{brightness}",
        split="train",
        resolution=resolution,
        spp=1,
        path_depth=1,
        half_width=HALF_WIDTH,
        local_frame=LocalFrame(HALF_EXTENTS, np.eye(4)),
        frames=frames,
    )
    dataset = Dataset(folder, manifest)
    dataset.save_manifest()
    for frame in frames:
        dataset.write(_view(frame, resolution, brightness))
    return dataset


def hit_distance(origins: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Distance [...] at which rays first meet the sphere, NaN where they miss it."""
    offset = origins - CENTRE
    half_b = offset @ direction
    root = half_b**2 - (np.sum(offset**2, axis=-1) - RADIUS**2)
    return np.where(root > 0, -half_b - np.sqrt(np.maximum(root, 0)), np.nan)


def _view(frame: Frame, resolution: int, brightness: float) -> View:
    origins, direction = orthographic_rays(frame.pose, HALF_WIDTH, resolution)
    distance = hit_distance(origins, direction)
    height = (origins[..., 2] + distance * direction[2] - CENTRE[2]) / RADIUS
    level = brightness * (0.6 + 0.4 * np.nan_to_num(height))
    mask = np.isfinite(distance).astype(np.float32)
    colour = np.stack([level, 0.5 * level, 0.25 * level], axis=-1) * mask[..., None]
    return View(frame, colour.astype(np.float32), mask, mask)
