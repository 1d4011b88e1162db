"""Dim levels of lamps that give planes the illuminance that they have to have, at the least cost.

The illuminance E of a point is linear in the dim levels x of the lamps: E = A x + F. Mean, least
and largest illuminance of a plane are linear constraints of x, and U0 is linear too: each point has
at least U0 times the mean. The levels are a linear program, of whole numbers where lamps are dimmed
in steps.

A is estimated, and the optimum is where points have just enough. Without a margin about half of
the points at the limit would have too little, and the least of many more so. So each point keeps
`margin` standard errors of its own sum from the limits. The error of a sum depends on x, so the
program is solved a few times, with the errors at the levels before.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp

from lumitree.core.arguments import check_range
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.measure.receivers import AreaFigures, Plane

if TYPE_CHECKING:
    from lumitree.measure.illuminance import IlluminanceResult, LitScene

# Rounds in which the errors follow the levels.
_ROUNDS = 4
# Cost of a target that is missed, relative to the cost of all lamps at level 1.
_LACK = 10.0
# Levels in steps are optimal within this part of their cost.
_GAP = 2e-3
_NODES = 20_000
# Standard errors by which a point may be off; rounds in which points at a limit get other samples,
# and part of the error that is then enough.
_DOUBT, _SHARPER, _SHARP = 2.0, 4, 1 / 4
# Levels below this part of the brightest are the solver's zeros.
_LEAST = 1e-9
# So large a part of the targets is all of them.
_ALL = 1 - 1e-6

_Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class TaskPlane(Plane):
    """A plane, and the illuminance that `lumitree.design` gives it.

    Attributes:
        target: least mean illuminance, lx; 0 for none.
        uniformity: least U₀, smallest over mean illuminance of its points, 0 to 1.
        minimum: least illuminance of each of its points, lx.
        maximum: largest illuminance of its points, lx; default: no limit.

    Raises:
        LumitreeError: as for `Plane`; or the numbers cannot all be true.
    """

    target: float = 0.0
    uniformity: float = 0.0
    minimum: float = 0.0
    maximum: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("target", self.target, 0, 1e9, "lx")
        check_range("uniformity", self.uniformity, 0, 1)
        check_range("minimum", self.minimum, 0, 1e9, "lx")
        if self.maximum is not None:
            check_range("maximum", self.maximum, max(self.target, self.minimum), 1e9, "lx")


@dataclasses.dataclass(frozen=True, eq=False)
class Task:
    """A plane of a design with its points that are not inside solids.

    Attributes:
        name: of the plane, for messages.
        plane: what it has to have.
        points: [N] which of all points.
        fixed: [N] illuminance by light of no lamp, lx.
        lamps: [N, L] illuminance by each lamp at dim level 1, lx. In `best_step` more columns are
            illuminance by steps of poses.
        variance: [N, L] squares of the standard errors of `lamps`.
    """

    name: str
    plane: TaskPlane
    points: NDArray[np.int64]
    fixed: _Array
    lamps: _Array
    variance: _Array

    def lux(self, levels: _Array) -> _Array:
        """[N] illuminance at dim levels [L]."""
        return self.lamps @ levels + self.fixed

    def error(self, levels: _Array) -> _Array:
        """[N] standard errors of `lux`."""
        return np.sqrt(self.variance @ levels**2)

    def unsure(self, levels: _Array) -> NDArray[np.int64]:
        """Which of all points may have the least illuminance, or the most if that has a limit."""
        lux, error = self.lux(levels), _DOUBT * self.error(levels)
        found = lux - error <= (lux + error).min()
        if self.plane.maximum is not None:
            found |= lux + error >= (lux - error).max()
        return self.points[found]

    def figures(self, area: AreaFigures, levels: _Array) -> AreaFigures:
        """Figures of the plane at dim levels [L]; `area` has the numbers of its points."""
        lux, error = np.full((2, area.count), np.nan)
        lux[self.points - area.first] = self.lux(levels)
        error[self.points - area.first] = self.error(levels)
        return AreaFigures.of(area.name, area.first, lux, error)

    def limits(self, margin: _Array | float) -> Iterator[tuple[_Array, _Array, float, float]]:
        """Constraints of dim levels x, as `_Constraints` has them."""
        plane = self.plane
        mean, fixed = self.lamps.mean(axis=0), self.fixed.mean()
        # Errors of points are independent of each other.
        of_mean = np.linalg.norm(np.broadcast_to(margin, len(self.fixed))) / len(self.fixed)
        yield -mean[None], np.array([fixed - of_mean]), plane.target, plane.target
        if (ratio := plane.uniformity) > 0:
            size = ratio * max(plane.target, plane.minimum)
            yield ratio * mean - self.lamps, self.fixed - ratio * fixed - margin, 0.0, size
        if plane.minimum > 0:
            yield -self.lamps, self.fixed - margin, plane.minimum, plane.minimum
        if plane.maximum is not None:
            yield self.lamps, plane.maximum - self.fixed - margin, 0.0, plane.maximum


def tasks_of(planes: Sequence[TaskPlane], result: IlluminanceResult) -> list[Task]:
    """The planes with the light that their points get; points inside solids are left out.

    The parts of lamps at a point are correlated. So their errors are scaled to the error of their
    sum.

    Args:
        result: illuminance of the planes by lamp.
    """
    parts = result.by_lamp
    assert parts is not None
    # The first part is light of no lamp.
    fixed, *light = parts.direct + parts.reflected
    variance = (parts.direct_error**2 + parts.reflected_error**2)[1:]
    total = variance.sum(axis=0)
    variance *= np.divide(result.total_error**2, total, out=np.ones_like(total), where=total > 0)
    tasks = []
    for plane, area in zip(planes, result.areas, strict=True):
        known = area.first + np.flatnonzero(np.isfinite(result.total[area.part]))
        if not len(known):
            raise LumitreeError(f"all points of {shown(area.name, 200)} are inside solids; move it")
        of_lamps = (np.array(each)[:, known].T for each in (light, variance))
        tasks.append(Task(area.name, plane, known, fixed[known], *of_lamps))
    return tasks


def sharpened(
    scene: LitScene,
    planes: Sequence[TaskPlane],
    error: float,
    time: float | None,
    seeds: Iterator[int],
    result: IlluminanceResult,
    levels_of: Callable[[list[Task]], _Array],
) -> tuple[IlluminanceResult, list[Task], _Array]:
    """A result, its tasks and its dim levels, with smaller errors where a plane has its minimum.

    The least of many noisy points is too small by about their error, and after an optimisation the
    points at a limit are the points that are estimated too bright. With new samples they are not.

    Args:
        scene: with the lamps where they are in the result.
        planes: the planes of the tasks.
        error, time: as of the result.
        seeds: of other samples.
        result: illuminance of the planes by lamp.
        levels_of: returns dim levels for tasks.
    """
    sharp = np.zeros(len(result.total), bool)
    for _ in range(_SHARPER):
        tasks = tasks_of(planes, result)
        levels = levels_of(tasks)
        unsure = np.unique(np.concatenate([task.unsure(levels) for task in tasks]))
        unsure = unsure[~sharp[unsure]]
        if not len(unsure):
            return result, tasks, levels
        sharp[unsure] = True
        result = scene.again(result, unsure, max(error * _SHARP, 1e-4), time, next(seeds))
    tasks = tasks_of(planes, result)
    return result, tasks, levels_of(tasks)


@dataclasses.dataclass(frozen=True, eq=False)
class Dimmers:
    """The dim levels that there are.

    Attributes:
        group: [L] number of the dimmer of each lamp.
        cost: [L] of each lamp at level 1.
        brightest: largest dim level.
        steps: number of equal steps up to it; None for any level.
    """

    group: NDArray[np.int64]
    cost: _Array
    brightest: float = 1.0
    steps: int | None = None

    @property
    def lamps(self) -> _Array:
        """[L, G] dim level of each lamp by the setting of each dimmer, 0 to `top`."""
        unit = self.brightest / self.top
        return unit * (self.group[:, None] == np.arange(self.group.max() + 1))

    @property
    def top(self) -> float:
        """The largest setting."""
        return self.brightest if self.steps is None else float(self.steps)

    def rounded(self, levels: _Array) -> _Array:
        """Levels [L] of four digits, none smaller than they were; steps as they are."""
        levels = np.where(levels > _LEAST * self.brightest, levels, 0.0)
        if self.steps is not None:
            return np.round(levels, 12)
        unit = 10.0 ** (np.floor(np.log10(np.maximum(levels, 1e-300))) - 3)
        return np.minimum(np.round(np.ceil(levels / unit - 1e-6) * unit, 15), self.brightest)


def dim_levels(tasks: Sequence[Task], dimmers: Dimmers, margin: float) -> _Array:
    """Dim levels [L] of least cost.

    Args:
        margin: standard errors by which points exceed their limits.

    Raises:
        LumitreeError: the targets cannot be reached; the message has what can.
    """
    levels = settings = None
    lamps, errors = dimmers.lamps, [np.zeros(len(task.fixed)) for task in tasks]
    high = np.full(lamps.shape[1], dimmers.top)
    whole = np.full(len(high), int(dimmers.steps is not None))
    for _ in range(_ROUNDS):
        found = _Constraints.of(tasks, [margin * error for error in errors])
        rows, limit = found.rows @ lamps, found.limit - found.needed
        settings = _solve(dimmers.cost @ lamps, rows, limit, 0 * high, high, whole)
        if settings is None:
            break
        levels = lamps @ np.clip(settings, 0, high)
        errors = [task.error(levels) for task in tasks]
    if levels is None:
        raise LumitreeError(_shortage(tasks, dimmers))
    if settings is None:
        warnings.warn(
            "the targets are reached only without the margin for the errors of the illuminance; a "
            "smaller error needs less of it",
            LumitreeWarning,
            stacklevel=3,
        )
    return levels


def equal_level(tasks: Sequence[Task], levels: _Array) -> float:
    """The least common level of all lamps whose smallest illuminance is as large on each plane."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = [(task.lux(levels).min() - task.fixed) / task.lamps.sum(axis=1) for task in tasks]
    return max(0.0, float(np.nanmax(np.concatenate(ratios))))


