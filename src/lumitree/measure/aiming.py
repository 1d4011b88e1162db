"""Places and directions of lamps for the illuminance that planes have to have, at the least cost.

A round begins with a simulation of all lamps where they are. Until the next one, reflected light
and the shadowed part of each lamp's direct light are constant, and the unshadowed direct light
follows the lamps (`direct_light`). Steps are made by sequential linear programming: the illuminance
is linearised in dim levels and poses at once, and the best step within a region of trust is taken
if the best dim levels after it cost less; else the region shrinks. The next simulation says whether
the round was an improvement.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lumitree.core.frames import rotation
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.measure.dimming import Dimmers, Task, best_step
from lumitree.measure.direct_light import direct_lux, moved, slope
from lumitree.measure.illuminance import IlluminanceResult
from lumitree.rendering.emitter import PlacedLamp
from lumitree.rendering.placement import Placement
from lumitree.rendering.scene import PlacedLuminaire

# Rounds, and steps of each.
_ROUNDS, _STEPS = 6, 3
# Largest step at first: part of the region's diagonal, and angle.
_MOVE, _TURN = 0.06, 0.3
# Factors on it after a better and after a worse round or step; at the least one the search ends.
_GROW, _SHRINK, _LEAST = 1.5, 0.4, 0.05
# A round of less gain ends the search.
_GAIN = 2e-3
# Random points of a cell, for the light of lamps and for its derivatives.
_SAMPLES, _SLOPE_SAMPLES = 4, 1
_Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class Freedom:
    """How lamps may move.

    Attributes:
        axes: [L, 6] whether each lamp may move along, and turn about, x, y and z of the scene.
        low, high: [3] corners of the region that the boxes of lamps stay in, scene.
    """

    axes: NDArray[np.bool_]
    low: _Array
    high: _Array


@dataclasses.dataclass(frozen=True, eq=False)
class _Poses:
    """Centres [L, 3] of lamps, and rotations [L, 3, 3] from where they were placed."""

    centre: _Array
    turn: _Array

    def stepped(self, free: NDArray[np.bool_], steps: _Array) -> _Poses:
        """Poses after steps [K] along the axes [L, 6] that are free."""
        every = np.zeros(free.shape)
        every[free] = steps
        turn = Rotation.from_rotvec(every[:, 3:]).as_matrix() @ self.turn
        return _Poses(self.centre + every[:, :3], turn)


class _Model:
    """Light of lamps near the poses of a simulation.

    Args:
        tasks: of the simulation.
        direct: [N, L] direct illuminance of all points in it.
    """

    def __init__(
        self,
        lamps: Sequence[PlacedLamp],
        free: NDArray[np.bool_],
        poses: _Poses,
        result: IlluminanceResult,
        tasks: Sequence[Task],
        direct: _Array,
        seed: int,
    ) -> None:
        self._lamps, self._free, self._tasks = lamps, free, tasks
        self._points, self._normals, self._seed = result.position, result.normal, seed
        self._start = self._direct(poses)
        ratio = np.divide(direct, self._start, out=np.ones_like(direct), where=self._start > 0)
        self._lit = np.clip(np.nan_to_num(ratio, nan=1.0), 0, 1)

    def _direct(self, poses: _Poses) -> _Array:
        """[N, L] unshadowed direct illuminance by the lamps that may move; 0 by the others."""
        found = np.zeros((len(self._points), len(self._lamps)))
        for index in np.flatnonzero(self._free.any(axis=1)):
            lamp = moved(self._lamps[index], poses.centre[index], poses.turn[index])
            lux = direct_lux(lamp, self._points, self._normals, _SAMPLES, self._seed)
            found[:, index] = np.array(lux)
        return found

    def tasks(self, poses: _Poses) -> list[Task]:
        """The planes with their light at other poses."""
        change = self._lit * (self._direct(poses) - self._start)
        return [
            dataclasses.replace(task, lamps=np.maximum(task.lamps + change[task.points], 0))
            for task in self._tasks
        ]

    def with_slopes(self, tasks: Sequence[Task], poses: _Poses, levels: _Array) -> list[Task]:
        """The planes, with a column for each free axis of a lamp."""
        columns = np.zeros((len(self._points), int(self._free.sum())))
        for number, (index, axis) in enumerate(np.argwhere(self._free)):
            pose = poses.centre[index], poses.turn[index]
            rest = self._points, self._normals, _SLOPE_SAMPLES, self._seed
            found = slope(self._lamps[index], *pose, axis, *rest)
            columns[:, number] = levels[index] * self._lit[:, index] * found
        return [
            dataclasses.replace(task, lamps=np.hstack([task.lamps, columns[task.points]]))
            for task in tasks
        ]


def aim(
    lamps: Sequence[Placement],
    placed: Sequence[PlacedLuminaire],
    freedom: Freedom,
    dimmers: Dimmers,
    simulate: Callable[[Sequence[Placement], int], tuple[IlluminanceResult, list[Task], _Array]],
    seed: int,
) -> list[Placement]:
    """The lamps where they are best.

    Args:
        lamps, placed: the lamps that are dimmed.
        freedom: how they may move.
        simulate: called with lamps and the number of a round; returns the illuminance, the planes
            with the light of each lamp, and its direct light [N, L] at all points.
        seed: root seed.
    """
    free = freedom.axes
    emitters = [lamp_alone(each) for each in placed]
    reach = np.array([np.abs(each.scene_from_box[:3, :3]).sum(axis=1) for each in placed])
    poses = _Poses(
        np.array([each.scene_from_box[:3, 3] for each in placed]),
        np.tile(np.eye(3), (len(lamps), 1, 1)),
    )
    diagonal = float(np.linalg.norm(freedom.high - freedom.low))
    size = np.tile([_MOVE * diagonal] * 3 + [_TURN] * 3, (len(lamps), 1))[free]
    trust, best, best_poses, model = 1.0, np.inf, poses, None
    for number in range(_ROUNDS):
        result, tasks, direct = simulate(_at(lamps, poses), number)
        value, *_ = best_step(tasks, dimmers, np.zeros(0), np.zeros(0))
        gained, worse = best - value, value >= best
        trust *= _SHRINK if worse else _GROW if number > 0 else 1
        if not worse:
            part = SeedStream(Purpose.DESIGN, number, draw=3).seed(seed)
            model = _Model(emitters, free, poses, result, tasks, direct, part)
            best, best_poses, best_tasks = value, poses, tasks
        if trust < _LEAST or 0 < gained < _GAIN * best or number == _ROUNDS - 1:
            break
        assert model is not None
        where = freedom, reach, size, trust
        poses = _improved(model, best_tasks, best_poses, dimmers, *where)
        if poses is best_poses:
            break
    return _at(lamps, best_poses)


def _improved(
    model: _Model,
    tasks: Sequence[Task],
    poses: _Poses,
    dimmers: Dimmers,
    freedom: Freedom,
    reach: _Array,
    size: _Array,
    trust: float,
) -> _Poses:
    """Better poses by the model."""
    nowhere, free = np.zeros(0), freedom.axes
    value, levels, _ = best_step(tasks, dimmers, nowhere, nowhere)
    for _ in range(_STEPS):
        sloped = model.with_slopes(tasks, poses, levels)
        while trust >= _LEAST:
            limits = np.stack([freedom.low + reach, freedom.high - reach]) - poses.centre
            low, high = np.full(free.shape, -np.inf), np.full(free.shape, np.inf)
            low[:, :3], high[:, :3] = np.minimum(limits[0], 0), np.maximum(limits[1], 0)
            most = trust * size
            _, _, steps = best_step(
                sloped, dimmers, np.maximum(low[free], -most), np.minimum(high[free], most)
            )
            there = poses.stepped(free, steps)
            tried = model.tasks(there)
            found, tried_levels, _ = best_step(tried, dimmers, nowhere, nowhere)
            if found < value - 1e-6:
                poses, tasks, value, levels = there, tried, found, tried_levels
                break
            trust *= _SHRINK
    return poses


def lamp_alone(placed: PlacedLuminaire) -> PlacedLamp:
    """The light of a lamp alone."""
    proxy = mi.load_dict(placed.shapes("emission", "field")["proxy"])
    return proxy.emitter().lamp


def _at(lamps: Sequence[Placement], poses: _Poses) -> list[Placement]:
    """Placements at poses."""
    found = []
    for lamp, centre, turn in zip(lamps, poses.centre, poses.turn, strict=True):
        *axis, degrees = lamp.rotate
        vector = Rotation.from_matrix(turn @ rotation(axis, degrees)).as_rotvec()
        angle = float(np.linalg.norm(vector))
        rotate = lamp.rotate
        if not np.array_equal(turn, np.eye(3)):
            x, y, z = (vector / angle).tolist() if angle else (0.0, 1.0, 0.0)
            rotate = (x, y, z, float(np.rad2deg(angle)))
        x, y, z = centre.tolist()
        found.append(dataclasses.replace(lamp, at=(x, y, z), rotate=rotate))
    return found
