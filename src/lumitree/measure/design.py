"""From lux to lamps: dim levels and places of lamps for the illuminance that planes need."""

import dataclasses
import functools
import itertools
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_count, check_items, check_range, metres_of
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import FilePath, write_bytes, write_json
from lumitree.core.photometry import luminance
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.results import Result, Stopwatch
from lumitree.core.seeds import MAX_SEED, Purpose, SeedStream, check_seed
from lumitree.errors import LumitreeError, LumitreeWarning, explained, shown, shown_names
from lumitree.lamp.parts import matching
from lumitree.measure.dimming import (
    Dimmers,
    TaskPlane,
    dim_levels,
    equal_level,
    reachable,
    sharpened,
    tasks_of,
)
from lumitree.measure.illuminance import (
    IlluminanceResult,
    LitScene,
    check_errors,
    check_illuminance_output,
)
from lumitree.measure.receivers import AreaFigures, Receivers, collect
from lumitree.rendering.placement import Placement, write_placements
from lumitree.rendering.render import layer_names

if TYPE_CHECKING:
    import mitsuba as mi

    from lumitree.measure.figures import Plan

OUTPUTS = (".toml", ".json", ".png", ".pdf")
_MAX_STEPS = 1000
# A result with less than this part of a target is warned of.
_MISSED = 0.98
# Most lamps of `count`, longer over shorter side of a cell of its grid, and least part of the
# targets by which the next number is estimated.
_MAX_COUNT, _LONGEST, _LEAST_PART = 256, 2.0, 0.25
# Multiple of the error that is enough between moves of lamps.
_ROUGH = 2.0
# Range of `brightest`: a lamp is dimmed, or replaced by a brighter one.
_BRIGHTEST = 1e-3, 1e3


@dataclasses.dataclass(frozen=True)
class DesignedLamp:
    """A lamp of a design.

    Attributes:
        label: its name; of an array, the name of its layer in `render`.
        level: dim level; 1 is its light as it was placed.
        lumens: luminous flux at this level, lm.
        placement: where it is, with its light at this level.
    """

    label: str
    level: float
    lumens: float
    placement: Placement = dataclasses.field(repr=False)


@dataclasses.dataclass(frozen=True)
class DesignedArea:
    """The illuminance of a plane of a design.

    Attributes:
        plane: what it has to have.
        before: with all lamps as they were placed.
        predicted: at the dim levels, as the sum of the lamps.
        simulated: in a full simulation of the result, with other random numbers.
    """

    plane: TaskPlane
    before: AreaFigures
    predicted: AreaFigures
    simulated: AreaFigures


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class DesignResult(Result):
    """Result of `design`.

    Attributes:
        lamps: every lamp, in the order of the placements; an array is one lamp for each place.
        areas: the planes.
        unit: of the costs, "lm" or "W".
        cost: luminous flux, or power, of all lamps.
        cost_before: with all lamps as they were placed.
        cost_of_equal_levels: with one dim level for all lamps, at which the smallest illuminance of
            each plane is at least as large; it is above `cost_before` where no dimming reaches it.
        before, after: illuminance as the lamps were placed, and of the result.
    """

    lamps: list[DesignedLamp]
    areas: list[DesignedArea]
    unit: str
    cost: float
    cost_before: float
    cost_of_equal_levels: float
    before: IlluminanceResult = dataclasses.field(repr=False)
    after: IlluminanceResult = dataclasses.field(repr=False)

    @property
    def placements(self) -> list[Placement]:
        """The lamps of the result, for `render` and `illuminance`."""
        return [lamp.placement for lamp in self.lamps]

    @explained
    def save(self, path: FilePath) -> None:
        """Write the design.

        Args:
            path: path of the file. The suffix decides: `.toml` (placements, as `read_placements`
                reads them), `.json` (figures), `.png` or `.pdf` (plans before and after).

        Raises:
            LumitreeError: the name has another ending, or the file cannot be written.
        """
        check_illuminance_output(path, OUTPUTS)
        kind = Path(path).suffix.lower()
        if kind == ".toml":
            write_placements(path, self.placements)
        elif kind == ".json":
            write_json(path, self.to_json())
        else:
            from lumitree.measure.figures import plan_pdf, plan_png

            plans = self._plans()
            png = kind == ".png"
            write_bytes(path, plan_png(plans, False, 2) if png else plan_pdf(plans, False))

    def _repr_png_(self) -> bytes:
        from lumitree.measure.figures import plan_png

        return plan_png(self._plans(), False, 2)

    def _plans(self) -> "list[Plan]":
        """Plans before and after, in turns, both with the colours of one scale."""
        found = []
        for pair in zip(self.before.plans(), self.after.plans(), strict=True):
            largest = max(plan.area.largest for plan in pair)
            for plan, when in zip(pair, ("before", "after"), strict=True):
                area = dataclasses.replace(plan.area, name=f"{plan.area.name}, {when}")
                found.append(dataclasses.replace(plan, area=area, largest=largest, by_lamp={}))
        return found