@dataclasses.dataclass(frozen=True, eq=False)
class _Constraints:
    """Constraints of planes, rows x + needed <= limit, for columns x of lamps, and of steps.

    Attributes:
        rows: [M, L].
        limit, needed, size: [M, 1], lx: `needed` is the part of the limit that the plane needs, and
            `size` the illuminance that the constraint is about.
    """

    rows: _Array
    limit: _Array
    needed: _Array
    size: _Array

    @classmethod
    def of(
        cls, tasks: Sequence[Task], margins: Sequence[_Array | float] | None = None
    ) -> _Constraints:
        """All constraints; `margins` are distances of points from their limits, lx."""
        found: list[tuple[_Array, ...]] = []
        for task, margin in zip(tasks, margins or [0.0] * len(tasks), strict=True):
            for rows, limit, *numbers in task.limits(margin):
                columns = (np.full((len(rows), 1), number) for number in numbers)
                found.append((rows, limit[:, None], *columns))
        return cls(*map(np.concatenate, zip(*found, strict=True)))


def best_step(
    tasks: Sequence[Task],
    dimmers: Dimmers,
    low: _Array,
    high: _Array,
    apart: tuple[_Array, _Array] | None = None,
) -> tuple[float, _Array, _Array]:
    """Dim levels, and steps of poses, that are best where the targets may be out of reach.

    Args:
        tasks: with a column for each step beside the lamps'.
        low, high: [K] limits of the steps.
        apart: rows [P, K] of the steps, and limits [P] that they may not exceed.

    Returns:
        Part of the whole cost, and ten times the largest part that lacks of a target; levels [L];
        and steps [K].
    """
    found, smooth = _Constraints.of(tasks), dataclasses.replace(dimmers, steps=None)
    lamps, some = smooth.lamps, found.size[:, 0] > 0
    count, settings = lamps.shape
    # The last variable is the part that lacks.
    rows = np.hstack([found.rows[:, :count] @ lamps, found.rows[:, count:], -found.size])[some]
    cost = np.concatenate([dimmers.cost @ lamps / dimmers.cost.sum(), 0 * low, [_LACK]])
    low = np.concatenate([np.zeros(settings), low, [0]])
    high = np.concatenate([np.full(settings, smooth.top), high, [np.inf]])
    limit = (found.limit - found.needed)[some]
    if apart is not None:
        rows = np.vstack([rows, np.pad(apart[0], ((0, 0), (settings, 1)))])
        limit = np.vstack([limit, apart[1][:, None]])
    best = _solve(cost, rows, limit, low, high)
    assert best is not None
    return float(cost @ best), lamps @ best[:settings], best[settings:-1]


