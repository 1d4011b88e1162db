"""Illuminance of planes, surfaces and points of a scene with luminaires placed in it."""

import csv
import dataclasses
import io
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.arguments import check_items, check_range, metres_of
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import FilePath, check_writable, write_bytes, write_json
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.results import Json, Result, Stopwatch, plain
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, LumitreeWarning, explained, shown, shown_names
from lumitree.measure.receivers import (
    AreaFigures,
    LampIlluminance,
    Plane,
    Receivers,
    Surface,
    chosen_shapes,
    collect,
)
from lumitree.rendering.placement import Placement
from lumitree.rendering.render import layer_names

if TYPE_CHECKING:
    import mitsuba as mi

    from lumitree.measure.figures import Plan
    from lumitree.measure.floor_plan import FloorPlan
    from lumitree.rendering.integrator import PathScene
    from lumitree.rendering.scene import PlacedLuminaire

OUTPUTS = (".csv", ".json", ".png", ".pdf")
# Columns of a table of receivers.
_COLUMNS = (
    *("area", "x", "y", "z", "nx", "ny", "nz"),
    *("direct_lx", "direct_error_lx", "total_lx", "total_error_lx"),
)
# Fields of an estimate that a result has.
_FOUND = ("direct", "direct_error", "total", "total_error", "samples")
# Parts of lamps at points, at most; each takes 200 bytes.
_MAX_PARTS = 10_000_000


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class IlluminanceResult(Result):
    """Result of `illuminance`.

    Attributes:
        areas: figures of each plane, surface, and of the points that were given.
        direct_only: whether the total is the direct illuminance, without reflected light.
        position, normal: [N, 3] of the receivers, scene coordinates.
        direct, total: [N] illuminance straight from emitters, and with all reflections, lx; NaN
            inside solids.
        direct_error, total_error: [N] their standard errors, lx.
        samples: [N] samples of each receiver.
        by_lamp: the parts of each lamp, whose sums are `direct` and `total`; None without the
            option `by_lamp`.
        unit: of lengths of the scene, as it was given.
    """

    areas: list[AreaFigures]
    direct_only: bool
    position: NDArray[np.float64] = dataclasses.field(repr=False)
    normal: NDArray[np.float64] = dataclasses.field(repr=False)
    direct: NDArray[np.float64] = dataclasses.field(repr=False)
    direct_error: NDArray[np.float64] = dataclasses.field(repr=False)
    total: NDArray[np.float64] = dataclasses.field(repr=False)
    total_error: NDArray[np.float64] = dataclasses.field(repr=False)
    samples: NDArray[np.int64] = dataclasses.field(repr=False)
    by_lamp: LampIlluminance | None = dataclasses.field(repr=False)
    receivers: list[Receivers] = dataclasses.field(repr=False)
    floors: "list[FloorPlan | None]" = dataclasses.field(repr=False)
    unit: float | str

    @explained
    def save(self, path: FilePath) -> None:
        """Write the illuminance.

        Args:
            path: path of the file. The suffix decides: `.csv` or `.json` (each receiver), `.png`
                (plan in false colours with isolux lines), or `.pdf` (plan and table, A4).

        Raises:
            LumitreeError: the name has another ending, or the file cannot be written.
        """
        check_illuminance_output(path)
        kind = Path(path).suffix.lower()
        if kind == ".json":
            write_json(path, self.to_json() | {"receivers": plain(self.table())})
        elif kind == ".csv":
            write_bytes(path, self._csv())
        else:
            from lumitree.measure.figures import plan_pdf, plan_png

            write = plan_png if kind == ".png" else plan_pdf
            write_bytes(path, write(self.plans(), self.direct_only))

    def table(self) -> list[Json]:
        """A dictionary for each receiver, as the files have it."""
        names = [area.name for area in self.areas for _ in range(area.count)]
        light = (self.direct, self.direct_error, self.total, self.total_error)
        parts = {} if self.by_lamp is None else self.by_lamp.columns()
        numbers = np.column_stack([self.position, self.normal, *light, *parts.values()]).tolist()
        return [
            dict(zip((*_COLUMNS, *parts), (name, *row), strict=True))
            for name, row in zip(names, numbers, strict=True)
        ]

    def _csv(self) -> bytes:
        stream = io.StringIO(newline="")
        writer = csv.writer(stream)
        table = self.table()
        writer.writerow(table[0])
        for row in table:
            name, *numbers = row.values()
            # Empty inside solids.
            texts = ("" if math.isnan(number) else f"{number:.6g}" for number in numbers)
            writer.writerow((name, *texts))
        return stream.getvalue().encode()

    def _repr_png_(self) -> bytes:
        from lumitree.measure.figures import plan_png

        return plan_png(self.plans(), self.direct_only)

    def plans(self) -> "list[Plan]":
        """A plan for each area, for figures."""
        from lumitree.measure.figures import Plan

        arrays = (self.total, self.total_error, self.direct)
        return [
            Plan(
                area,
                receivers,
                *(each[area.part] for each in arrays),
                floor=floor,
                unit=self.unit if isinstance(self.unit, str) else f"{self.unit:g} m",
                by_lamp={} if self.by_lamp is None else self.by_lamp.lit(area),
            )
            for area, receivers, floor in zip(self.areas, self.receivers, self.floors, strict=True)
        ]