@in_turn
def design(
    scene: "FilePath | Mapping[str, Any] | Any",
    placements: Sequence[Placement],
    *,
    planes: Sequence[TaskPlane],
    group: Sequence[str] = (),
    move: Mapping[str, str] | None = None,
    turn: Sequence[str] = (),
    free: Sequence[str] = (),
    region: tuple[float, float, float, float, float, float] | None = None,
    count: bool = False,
    watts: Mapping[str, float] | None = None,
    brightest: float = 1.0,
    steps: int | None = None,
    margin: float = 2.0,
    error: float = 0.02,
    time: float | None = None,
    unit: float | str = "m",
    seed: int = 0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> DesignResult:
    """Dim, move and turn lamps so that planes have the illuminance they need, at the least flux.

    The illuminance of each point is the sum over all lamps of dim level times illuminance at full
    light, with all reflections, so the best levels are a linear program. Lamps that may move follow
    the derivatives of their direct light, to a local optimum; shadows and reflections are estimated
    again after some steps. The result is simulated again in full. Lights of the scene count
    as they are.

    Args:
        scene: as for `illuminance`.
        placements: the lamps, as for `illuminance`. Their light as they are placed is dim level 1.
            Each lamp of an array is dimmed by itself.
        planes: the planes, and what each of them needs.
        group: patterns of labels, with * and ?; all lamps that a pattern matches have one level.
        move: axes of the scene that lamps may move along, such as "xz", by patterns of labels.
        turn: patterns of labels of lamps that may turn about their centres.
        free: patterns of labels of lamps that may move along all axes, and turn.
        region: smallest x, y, z and largest x, y, z of the boxes of lamps that move, scene units;
            default: the bounding box of the scene. Furniture in it is not avoided.
        count: whether to repeat the one lamp that is placed on a grid, by the smallest number that
            reaches the targets. The grid is evenly spread along x and z over the region, or over
            the planes, at the height of the lamp.
        watts: electric power at dim level 1, W, by patterns of labels. The power is then minimised,
            and not the luminous flux; it is proportional to the level.
        brightest: largest dim level, 0.001 to 1,000.
        steps: number of equal steps up to it, 1 to 1,000, where lamps have no other levels; 1 is
            on or off.
        margin: standard errors by which each point keeps away from its limits, 0 to 10. Without,
            the least illuminance is too small by about the error of the points that have it.
        error: standard error of the illuminance of each point, as for `illuminance`; a quarter
            of it where a plane has its limits.
        time: limit of each simulation, s, as for `illuminance`.
        unit: unit of length of the scene, as for `illuminance`.
        seed: root seed of all random numbers, 0 to 2³¹ - 1.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each pass; see `bake`.

    Returns:
        Dim levels, and the illuminance before, predicted, and simulated.

    Raises:
        LumitreeError: an argument is out of range; a scene or lamp cannot be read; a lamp is
            explicit; or the lamps cannot give what the planes need. Then the message states which
            plane gets how much.

    Example:
        >>> lamps = lumitree.read_placements("lights.toml")
        >>> work = lumitree.TaskPlane((0, 0.75, 0), extent=(4, 3), target=500, uniformity=0.6)
        >>> result = lumitree.design("office.xml", lamps, planes=[work])
        >>> result.save("dimmed.toml")
    """
    for name, values, kind in (
        ("placements", placements, Placement),
        ("planes", planes, TaskPlane),
    ):
        check_items(name, values, kind)
    check_range("brightest", brightest, *_BRIGHTEST)
    if steps is not None:
        check_count("steps", steps, 1, _MAX_STEPS)
    check_range("margin", margin, 0, 10)
    check_errors(error, time)
    if region is not None and not (np.array(region[:3]) <= region[3:]).all():
        raise LumitreeError(
            f"region is {shown(region, 100)}; expected its smallest x, y, z before its largest"
        )
    check_seed(seed)
    if not any(plane.target or plane.minimum for plane in planes):
        raise LumitreeError("no plane has a target; give one its target or its minimum, in lux")
    lamps = _named(placements)
    labels = [str(lamp.label) for lamp in lamps]
    if not lamps:
        raise LumitreeError("there are no lamps to dim; place one")
    if explicit := [lamp.name for lamp in lamps if not lamp.is_baked]:
        raise LumitreeError(
            f"{shown_names(sorted(set(explicit)))} cannot be dimmed as explicit geometry; bake it "
            "first, and place the asset"
        )
    if count and (len(lamps) != 1 or lamps[0].at is None):
        raise LumitreeError("count is for one lamp; place one, and say by at how high it hangs")
    load_rgb(variant)
    from lumitree.measure.aiming import Aim
    from lumitree.rendering.scene import load_without_camera, scene_title

    metres_of(unit)
    title = scene_title(scene)
    seeds = iter(
        SeedStream(Purpose.DESIGN, draw=1).seed(seed, n) & MAX_SEED for n in itertools.count()
    )
    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("lamps"):
            room, _ = load_without_camera(scene)
            receivers = collect(planes, (), (), None, None, seed)
            box = _region(region, room, receivers, lamps, count)

            def lit(lamps: Sequence[Placement]) -> LitScene:
                return LitScene(room, title, lamps, receivers, unit, by_lamp=True)

            if count:

                def simulate(lamps: Sequence[Placement]) -> IlluminanceResult:
                    return lit(lamps).estimate(error, time, next(seeds), plans=False)

                lamps = _counted(lamps[0], box, planes, simulate, brightest)
                labels = [str(lamp.label) for lamp in lamps]
            groups = np.unique(_groups(labels, group), return_inverse=True)[1]
            axes = _axes(labels, move or {}, turn, free)
            whole = lit(lamps)
            lumens = np.array([float(luminance(each.watts)) for each in whole.placed])
            cost = lumens if watts is None else _powers(watts, labels)
            dimmers = Dimmers(groups, cost, brightest, steps)
            found = before = whole.estimate(error, time, next(seeds))
        if axes.any():

            def moved(lamps: Sequence[Placement]) -> IlluminanceResult:
                whole.move(lamps)
                rough = min(_ROUGH * error, 1.0)
                return whole.estimate(rough, time, next(seeds), plans=False)

            with watch.stage("places"):
                aim = Aim(planes, whole.placed, axes, box, dimmers, moved, seed)
                lamps, found = aim.search(before)
                whole.move(lamps)
        sharper = functools.partial(sharpened, whole, planes, error, time, seeds)
        with watch.stage("levels"):
            _, tasks, levels = sharper(
                found, lambda tasks: dimmers.rounded(dim_levels(tasks, dimmers, margin))
            )
        with watch.stage("simulation"):
            placed = [
                lamp.dimmed(level) for lamp, level in zip(lamps, levels.tolist(), strict=True)
            ]
            whole.move(placed)
            after = whole.estimate(error, time, next(seeds))
            after, *_ = sharper(after, lambda _: np.ones(len(levels)))
    for task, new in zip(tasks, after.areas, strict=True):
        if new.mean < _MISSED * task.plane.target:
            warnings.warn(
                f"{shown(new.name, 100)} has {new.mean:.4g} of {task.plane.target:g} lx in the "
                "simulation of the result; a smaller error helps",
                LumitreeWarning,
                stacklevel=2,
            )
    areas = [
        DesignedArea(task.plane, old, task.figures(old, levels), new)
        for task, old, new in zip(tasks, before.areas, after.areas, strict=True)
    ]
    return DesignResult(
        lamps=[
            DesignedLamp(*each)
            for each in zip(
                labels, levels.tolist(), (lumens * levels).tolist(), placed, strict=True
            )
        ],
        areas=areas,
        unit="lm" if watts is None else "W",
        cost=float(cost @ levels),
        cost_before=float(cost.sum()),
        cost_of_equal_levels=float(cost.sum()) * equal_level(tasks, levels),
        before=before,
        after=after,
        **watch.costs(),
    )


def _region(
    region: Sequence[float] | None,
    room: "mi.Scene",
    areas: Sequence[Receivers],
    lamps: Sequence[Placement],
    count: bool,
) -> NDArray[np.float64]:
    """Corners [2, 3] of the box for lamps: by default the room's, or of all points for `count`."""
    scene = np.array([room.bbox().min, room.bbox().max], np.float64).reshape(2, 3)
    points = np.concatenate([area.points for area in areas])
    if region is None:
        return np.array([points.min(axis=0), points.max(axis=0)]) if count else scene
    box = np.array(region, np.float64).reshape(2, 3)
    places = [lamp.at for lamp in lamps if lamp.at is not None]
    known = np.concatenate([scene, points, np.reshape(places, (-1, 3))])
    low, high = known.min(axis=0), known.max(axis=0)
    if (box[0] > high).any() or (box[1] < low).any():
        low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in (low, high))
        raise LumitreeError(
            f"region is {shown(region, 100)}, outside of the scene; the scene, its planes and its "
            f"lamps are between {low} and {high}"
        )
    return box


