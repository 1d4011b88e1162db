"""EULUMDAT files (`.ldt`): written by the library eulumdat-py, and read here.

A file has one field a line, in a fixed order; a field may be blank. After ten direct ratios follow
the C planes, the γ angles, and for each plane that the symmetry does not make superfluous the
intensities at all γ.
"""

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import atomic_path
from lumitree.errors import LumitreeError, shown
from lumitree.formats.ies import SIMULATED
from lumitree.formats.opening import Opening
from lumitree.formats.reading import (
    MAX_ANGLES,
    MAX_SETS,
    date_of_writing,
    integer,
    number,
    one_line,
    read_text,
    stated_power,
    warn_of_file,
    warn_of_flux,
    without_noise,
)
from lumitree.formats.type_c import EDGE, IntensityDistribution, completed

if TYPE_CHECKING:
    from pyldt import Ldt

KIND = "EULUMDAT file"
_MAKER = "lumitree"
# Fields that are read, by their line, counted from 1.
_SYMMETRY, _PLANES, _ANGLES, _NAME = 3, 4, 6, 9
_LENGTH, _WIDTH, _HEIGHTS = 16, 17, (18, 19, 20, 21)
_RATIO, _FACTOR, _TILT, _SETS = 23, 24, 25, 26
_LINES_OF_SET, _NUM_RATIOS = 6, 10
_FIELDS = {
    _SYMMETRY: "symmetry",
    _PLANES: "number of C planes",
    _ANGLES: "number of gamma angles",
    _LENGTH: "length of the luminous area",
    _WIDTH: "width of the luminous area",
    _HEIGHTS[0]: "height of the luminous area at C = 0",
    _HEIGHTS[1]: "height of the luminous area at C = 90",
    _HEIGHTS[2]: "height of the luminous area at C = 180",
    _HEIGHTS[3]: "height of the luminous area at C = 270",
    _RATIO: "light output ratio",
    _FACTOR: "conversion factor of the intensities",
    _TILT: "tilt of the luminaire during measurement",
    _SETS: "number of sets of lamps",
    _SETS + 1: "number of lamps",
    _SETS + 3: "luminous flux of the lamps",
}
# Each kind of symmetry: of how many equal parts of the circle planes are stored, and the first.
_STORED = {0: (1, 0.0), 1: (0, 0.0), 2: (2, 0.0), 3: (2, 0.75), 4: (4, 0.0)}


def write_ldt(path: str | os.PathLike[str], distribution: IntensityDistribution) -> None:
    """Write an EULUMDAT file; see `ldt_of`.

    Raises:
        LumitreeError: the file cannot be written.
    """
    from pyldt import LdtWriter

    file = ldt_of(distribution, Path(path).name)
    with atomic_path(path) as temporary:
        LdtWriter.write(file, temporary, overwrite=True)


def ldt_of(distribution: IntensityDistribution, file_name: str = "") -> "Ldt":
    """EULUMDAT data (`pyldt.Ldt`), without symmetry.

    The flux of the lamps is the flux of the bare emitters. If this is not known, it is the flux of
    the luminaire, and the number of lamps is -1 (absolute photometry). Direct ratios are 0. A round
    luminous area has its diameter as length and no width; other shapes become boxes. Ellipsoids
    become cylinders or boxes that are as large seen from below and from the sides. The length is
    along C = 90, as of linear luminaires.
    """
    from pyldt import Ldt, LdtHeader

    lumens, emitted = distribution.lumens, distribution.emitted_lumens
    lamp_lumens = (emitted or lumens) or 1.0
    # As written: the intensities are relative to it.
    lamp_lumens = float(f"{lamp_lumens:.6f}") or lamp_lumens
    c, gamma = distribution.c, distribution.gamma
    angles = _below(distribution).lumens
    opening = distribution.opening
    area = math.pi / 4 if opening.shape == "ellipsoid" else 1.0
    sides = [1000 * side for side in opening.sides]
    if opening.is_round:
        width, height, length = 0.0, area * sides[1], sides[2]
    else:
        width, height, length = (math.sqrt(area) * side for side in sides)
    heights = [1000 * each for each in opening.heights or ()] or 4 * [height]
    source = "simulated" if distribution.generation == SIMULATED else "converted"
    header = LdtHeader(
        company=_MAKER,
        ityp=3,
        isym=0,
        mc=len(c),
        dc=_step(c),
        ng=len(gamma),
        dg=_step(gamma),
        report_number=source,
        luminaire_name=one_line(distribution.name),
        luminaire_number=one_line(distribution.name),
        file_name=one_line(file_name),
        date_user=date_of_writing().date().isoformat(),
        length=length,
        width=width,
        height=height,
        length_lum_area=length,
        width_lum_area=width,
        h_lum_c0=heights[0],
        h_lum_c90=heights[1],
        h_lum_c180=heights[2],
        h_lum_c270=heights[3],
        dff=100 * angles / lumens if lumens else 0.0,
        lorl=100.0 if emitted is None else 100 * lumens / lamp_lumens,
        n_sets=1,
        num_lamps=[-1 if emitted is None else 1],
        lamp_types=[source],
        lamp_flux=[lamp_lumens],
        lamp_cct=[""],
        lamp_cri=[""],
        lamp_watt=[distribution.watts or 0.0],
        direct_ratios=[0.0] * _NUM_RATIOS,
        c_angles=c.tolist(),
        g_angles=gamma.tolist(),
    )
    return Ldt(header, (distribution.intensity * (1000 / lamp_lumens)).tolist())