@in_turn
def illuminance(
    scene: "FilePath | Mapping[str, Any] | Any",
    placements: Sequence[Placement] = (),
    *,
    planes: Sequence[Plane] = (),
    surfaces: Sequence[Surface] = (),
    points: ArrayLike | None = None,
    normals: ArrayLike | None = None,
    error: float = 0.02,
    time: float | None = None,
    direct: bool = False,
    by_lamp: bool = False,
    unit: float | str = "m",
    seed: int = 0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> IlluminanceResult:
    """Illuminance of planes, surfaces and points of a scene, with standard errors.

    All lights of the scene count, with reflections of any number. Direct light from the light
    fields of baked luminaires is summed, and only its shadows are sampled. Straight light of
    luminaires with geometry is sampled, with shadow rays to their emitters. `direct_illuminance`
    has derivatives by the lamps.

    Args:
        scene: as for `render`, but it needs no camera, and its integrator does not count. It may
            not have heterogeneous media.
        placements: the luminaires, as for `render`.
        planes: rectangles with grids of points.
        surfaces: shapes of the scene.
        points: [N, 3] further points, scene coordinates.
        normals: [N, 3] or [3] normals of these points, of any length.
        error: standard error of the total at each point that is enough, relative to the illuminance
            there or, if this is more, to a tenth of the mean of all points; 0.0001 to 1.
        time: after which no more light is sampled, s, 0.001 to 10⁷; default: no limit.
        direct: whether to omit reflected light.
        by_lamp: whether to also return the part of each lamp at each point, from the same samples.
            Then no part has a larger standard error than the total may have at the point, or at a
            point with the mean total.
        unit: unit of length of the scene: "m", "cm", "mm", "in", "ft", or the metres in a unit. It
            counts for `Placement.lumens` and for photometric files, which state metres; the
            illuminance of all other lamps follows from radiance.
        seed: root seed of all random numbers, 0 to 2³¹ - 1.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each pass; see `bake`.

    Returns:
        Illuminance of all receivers: first of planes, then of surfaces and points.

    Raises:
        LumitreeError: an argument is out of range; there is no receiver, or no emitter; or the
            scene, an asset or a luminaire cannot be read.

    Example:
        >>> desk = lumitree.Plane((0, 0.75, 0), (0, 1, 0), extent=(1.6, 0.8), spacing=0.1)
        >>> lamp = lumitree.Placement("lamp.lumitree", at=(0, 2.2, 0))
        >>> result = lumitree.illuminance("room.xml", [lamp], planes=[desk])
        >>> print(result.areas[0].mean, "lx")
        >>> result.save("desk.png")
    """
    for name, values, kind in (
        ("placements", placements, Placement),
        ("planes", planes, Plane),
        ("surfaces", surfaces, Surface),
    ):
        check_items(name, values, kind)
    placements = [lamp for placement in placements for lamp in placement.each()]
    check_errors(error, time)
    check_seed(seed)
    metres_of(unit)
    load_rgb(variant)
    from lumitree.rendering.scene import load_without_camera, scene_title

    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("load"):
            title = scene_title(scene)
            room, shapes = load_without_camera(scene)
            chosen = [chosen_shapes(each, room, shapes, title) for each in surfaces]
            areas = collect(planes, surfaces, chosen, points, normals, seed)
            lit = LitScene(room, title, placements, areas, unit, by_lamp)
        with watch.stage("estimate"):
            result = lit.estimate(error, time, seed, reflected=not direct)
    for area in result.areas:
        if area.enclosed == area.count:
            warnings.warn(
                f"all points of {shown(area.name, 200)} are inside solids, or outside of the room; "
                "look at its position, and at the unit of the scene",
                LumitreeWarning,
                stacklevel=2,
            )
    return dataclasses.replace(result, **watch.costs())


def check_errors(error: float, time: float | None) -> None:
    """Refuse the options of `illuminance` that limit samples, if they are out of range."""
    check_range("error", error, 1e-4, 1)
    if time is not None:
        check_range("time", time, 1e-3, 1e7)


class LitScene:
    """A scene with lamps, and receivers whose illuminance is estimated; the lamps may be moved.

    Args:
        room: mi.Scene without the lamps.
        title: of the scene, for messages.
        placements: the lamps, each by itself.
        areas: the receivers.
        unit: of length of the scene.
        by_lamp: whether the part of each lamp is estimated, too.
    """

    def __init__(
        self,
        room: "mi.Scene",
        title: str,
        placements: Sequence[Placement],
        areas: list[Receivers],
        unit: float | str,
        by_lamp: bool,
    ) -> None:
        from lumitree.rendering.scene import open_placements, place_luminaires, placed_ids

        self._room, self._title, self._areas, self._unit = room, title, areas, unit
        self.placed = open_placements(placements, metres_of(unit))
        _warn_of_glass(self.placed)
        self._scene = place_luminaires(room, self.placed, appearance="geometry")
        self._points = np.concatenate([area.points for area in areas])
        self._normals = np.concatenate([area.normals for area in areas])
        if by_lamp:
            _check_parts(len(placements), len(self._points))
        self._ids = placed_ids(self.placed) if by_lamp else None
        self._names = layer_names(placements)
        self._light()

    def _light(self) -> None:
        _light_boxes(self._scene, self._points)
        self._paths = _paths(self._scene, self._title, self._ids)

    def move(self, placements: Sequence[Placement]) -> None:
        """Place the same lamps, which are baked, elsewhere, or with other brightness."""
        from lumitree.rendering.emitter import lamp_of
        from lumitree.rendering.scene import placed_ids

        lamps = [each for each in self._scene.emitters() if lamp_of(each) is not None]
        emitters = {each.get_shape().id(): each for each in lamps}
        # The scene's own acceleration structure is of no use here, and is not built again.
        self.placed = [
            placed.moved(emitters[f"{start}proxy"], placement)
            for start, placed, placement in zip(
                placed_ids(self.placed), self.placed, placements, strict=True
            )
        ]
        self._light()

    def estimate(
        self,
        error: float,
        seconds: float | None,
        seed: int,
        *,
        reflected: bool = True,
        plans: bool = True,
    ) -> IlluminanceResult:
        """The illuminance of all receivers.

        Args:
            error, seconds, reflected, seed: as of `illuminance_estimate.estimate`.
            plans: whether plans show the room.
        """
        from lumitree.measure.floor_plan import floor_plan
        from lumitree.measure.illuminance_estimate import estimate

        found = estimate(
            self._paths,
            self._points,
            self._normals,
            error=error,
            seconds=seconds,
            reflected=reflected,
            seed=seed,
        )
        planes = [area.plane if plans else None for area in self._areas]
        return IlluminanceResult(
            unit=self._unit,
            areas=_figures(self._areas, found.total, found.total_error),
            direct_only=not reflected,
            position=self._points,
            normal=self._normals / np.linalg.norm(self._normals, axis=1)[:, None],
            receivers=self._areas,
            floors=[plane and floor_plan(plane, self._room, self.placed) for plane in planes],
            by_lamp=None if found.by_lamp is None else LampIlluminance(self._names, *found.by_lamp),
            **{name: getattr(found, name) for name in _FOUND},
            **Stopwatch().costs(),
        )

    def again(
        self,
        result: IlluminanceResult,
        index: NDArray[np.int64],
        error: float,
        seconds: float | None,
        seed: int,
    ) -> IlluminanceResult:
        """A result of `estimate` by lamp, in which receivers of an index have other samples."""
        from lumitree.measure.illuminance_estimate import estimate

        points, normals = self._points[index], self._normals[index]
        options = {"error": error, "seconds": seconds, "seed": seed, "reflected": True}
        found = estimate(self._paths, points, normals, **options)
        assert result.by_lamp is not None
        assert found.by_lamp is not None
        values = {name: getattr(result, name).copy() for name in _FOUND}
        for name in _FOUND:
            values[name][index] = getattr(found, name)
        parts = np.stack(result.by_lamp.arrays)
        parts[..., index] = found.by_lamp
        return dataclasses.replace(
            result,
            areas=_figures(self._areas, values["total"], values["total_error"]),
            by_lamp=LampIlluminance(self._names, *parts),
            **values,
        )


def _figures(
    areas: Sequence[Receivers], lux: NDArray[np.float64], error: NDArray[np.float64]
) -> list[AreaFigures]:
    """Figures of each area, from the illuminance of all receivers and the standard errors."""
    found, first = [], 0
    for area in areas:
        part = slice(first, first + len(area.points))
        found.append(AreaFigures.of(area.name, first, lux[part], error[part]))
        first = part.stop
    return found


def check_illuminance_output(path: FilePath, endings: Sequence[str] = OUTPUTS) -> None:
    """Refuse a file that a result cannot write, by default `IlluminanceResult.save`."""
    if Path(path).suffix.lower() not in endings:
        name = shown(repr(str(path)), 300)
        raise LumitreeError(f"output {name} does not end in one of {', '.join(endings)}")
    check_writable(path)


def _warn_of_glass(placed: "Sequence[PlacedLuminaire]") -> None:
    """Warn of explicit lamps with glass, whose light is found by rare paths."""
    for each in placed:
        file = None if each.luminaire is None else each.luminaire.file
        names = [] if file is None else [node.props.plugin_name() for node in file.nodes("BSDF")]
        if any("dielectric" in name and not name.startswith("thin") for name in names):
            warnings.warn(
                f"{each.title} is placed as explicit geometry with glass, through which light is "
                "found by rare paths, so that illuminance takes long; bake it first",
                LumitreeWarning,
                stacklevel=3,
            )


def _check_parts(lamps: int, points: int) -> None:
    """Refuse more parts of lamps than memory is likely to hold."""
    if (lamps + 1) * points > _MAX_PARTS:
        raise LumitreeError(
            f"there are {points:,} points for {lamps:,} lamps and the room; expected at most "
            f"{_MAX_PARTS:,} parts: use a larger spacing, or omit by_lamp"
        )


def _paths(scene: Any, title: str, lamps: Sequence[str] | None) -> "PathScene":
    """A scene with luminaires, for paths; `lamps` as for `EmitterGroups`, if they are estimated."""
    from lumitree.lamp.media import any_heterogeneous, media
    from lumitree.rendering.geometry import GeometryEmitter
    from lumitree.rendering.integrator import PathScene
    from lumitree.rendering.layers import EmitterGroups, PathSums
    from lumitree.rendering.proxies import DividedScene

    if any_heterogeneous(scene):
        raise LumitreeError(
            f"{title} has a heterogeneous medium, whose light is not estimated; make it "
            "homogeneous, or remove it"
        )
    if not scene.emitters():
        raise LumitreeError(f"{title} has no light; place a lamp or add an emitter")
    # Their light would not be sampled. The geometry of baked lamps is not in question.
    shapes = {shape.emitter(): shape for shape in scene.shapes() if shape.is_emitter()}
    unsampled = [
        shapes[each].id() or f"a {shapes[each].class_name().lower()}"
        if each in shapes
        else each.id() or each.class_name()
        for each in scene.emitters()
        if each.sampling_weight() <= 0 and not isinstance(each, GeometryEmitter)
    ]
    if unsampled:
        raise LumitreeError(
            f"{title} has emitters with the sampling_weight 0, whose light would be missing "
            f"({shown_names(unsampled)}); give them a larger one"
        )
    layers = None if lamps is None else PathSums(EmitterGroups(scene, lamps))
    return PathScene(scene, DividedScene().of(scene), media(scene), layers=layers)


def _light_boxes(scene: Any, points: NDArray[np.float64]) -> None:
    """Let lamps light the inside of their boxes if there are points in them."""
    from lumitree.rendering.emitter import lamps_of

    for lamp in lamps_of(scene.emitters()).values():
        box = np.linalg.inv(lamp.scene_from_box)
        local = points @ box[:3, :3].T + box[:3, 3]
        if (np.abs(local) <= 1.01).all(axis=1).any():
            lamp.has_receivers = True