def _named(placements: Sequence[Placement]) -> list[Placement]:
    """All lamps of placements, each with a label of its own: else with the name of its layer."""
    lamps = [lamp for placement in placements for lamp in placement.each()]
    given, names = [lamp.label for lamp in lamps], layer_names(lamps)[1:]
    labels = [
        label if label and given.count(label) == 1 and label not in names else name
        for label, name in zip(given, names, strict=True)
    ]
    return [
        dataclasses.replace(lamp, label=label) for lamp, label in zip(lamps, labels, strict=True)
    ]


def _matches(option: str, pattern: str, labels: Sequence[str]) -> NDArray[np.bool_]:
    names = [[label] for label in labels]
    return np.array(matching(pattern, option, names, "the placements", "lamp"))


def _groups(labels: Sequence[str], patterns: Sequence[str]) -> NDArray[np.int64]:
    """[L] a number for each lamp, equal for the lamps of a group."""
    groups = np.arange(len(labels))
    for pattern in patterns:
        joined = np.unique(groups[_matches("group", pattern, labels)])
        groups[np.isin(groups, joined)] = joined[0]
    return groups


def _powers(watts: Mapping[str, float], labels: Sequence[str]) -> NDArray[np.float64]:
    """[L] electric power of each lamp, W."""
    found = np.full(len(labels), np.nan)
    for pattern, value in watts.items():
        check_range("watts", value, 1e-6, 1e9, "W")
        found[_matches("watts", pattern, labels)] = value
    if np.isnan(found).any():
        missing = [label for label, value in zip(labels, found, strict=True) if np.isnan(value)]
        raise LumitreeError(f"watts are not given for {shown_names(missing)}; give all or none")
    return found


