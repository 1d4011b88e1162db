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
import itertools
from collections.abc import Callable, Mapping, Sequence

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lumitree.core.frames import rotation
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.measure.dimming import Dimmers, Task, TaskPlane, best_step, tasks_of
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
# A round that saves less ends the search.
_SAVED = 2e-3
# Random points of a cell, for the light of lamps and for its derivatives.
_SAMPLES, _SLOPE_SAMPLES = 2, 1
# Limits of no steps.
_NOWHERE = np.zeros(0)
_Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class _Poses:
    """Centres [L, 3] of lamps, and rotations [L, 3, 3] from where they were placed."""

    centre: _Array
    turn: _Array

    def stepped(self, axes: NDArray[np.bool_], steps: _Array) -> _Poses:
        """Poses after steps [K] along, and about, axes [L, 6]."""
        every = np.zeros(axes.shape)
        every[axes] = steps
        turn = Rotation.from_rotvec(every[:, 3:]).as_matrix() @ self.turn
        return _Poses(self.centre + every[:, :3], turn)


class _Model:
    """Light of lamps near the poses of a simulation.

    Args:
        lamps: their light by number, if they may move.
        axes: as of `Aim`.
        tasks: the planes in the simulation.
        seed: of the random points of cells.
    """

    def __init__(
        self,
        lamps: Mapping[int, PlacedLamp],
        axes: NDArray[np.bool_],
        poses: _Poses,
        result: IlluminanceResult,
        tasks: list[Task],
        seed: int,
    ) -> None:
        assert result.by_lamp is not None
        self.start = tasks
        self._lamps, self._axes, self._seed = lamps, axes, seed
        self._points = result.position, result.normal
        self._direct = self._unshadowed(poses)
        direct = np.nan_to_num(result.by_lamp.direct[1:].T)
        lit = np.divide(direct, self._direct, out=np.ones_like(direct), where=self._direct > 0)
        self._lit = np.clip(lit, 0, 1)

    def _unshadowed(self, poses: _Poses) -> _Array:
        """[N, L] direct illuminance by the lamps that may move; 0 by the others."""
        found = np.zeros((len(self._points[0]), len(self._axes)))
        for index, lamp in self._lamps.items():
            there = moved(lamp, poses.centre[index], poses.turn[index])
            found[:, index] = np.array(direct_lux(there, *self._points, _SAMPLES, self._seed))
        return found

    def tasks(self, poses: _Poses) -> list[Task]:
        """The planes with their light at other poses."""
        change = self._lit * (self._unshadowed(poses) - self._direct)
        return [
            dataclasses.replace(task, lamps=np.maximum(task.lamps + change[task.points], 0))
            for task in self.start
        ]

    def with_slopes(self, tasks: Sequence[Task], poses: _Poses, levels: _Array) -> list[Task]:
        """The planes, with a column for each free axis of a lamp."""
        columns = np.zeros((len(self._points[0]), int(self._axes.sum())))
        for column, (index, axis) in zip(columns.T, np.argwhere(self._axes).tolist(), strict=True):
            pose = poses.centre[index], poses.turn[index], axis
            found = slope(self._lamps[index], *pose, *self._points, _SLOPE_SAMPLES, self._seed)
            column[:] = levels[index] * self._lit[:, index] * found
        return [
            dataclasses.replace(task, lamps=np.hstack([task.lamps, columns[task.points]]))
            for task in tasks
        ]


