"""Irradiance inside the box of a baked lamp, as `lumitree_path` receives it."""

from typing import Any

import mitsuba as mi
import numpy as np

from benchmarks.common.timing import MIN_ROUNDS, Job, interleaved
from benchmarks.inside_box.patches import NORMALS, Floats, Rectangle
from benchmarks.inside_box.received import received_irradiance
from lumitree.asset.asset import Asset
from lumitree.core.photometry import LUMA
from lumitree.rendering.emitter import Appearance
from lumitree.rendering.placement import Placement
from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

# Receivers of an estimate, at least, and samples of each.
_RECEIVERS, _SAMPLES = 1 << 12, 128
_MIN_POINTS = 8


class BakedLamp:
    """A scene with one baked lamp, where its own file has it.

    Args:
        asset: the lamp.
        appearance: "geometry" has its surfaces in the scene, "field" has not.
    """

    def __init__(self, asset: Asset, appearance: Appearance) -> None:
        placed = PlacedLuminaire(Placement(asset))
        # Far from the box.
        camera = mi.ScalarTransform4f().translate((100 * asset.frame.size).tolist())
        sensor = {"type": "perspective", "to_world": camera}
        empty = mi.load_dict({"type": "scene", "camera": sensor})
        self._scene = place_luminaires(empty, [placed], appearance=appearance)
        self._matrix = placed.scene_from_world @ asset.frame.world_from_local
        self._half = asset.frame.half_extents

    def received(self, points: Floats, axis: int, side: int, samples: int, seed: int) -> Floats:
        """Irradiance [N] of points [N, 3], luminance-weighted, radiance times sr.

        Args:
            points: in the local frame.
            axis, side: of a rectangle that they are on.
            samples: that are averaged for each.
        """
        normal = NORMALS[side] * self._matrix[:3, axis] / np.linalg.norm(self._matrix[:3, axis])
        places = points @ self._matrix[:3, :3].T + self._matrix[:3, 3]
        normals = np.broadcast_to(normal, places.shape)
        values = received_irradiance(self._scene, places, normals, samples, seed)
        return np.asarray(values, np.float64) @ np.array(LUMA)

    def patches(self, rectangle: Rectangle, side: int, seed: int) -> Floats:
        """Irradiance [P, P] of one side of the patches of a rectangle."""
        count = rectangle.patches**2
        inside = np.random.default_rng(seed).random(
            (count, max(_MIN_POINTS, _RECEIVERS // count), 2)
        )
        points = rectangle.points(self._half, inside)
        values = self.received(points.reshape(-1, 3), rectangle.axis, side, _SAMPLES, seed)
        return values.reshape(rectangle.patches, rectangle.patches, -1).mean(axis=-1)

    def centres(self, rectangle: Rectangle) -> Floats:
        """Centres [P, P, 3] of the patches, local frame."""
        side = rectangle.patches
        return rectangle.points(self._half, np.full((side**2, 1, 2), 0.5)).reshape(side, side, 3)


def receiver_noise(
    lamp: BakedLamp, groups: dict[str, list[tuple[Floats, int, int]]], seed: int
) -> dict[str, Any] | None:
    """Cost and noise of one sample of receivers.

    Args:
        lamp: what they receive light from.
        groups: by name, receivers as points [N, 3], axis and side.
        seed: of the random numbers.

    Returns:
        By name, the CPU seconds of a sample (`seconds`), the geometric mean over the receivers of
        the relative variance of one (`variance`), and their product (`product`). None if a
        group has no receivers, or they get no light.
    """
    if not all(groups.values()):
        return None
    found: dict[str, list[Floats]] = {name: [] for name in groups}
    repeats = {
        name: -(-_RECEIVERS * _SAMPLES // sum(len(points) for points, _, _ in group))
        for name, group in groups.items()
    }

    def job(name: str) -> Job:
        def take(index: int) -> None:
            rows = []
            for number, (points, axis, side) in enumerate(groups[name]):
                many = np.repeat(points, repeats[name], axis=0)
                values = lamp.received(many, axis, side, 1, seed + 100 * index + number)
                rows.append(values.reshape(len(points), repeats[name]))
            found[name].append(np.concatenate(rows))

        return lambda index: lambda: take(index)

    times = interleaved({name: job(name) for name in groups}, MIN_ROUNDS, clock="cpu")
    result = {}
    for name, rounds in found.items():
        values = np.concatenate(rounds, axis=1)
        lit = values[values.var(axis=1) > 0]
        if not len(lit):
            return None
        relative = lit.var(axis=1, ddof=1) / lit.mean(axis=1) ** 2
        variance = float(np.exp(np.log(relative).mean()))
        seconds = times[name] / (len(values) * repeats[name])
        product = seconds * variance
        result[name] = {"seconds": seconds, "variance": variance, "product": product}
    return result