def _counted(
    lamp: Placement,
    box: NDArray[np.float64],
    planes: Sequence[TaskPlane],
    simulate: Callable[[Sequence[Placement]], IlluminanceResult],
    brightest: float,
) -> list[Placement]:
    """The lamps of the smallest grid, along x and z over a box [2, 3], that reaches the targets."""
    grids = dict(_grids(lamp, box))
    numbers, index, short, enough = list(grids), 0, -1, len(grids)
    while enough - short > 1:
        number = numbers[index]
        tasks = tasks_of(planes, simulate(grids[number]))
        part = reachable(tasks, Dimmers(np.arange(number), np.ones(number), brightest))
        if part >= 1 - 1e-6:
            enough, index = index, index - 1
            continue
        short = index
        if index == len(numbers) - 1:
            raise LumitreeError(
                f"{number} lamps reach {part:.0%} of the targets, and more are not tried; use "
                "brighter lamps, or less uniformity"
            )
        estimate = number / max(part, _LEAST_PART)
        larger = [each for each in range(index + 1, enough) if numbers[each] >= estimate]
        index = larger[0] if larger else enough - 1
    return grids[numbers[enough]]


def _grids(lamp: Placement, box: NDArray[np.float64]) -> Iterator[tuple[int, list[Placement]]]:
    """Numbers of lamps, and the lamps in cells of a box that are about as long as wide."""
    assert lamp.at is not None
    (x, _, z), sides = box.mean(axis=0).tolist(), np.maximum(np.ptp(box, axis=0)[[0, 2]], 1e-6)
    for number in range(1, _MAX_COUNT + 1):
        shapes = [(each, number // each) for each in range(1, number + 1) if number % each == 0]
        ratios = [np.ptp(np.log(sides / shape)) for shape in shapes]
        best = int(np.argmin(ratios))
        if number == 1 or ratios[best] <= np.log(_LONGEST):
            pitch, at = tuple((sides / shapes[best]).tolist()), (x, lamp.at[1], z)
            array = dataclasses.replace(lamp, at=at, grid=shapes[best], pitch=pitch)
            yield number, _named([array])


def _axes(
    labels: Sequence[str], move: Mapping[str, str], turn: Sequence[str], free: Sequence[str]
) -> NDArray[np.bool_]:
    """[L, 6] whether each lamp may move along, and turn about, x, y and z of the scene."""
    found = np.zeros((len(labels), 6), bool)
    for pattern, names in move.items():
        if not names or set(names) - set("xyz"):
            raise LumitreeError(f"move has {shown(repr(names), 40)}; expected axes such as 'xz'")
        for axis in map("xyz".index, names):
            found[_matches("move", pattern, labels), axis] = True
    for pattern in turn:
        found[_matches("turn", pattern, labels), 3:] = True
    for pattern in free:
        found[_matches("free", pattern, labels)] = True
    return found