@dataclasses.dataclass(frozen=True, eq=False)
class Aim:
    """A search for poses.

    Attributes:
        planes: what is needed.
        lamps: all lamps, where they are at first.
        axes: [L, 6] whether each may move along, and turn about, x, y and z of the scene.
        region: [2, 3] corners of the box in which the boxes of lamps stay, scene.
        simulate: called with the lamps; returns the illuminance by lamp.
        seed: root seed.
    """

    planes: Sequence[TaskPlane]
    lamps: Sequence[PlacedLuminaire]
    axes: NDArray[np.bool_]
    region: _Array
    dimmers: Dimmers
    simulate: Callable[[Sequence[Placement]], IlluminanceResult]
    seed: int

    def search(self, start: IlluminanceResult) -> tuple[list[Placement], IlluminanceResult]:
        """The lamps where they are best, and their illuminance; `start` is where they are first."""
        free = np.flatnonzero(self.axes.any(axis=1)).tolist()
        lights = {index: unplaced_lamp(self.lamps[index]) for index in free}
        centre = np.array([lamp.scene_from_box[:3, 3] for lamp in self.lamps])
        best, trust = _Poses(centre, np.tile(np.eye(3), (len(centre), 1, 1))), 1 / _GROW
        result, least, model = start, np.inf, None
        for number in range(_ROUNDS):
            poses = best if model is None else self._improved(model, best, trust)
            if poses is best and model is not None:
                break
            found = self.simulate(self._at(poses)) if number else start
            tasks = tasks_of(self.planes, found)
            cost, *_ = best_step(tasks, self.dimmers, _NOWHERE, _NOWHERE)
            gained = least - cost
            if gained > 0:
                seed = SeedStream(Purpose.DESIGN, number, draw=2).seed(self.seed)
                model = _Model(lights, self.axes, poses, found, tasks, seed)
                best, result, least = poses, found, cost
            trust *= _GROW if gained > 0 else _SHRINK
            if trust < _LEAST or 0 < gained < _SAVED * least:
                break
        return self._at(best), result

    def _improved(self, model: _Model, poses: _Poses, trust: float) -> _Poses:
        """Better poses by the model; the same if there are none."""
        tasks, dimmers = model.start, self.dimmers
        value, levels, _ = best_step(tasks, dimmers, _NOWHERE, _NOWHERE)
        reach = [np.abs(lamp.scene_from_box[:3, :3]).sum(axis=1) for lamp in self.lamps]
        size = np.full(self.axes.shape, _TURN)
        size[:, :3] = _MOVE * np.linalg.norm(self.region[1] - self.region[0])
        for _ in range(_STEPS):
            sloped = model.with_slopes(tasks, poses, levels)
            while trust >= _LEAST:
                low, high = -trust * size, trust * size
                # A lamp that is outside of the region does not move farther away.
                inside = self.region[:, None] + np.array([reach, np.negative(reach)]) - poses.centre
                low[:, :3] = np.maximum(low[:, :3], np.minimum(inside[0], 0))
                high[:, :3] = np.minimum(high[:, :3], np.maximum(inside[1], 0))
                # A lamp that is off stays where it is.
                low[levels <= 0], high[levels <= 0] = 0, 0
                limits = low[self.axes], high[self.axes], self._apart(poses, reach)
                *_, steps = best_step(sloped, dimmers, *limits)
                there = poses.stepped(self.axes, steps)
                tried = model.tasks(there)
                found, tried_levels, _ = best_step(tried, dimmers, _NOWHERE, _NOWHERE)
                if found < value - 1e-6:
                    poses, tasks, value, levels = there, tried, found, tried_levels
                    break
                trust *= _SHRINK
        return poses

    def _apart(self, poses: _Poses, reach: list[_Array]) -> tuple[_Array, _Array]:
        """Rows [P, K] of steps, and limits, with which lamps do not move into each other."""
        rows, limits = [], []
        for first, second in itertools.combinations(range(len(reach)), 2):
            between = poses.centre[first] - poses.centre[second]
            distance = float(np.linalg.norm(between))
            if distance and self.axes[[first, second], :3].any():
                nearer = np.zeros(self.axes.shape)
                nearer[first, :3], nearer[second, :3] = -between / distance, between / distance
                rows.append(nearer[self.axes])
                limits.append(max(distance - reach[first].max() - reach[second].max(), 0.0))
        return np.reshape(rows, (len(rows), int(self.axes.sum()))), np.array(limits)

    def _at(self, poses: _Poses) -> list[Placement]:
        """Placements at poses; lamps that may not move stay as they are."""
        placements = [lamp.placement for lamp in self.lamps]
        for index in np.flatnonzero(self.axes.any(axis=1)).tolist():
            lamp, (x, y, z) = placements[index], poses.centre[index].tolist()
            rotate = lamp.rotate
            if self.axes[index, 3:].any():
                turn = poses.turn[index] @ rotation(rotate[:3], rotate[3])
                vector = Rotation.from_matrix(turn).as_rotvec(degrees=True)
                angle = float(np.linalg.norm(vector))
                rotate = (*(vector / angle).tolist(), angle) if angle else (0.0, 1.0, 0.0, 0.0)
            placements[index] = dataclasses.replace(lamp, at=(x, y, z), rotate=rotate)
        return placements


def unplaced_lamp(placed: PlacedLuminaire) -> PlacedLamp:
    """The light of a lamp, without a scene."""
    proxy = mi.load_dict(placed.shapes("emission", "field")["proxy"])
    return proxy.emitter().lamp