def reachable(tasks: Sequence[Task], dimmers: Dimmers) -> float:
    """The largest part of all targets that can be reached at once, at most 1."""
    found, smooth = _Constraints.of(tasks), dataclasses.replace(dimmers, steps=None)
    rows = np.hstack([found.rows @ smooth.lamps, found.needed])
    high = np.full(rows.shape[1], smooth.top)
    cost, high[-1] = np.zeros(len(high)), 1.0
    cost[-1] = -1.0
    best = _solve(cost, rows, found.limit, 0 * high, high)
    return 0.0 if best is None else max(0.0, float(best[-1]))


def _solve(
    cost: _Array,
    rows: _Array,
    limit: _Array,
    low: _Array,
    high: _Array,
    whole: NDArray[np.int64] | None = None,
) -> _Array | None:
    """The variables of least cost for which rows do not exceed their limits; None without any."""
    # Rows of about 1: the solver's tolerances are absolute.
    size = np.maximum(np.abs(rows).max(axis=1), 1e-300)
    found = milp(
        cost,
        constraints=LinearConstraint(rows / size[:, None], ub=cast(Any, limit[:, 0] / size)),
        bounds=Bounds(cast(Any, low), cast(Any, high)),
        integrality=whole,
        options={"mip_rel_gap": _GAP, "node_limit": _NODES},
    )
    return found.x