def _below(distribution: IntensityDistribution) -> IntensityDistribution:
    """The distribution up to γ = 90, and dark above."""
    lower = distribution.gamma < 90
    horizontal = [np.interp(90, distribution.gamma, plane) for plane in distribution.intensity]
    dark = np.zeros((len(distribution.c), 2))
    intensity = np.column_stack([distribution.intensity[:, lower], horizontal, dark])
    gamma = np.concatenate([distribution.gamma[lower], [90, 90 + EDGE, 180]])
    return IntensityDistribution("", distribution.c, gamma, intensity)


def read_ldt(path: str | os.PathLike[str]) -> IntensityDistribution:
    """Read an EULUMDAT file; the first set of lamps is taken.

    Blank fields are 0, a blank conversion factor is 1. A negative number of lamps stands for
    absolute photometry. Warns of small negative intensities, which are taken as 0; of a luminaire
    that was tilted; of sets of lamps of different flux; and of intensities whose flux is not the
    flux of the lamps times the light output ratio.

    Raises:
        LumitreeError: the file is missing or damaged.
    """
    return read_text(path, KIND, lambda text: _Reader(path, text).read())


class _Reader:
    def __init__(self, path: str | os.PathLike[str], text: str) -> None:
        self._path = Path(path)
        self._lines = [line.strip() for line in text.split("\n")]

    def read(self) -> IntensityDistribution:
        if len(self._lines) < _SETS + _LINES_OF_SET + _NUM_RATIOS:
            raise LumitreeError(f"it has {len(self._lines)} lines")
        flux = self._field(_SETS + 3)
        if not flux > 0:
            raise LumitreeError(
                f"line {_SETS + 3}, {_FIELDS[_SETS + 3]}, is "
                f"{shown(self._lines[_SETS + 2], 40)!r}; expected a number above 0, to which the "
                "intensities are relative"
            )
        if (tilt := self._field(_TILT)) != 0:
            warn_of_file(
                self._path,
                f"the luminaire was tilted by {tilt:g} degrees when it was measured; the "
                "intensities are taken as they are",
            )
        factor = self._field(_FACTOR) or 1.0
        c, gamma, values = self._intensities()
        intensity = without_noise(self._path, values * flux / 1000 * factor)
        c, gamma, intensity = completed(c, gamma, intensity)
        relative, opening = self._field(_SETS + 1) > 0, self._opening()
        lamp = IntensityDistribution(
            name=shown(self._lines[_NAME - 1] or self._path.stem),
            c=c,
            gamma=gamma,
            intensity=intensity,
            opening=opening,
            emitted_lumens=flux if relative else None,
            watts=stated_power(self._lines[_SETS + _LINES_OF_SET - 1]),
            details={
                "format": "EULUMDAT",
                "photometry": f"{'relative' if relative else 'absolute'}, symmetry "
                f"{self._field(_SYMMETRY):g}",
                "factors": f"light output ratio {self._field(_RATIO):g} %, conversion {factor:g}",
                "lamps": self._lamps(flux),
                "luminous_opening": str(opening),
            },
        )
        stated = flux * self._field(_RATIO) / 100
        by = "" if factor == 1 else f" (its conversion factor of {factor:g} is applied)"
        what = (
            f"but its lamps of {flux:g} lm with a light output ratio of {self._field(_RATIO):g} % "
            f"give {stated:.6g} lm{by}"
        )
        warn_of_flux(self._path, lamp.lumens, stated, what)
        return lamp

    def _lamps(self, flux: float) -> str:
        """Flux of the lamps; warns if further sets have another flux."""
        sets = self._count(_SETS, 1, MAX_SETS)
        others = [self._flux_of(index) for index in range(1, sets)]
        if any(other != flux for other in others):
            warn_of_file(
                self._path,
                f"it has {sets} sets of lamps, of {flux:g}, "
                f"{', '.join(f'{other:g}' for other in others)} lm; the first is taken (state "
                "another flux by lumens)",
            )
        return f"{flux:g} lm" + (f", first of {sets} sets" if sets > 1 else "")

    def _flux_of(self, index: int) -> float:
        line = _SETS + 3 + _LINES_OF_SET * index
        text = self._lines[line - 1] if line <= len(self._lines) else ""
        return number(text, f"line {line}, luminous flux of set {index + 1},") if text else 0.0

    def _opening(self) -> Opening:
        """A width of 0 means a round area, whose diameter is the length."""
        length, width = (abs(self._field(line)) / 1000 for line in (_LENGTH, _WIDTH))
        c0, c90, c180, c270 = (abs(self._field(line)) / 1000 for line in _HEIGHTS)
        height = max(c0, c90, c180, c270)
        heights = None if c0 == c90 == c180 == c270 else (c0, c90, c180, c270)
        if width == 0:
            return Opening((length, height, length), "cylinder", heights=heights)
        return Opening((width, height, length), heights=heights)

    def _field(self, line: int) -> float:
        text = self._lines[line - 1]
        return number(text, f"line {line}, {_FIELDS[line]},") if text else 0.0

    def _count(self, line: int, low: int, high: int) -> int:
        what = f"in line {line}, as {_FIELDS[line]}"
        return integer(self._field(line), what, low, high)

    def _intensities(self) -> tuple[NDArray[np.float64], ...]:
        """C planes and γ angles of the file, and intensities [C, G] per 1000 lm of lamps."""
        symmetry = self._count(_SYMMETRY, 0, 4)
        planes = self._count(_PLANES, 1, MAX_ANGLES)
        angles = self._count(_ANGLES, 2, MAX_ANGLES)
        sets = self._count(_SETS, 1, MAX_SETS)
        parts, first = _STORED[symmetry]
        if parts > 1 and planes % (4 if symmetry > 2 else parts):
            raise LumitreeError(
                f"it has {planes} C planes, which its symmetry, {symmetry}, does not divide"
            )
        stored = planes if symmetry == 0 else planes // parts + 1 if parts else 1
        numbers, end = self._numbers(_SETS + _LINES_OF_SET * sets)
        # Some files name only the planes that they store, others store all planes nevertheless.
        expected = [
            (named + angles + stored_planes * angles, named, stored_planes)
            for named, stored_planes in ((planes, stored), (stored, stored), (planes, planes))
        ]
        fitting = [each for each in expected if each[0] == len(numbers)]
        fitting += [each for each in expected[:1] if each[0] < len(numbers)]
        if not fitting:
            raise LumitreeError(
                f"it has {len(numbers)} numbers after the direct ratios{end}; expected "
                f"{expected[0][0]} for {planes} planes, {angles} angles and {stored} x {angles} "
                "intensities"
            )
        total, named, kept = fitting[0]
        c, gamma, values = np.split(numbers[:total], [named, named + angles])
        if named > kept:
            start = int(first * planes)
            c = np.take(c, np.arange(start, start + kept), mode="wrap")
        if (np.diff(c) < 0).any():
            # From C = 270 over 0 to 90.
            c = np.where(c >= 270, c - 360, c)
        return c, gamma, values.reshape(kept, angles)

    def _numbers(self, start: int) -> tuple[NDArray[np.float64], str]:
        """Numbers after the direct ratios, which are on ten lines or fewer, and what ends them."""
        ratios = self._lines[start : start + _NUM_RATIOS]
        by_line = all(len(line.split()) <= 1 for line in ratios)
        first = start + _NUM_RATIOS if by_line else start
        words = [(word, line) for line, text in enumerate(self._lines[first:], first + 1)
                 for word in text.split()][0 if by_line else _NUM_RATIOS :]  # fmt: skip
        values, end = [], "; the file is cut off"
        for word, line in words:
            try:
                values.append(number(word, f"line {line}"))
            except LumitreeError as error:
                end = f", since {error}"
                break
        return np.array(values), end


def _step(angles: NDArray[np.floating]) -> float:
    """Step of equidistant angles; 0 for others, as EULUMDAT has it."""
    steps = np.diff(angles)
    return float(steps[0]) if len(steps) and np.ptp(steps) < 1e-6 else 0.0
