"""Receivers of illuminance: points with normals on planes and surfaces of a scene, or given.

`AreaFigures` are the figures of the illuminance of an area of receivers, and `LampIlluminance` is
the part of each lamp.
"""

from __future__ import annotations

import array
import csv
import dataclasses
import io
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.arguments import check_range
from lumitree.core.files import FilePath
from lumitree.core.reading import read_bytes
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.parts import matching
from lumitree.lamp.scene_shapes import CHOSEN_BY, SceneShape

if TYPE_CHECKING:
    import mitsuba as mi

# Points of a call, and of an area, at most.
MAX_POINTS = 1 << 20
# Lamps whose maps a plan has.
MAX_MAPS = 24
_MAX_FILE_BYTES, _MAX_LINE = 1 << 28, 1 << 16
_COLUMNS = ("x", "y", "z", "nx", "ny", "nz")
_MAX_LENGTH = 1e9


@dataclasses.dataclass(frozen=True)
class Plane:
    """A rectangle with a grid of points, whose illuminance is estimated.

    The plane has the axes u and v: seen with the normal towards the viewer, u points to the right
    and v up. u is the projection of the scene's axis x; if x is the normal, it is y. So a floor
    with y up is seen with x to the right and -z up. The rectangle is divided into equal cells,
    about `spacing` wide, and the points are their centres.

    Attributes:
        centre: centre of the rectangle [3], scene units.
        normal: [3], of any length; default: y.
        extent: sides along u and v, scene units; default: 1 and 1.
        spacing: distance of neighbouring points, scene units; default: 0.25.
        name: for tables and plots; default: "plane" and a number.

    Raises:
        LumitreeError: a number is out of range, the normal is 0, or there are more than 1,048,576
            points.
    """

    centre: tuple[float, float, float]
    normal: tuple[float, float, float] = (0.0, 1.0, 0.0)
    extent: tuple[float, float] = (1.0, 1.0)
    spacing: float = 0.25
    name: str | None = None

    def __post_init__(self) -> None:
        for name, value, count in (
            ("centre", self.centre, 3),
            ("normal", self.normal, 3),
            ("extent", self.extent, 2),
        ):
            try:
                numbers = np.asarray(value, np.float64)
            except (TypeError, ValueError):
                numbers = np.zeros(0)
            if numbers.shape != (count,) or not (np.abs(numbers) <= _MAX_LENGTH).all():
                found = shown(value, 80)
                raise LumitreeError(f"{name} is {found}; expected {count} finite numbers")
        check_range("spacing", self.spacing, 1 / _MAX_LENGTH, _MAX_LENGTH)
        if not np.linalg.norm(self.normal) > 0:
            raise LumitreeError("the normal of a plane is 0; expected a direction")
        if not min(self.extent) > 0:
            raise LumitreeError(f"extent is {self.extent}; expected two lengths above 0")
        _check_count(math.prod(self.shape))

    @property
    def shape(self) -> tuple[int, int]:
        """Points along v and along u."""
        columns, rows = (max(1, round(each / self.spacing)) for each in self.extent)
        return rows, columns

    @property
    def axes(self) -> NDArray[np.float64]:
        """Unit vectors [3, 3]: u, v and the normal."""
        return _axes(np.asarray(self.normal, np.float64))

    def points(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points and normals [N, 3], rows along u from the smallest v on."""
        rows, columns = self.shape
        u, v = ((np.arange(n) + 0.5) / n - 0.5 for n in (columns, rows))
        grid = np.stack(np.meshgrid(u * self.extent[0], v * self.extent[1]), axis=-1)
        points = np.asarray(self.centre) + grid.reshape(-1, 2) @ self.axes[:2]
        return points, np.tile(self.axes[2], (len(points), 1))


@dataclasses.dataclass(frozen=True)
class Surface:
    """A shape of the scene, whose illuminance is estimated on the side of its normals.

    Attributes:
        shape: its id in the scene, the id of its BSDF, or its number such as "#3", from 0 in the
            order of the file. * and ? stand for any characters; all shapes that match count.
        spacing: root of the area for each point, scene units.

    Raises:
        LumitreeError: the spacing is out of range.
    """

    shape: str
    spacing: float = 0.25

    def __post_init__(self) -> None:
        check_range("spacing", self.spacing, 1 / _MAX_LENGTH, _MAX_LENGTH)

    def points(
        self, shapes: Sequence[mi.Shape], seed: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points and normals [N, 3], spread evenly over the shapes that `chosen_shapes` returns.

        Raises:
            LumitreeError: there are too many.
        """
        import mitsuba as mi

        from lumitree.core.device import on_device

        areas = [float(np.ravel(shape.surface_area())[0]) for shape in shapes]
        counts = [max(1, round(area / self.spacing**2)) for area in areas]
        _check_count(sum(counts))
        # An additive recurrence covers the unit square evenly (Roberts 2018).
        golden = 1.32471795724474602596
        start = np.random.default_rng(SeedStream(Purpose.ILLUMINANCE, draw=2).seed(seed)).random(2)
        points, normals = [], []
        for shape, count in zip(shapes, counts, strict=True):
            sample = (start + np.arange(1, count + 1)[:, None] / golden ** np.array([1, 2])) % 1
            at = shape.sample_position(0, on_device(mi.Point2f, sample))
            # A flat shape returns a single normal.
            for rows, each in ((points, at.p), (normals, at.n)):
                rows.append(np.broadcast_to(np.array(each, np.float64).T, (count, 3)))
        return np.concatenate(points), np.concatenate(normals)


def chosen_shapes(
    surface: Surface, scene: mi.Scene, shapes: Sequence[SceneShape], title: str
) -> list[mi.Shape]:
    """The mi.Shape objects of a scene that a surface names.

    Raises:
        LumitreeError: there are none, or points cannot be spread over one, as over an instance.
    """
    names, listed = [each.names for each in shapes], list(map(str, shapes))
    chosen = matching(surface.shape, "--surface", names, title, CHOSEN_BY, listed)
    found = []
    for made, described, wanted in zip(scene.shapes(), shapes, chosen, strict=True):
        if wanted and made.class_name() == "Instance":
            raise LumitreeError(
                f"{title}: {described.label} is an instance, over which no points are spread; give "
                "a plane or points"
            )
        found += [made] * wanted
    return found


@dataclasses.dataclass(frozen=True, eq=False)
class Receivers:
    """The receivers of one area.

    Attributes:
        name: of the area.
        points, normals: [N, 3].
        plane: the plane that they are on, if it is one.
    """

    name: str
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    plane: Plane | None = None

    @property
    def axes(self) -> NDArray[np.float64]:
        """Axes u and v [2, 3] of their plane, or of the plane normal to the mean normal."""
        return (_axes(self.normals.mean(axis=0)) if self.plane is None else self.plane.axes)[:2]

    def flat(self) -> NDArray[np.float64]:
        """Coordinates [N, 2] along u and v, from the origin of the scene."""
        return self.points @ self.axes.T


@dataclasses.dataclass(frozen=True)
class AreaFigures:
    """Figures of the illuminance of an area, by EN 12464-1.

    Attributes:
        name: of the area.
        first, count: which of the receivers are on it.
        enclosed: how many of them are inside solids, and do not count.
        mean, smallest, largest: of the illuminance, lx; NaN if all are inside solids.
        mean_error: standard error of the mean, lx, for independent errors of the receivers.
        uniformity: U₀, smallest over mean; NaN where all is dark.
        diversity: U_d, smallest over largest; NaN where all is dark.
    """

    name: str
    first: int
    count: int
    enclosed: int
    mean: float
    mean_error: float
    smallest: float
    largest: float
    uniformity: float
    diversity: float

    @classmethod
    def of(
        cls, name: str, first: int, lux: NDArray[np.float64], error: NDArray[np.float64]
    ) -> AreaFigures:
        """Figures of an area from the illuminance [N] of its receivers and the standard errors."""
        known = np.isfinite(lux)
        count, enclosed = len(lux), int((~known).sum())
        if enclosed == count:
            return cls(name, first, count, enclosed, *[np.nan] * 6)
        lux, error = lux[known], error[known]
        mean, low, high = float(lux.mean()), float(lux.min()), float(lux.max())
        mean_error = float(np.sqrt((error**2).sum())) / len(lux)
        ratios = (low / mean, low / high) if mean > 0 else (np.nan, np.nan)
        return cls(name, first, count, enclosed, mean, mean_error, low, high, *ratios)

    @property
    def part(self) -> slice:
        """Which of the receivers are on the area."""
        return slice(self.first, self.first + self.count)


@dataclasses.dataclass(frozen=True)
class LampIlluminance:
    """Illuminance of N receivers by each of L lamps, lx; NaN inside solids.

    All parts come from one set of samples, and the paths carry the lamp that gave the light. A
    sample of direct light is of one lamp, which is chosen by its light, and a path of reflected
    light may have light of each. The errors are the spread of the sums over each path: they are
    correlated between lamps, so that the error of a sum over lamps is not their root sum of
    squares.

    Attributes:
        names: as the layers of `render` have them; first "room", which is all light of no placed
            lamp, and then each lamp, of arrays too.
        direct, reflected: [L, N].
        direct_error, reflected_error: [L, N] their standard errors.
    """

    names: list[str]
    direct: NDArray[np.float64]
    direct_error: NDArray[np.float64]
    reflected: NDArray[np.float64]
    reflected_error: NDArray[np.float64]

    @property
    def arrays(self) -> tuple[NDArray[np.float64], ...]:
        """Direct light, its error, reflected light and its error."""
        return self.direct, self.direct_error, self.reflected, self.reflected_error

    def means(self, area: AreaFigures) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean direct and reflected illuminance [L] of an area by each lamp, lx."""
        direct, reflected = self.direct[:, area.part], self.reflected[:, area.part]
        return np.nanmean(direct, axis=1), np.nanmean(reflected, axis=1)

    def lit(self, area: AreaFigures) -> dict[str, NDArray[np.float64]]:
        """Illuminance [N] of an area by the lamps that light it, `MAX_MAPS` at most, by name."""
        total = (self.direct + self.reflected)[:, area.part]
        found = [
            (name, lux) for name, lux in zip(self.names, total, strict=True) if (lux > 0).any()
        ]
        return dict(found[:MAX_MAPS])

    def columns(self) -> dict[str, NDArray[np.float64]]:
        """Columns [N] of a table of receivers."""
        return {
            f"{name}_{part}_lx": getattr(self, part)[index]
            for index, name in enumerate(self.names)
            for part in ("direct", "direct_error", "reflected", "reflected_error")
        }


def collect(
    planes: Sequence[Plane],
    surfaces: Sequence[Surface],
    chosen: Sequence[Sequence[mi.Shape]],
    points: ArrayLike | None,
    normals: ArrayLike | None,
    seed: int,
) -> list[Receivers]:
    """The receivers of `illuminance`; arguments as there, `chosen` has the shapes of each surface.

    Raises:
        LumitreeError: there are none or too many, or points and normals do not match.
    """
    areas = [
        Receivers(plane.name or f"plane {number}", *plane.points(), plane)
        for number, plane in enumerate(planes, 1)
    ]
    areas += [
        Receivers(each.shape, *each.points(shapes, seed))
        for each, shapes in zip(surfaces, chosen, strict=True)
    ]
    if points is not None:
        areas.append(Receivers("points", *given_points(points, normals)))
    elif normals is not None:
        raise LumitreeError("there are normals but no points; give both")
    if not areas:
        raise LumitreeError("no plane, surface or points are given; name at least one")
    _check_count(sum(len(area.points) for area in areas))
    return areas


def given_points(
    points: ArrayLike, normals: ArrayLike | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and normals [N, 3] that are given as arrays."""
    if normals is None:
        raise LumitreeError("there are points but no normals; give both, or one normal for all")
    try:
        position = np.asarray(points, np.float64).reshape(-1, 3)
        normal = np.broadcast_to(np.asarray(normals, np.float64), position.shape)
    except (TypeError, ValueError):
        raise LumitreeError(
            "points and normals do not match, or are no numbers; expected [N, 3] both, or [3] for "
            "one normal"
        ) from None
    finite = np.isfinite(position).all() and np.isfinite(normal).all()
    largest = np.abs(normal).max(axis=1, keepdims=True)
    if not len(position) or not finite or not (largest > 0).all():
        raise LumitreeError(
            "points or normals are missing, not finite or 0; expected [N, 3] finite numbers and "
            "normals of some length"
        )
    # So that squares in single precision are neither 0 nor infinite.
    return position, normal / largest


def read_points(path: FilePath) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and normals [N, 3] of a CSV file.

    Its first line names the columns; x, y, z, nx, ny and nz are read, in any order.

    Raises:
        LumitreeError: the file cannot be read, lacks a column, or has a value that is no number.
    """
    name = shown(path, 300)

    def lines(content: str) -> Iterator[str]:
        for line in io.StringIO(content):
            # A long line would become a list of as many cells.
            if len(line) > _MAX_LINE:
                raise csv.Error
            yield line

    table, number = array.array("d"), 1
    try:
        content = read_bytes(path, "a CSV file of points", _MAX_FILE_BYTES).decode("utf-8-sig")
        rows = csv.DictReader(lines(content), skipinitialspace=True)
        missing = [each for each in _COLUMNS if each not in (rows.fieldnames or ())]
        if missing:
            raise LumitreeError(
                f"{name} lacks {', '.join(missing)}; expected a first line with the columns "
                f"{', '.join(_COLUMNS)}, and a line for each point"
            )
        for number, row in enumerate(rows, 2):
            # Before memory is reserved for more.
            _check_count(number - 1)
            table.extend(float(row[each]) for each in _COLUMNS)
    except (UnicodeDecodeError, csv.Error) as error:
        raise LumitreeError(f"{name} is no CSV file ({type(error).__name__})") from None
    except (TypeError, ValueError):
        raise LumitreeError(
            f"{name}, line {number}: expected six numbers for {', '.join(_COLUMNS)}"
        ) from None
    if not table:
        raise LumitreeError(f"{name} has no points; expected a line for each")
    values = np.array(table).reshape(-1, len(_COLUMNS))
    return values[:, :3], values[:, 3:]


def _axes(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors [3, 3] of a plane: u, v and the normal."""
    length = np.linalg.norm(normal)
    n = normal / length if length > 0 else np.array([0.0, 1.0, 0.0])
    along = np.array([1.0, 0, 0]) if abs(n[0]) < 0.999 else np.array([0, 1.0, 0])
    u = along - (along @ n) * n
    u /= np.linalg.norm(u)
    return np.stack([u, np.cross(n, u), n])


def _check_count(count: int) -> None:
    if count > MAX_POINTS:
        raise LumitreeError(
            f"there are {count:,} points; expected at most {MAX_POINTS:,}: use a larger spacing"
        )