def _shortage(tasks: Sequence[Task], dimmers: Dimmers) -> str:
    """The message for targets that cannot be reached: which plane cannot get how much."""
    parts = []
    for task in tasks:
        part = reachable([task], dimmers)
        if part >= _ALL:
            continue
        name, plane = shown(task.name, 100), task.plane
        if plane.maximum is not None and task.fixed.max() > plane.maximum:
            lux = f"{task.fixed.max():.4g} lx by light of no lamp"
            parts.append(f"{name} has {lux}, above its maximum of {plane.maximum:g} lx")
            continue
        even = dataclasses.replace(plane, uniformity=0.0)
        most = reachable([dataclasses.replace(task, plane=even)], dimmers)
        if most < _ALL:
            parts.append(f"{name} gets at most {_amounts(plane, most)}")
        else:
            parts.append(
                f"{name} gets at most {_amounts(plane, part)} with the uniformity "
                f"{plane.uniformity:g}, or all of it with a smaller one"
            )
    if parts:
        return f"the targets cannot be reached: {'; '.join(parts)}"
    part = reachable(tasks, dimmers)
    if part >= _ALL:
        return f"{dimmers.steps} dimming steps are too coarse for the targets; give more"
    each = [
        f"{_amounts(task.plane, part)} for {shown(task.name, 100)}"
        for task in tasks
        if task.plane.target or task.plane.minimum
    ]
    each += [
        f"at most {task.plane.maximum:g} lx for {shown(task.name, 100)}"
        for task in tasks
        if task.plane.maximum is not None
    ]
    return f"the targets cannot be reached together, only {part:.0%} of them: {'; '.join(each)}"


def _amounts(plane: TaskPlane, part: float) -> str:
    """The part of the illuminance that a plane needs, and all of it."""
    needed = ((plane.target, ""), (plane.minimum, " at each point"))
    texts = [f"{part * lux:.4g} of {lux:g} lx{where}" for lux, where in needed if lux]
    return " and ".join(texts) or "none"
