"""Luminaire data of IES TM-33 (2018 and 2023) and UNI 11733: XML with intensities.

    IESTM33, IESTM33-22         root
      Header                    Description, CatalogNumber, ...
      Luminaire                 Dimensions of the housing, m
      Equipment                 Gonioradiometer/Type: A, B or C, with a prefix; C if missing
      Emitter                   one or several, whose light is added
        BallastFactor, TiltAngles/Tilt      factors, unless the photometry is absolute
        LuminousData
          LuminousIntensity     AbsolutePhotometry, Symm, Multiplier, and for each direction
            IntData h="" v=""   cd
          LuminousFlux          lm
        SpectralData            EmitterSpectral/PwrData w="" nm: its colour is used
        EmissionAreas           rectangles or ellipses on the faces of the luminaire, m

Other orders of elements, and IntensityData with horz and vert in place of IntData, are read, too.
The luminous opening is the bounding rectangle of areas on one face, and a box of areas on several
faces.
"""

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import LUMA, RGB, sampled_spectrum, srgb_from_xyz, xyz_of_spectrum
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.formats.opening import POINT, Opening
from lumitree.formats.reading import (
    MAX_ANGLES,
    MAX_XML_BYTES,
    number,
    number_of,
    parse_xml,
    stated_power,
    text_of,
    warn_of_file,
    warn_of_flux,
    without_noise,
)
from lumitree.formats.type_c import (
    IntensityDistribution,
    completed,
    direction_of,
    on_grid,
    turned_of_type_b,
    type_a,
)

KIND = "IES TM-33 file"
Array = NDArray[np.float64]
_DATA = ("LuminousData", "IntensityDistribution")
_POINTS = ("IntData", "IntensityData")
_HORIZONTAL, _VERTICAL = ("h", "horz", "horizontal"), ("v", "vert", "vertical")
_OTHERS = ("RadiantData", "PhotonData")
_MAX_EMITTERS = 100
# Intensities that are interpolated to add up emitters.
_MAX_SUMMED = 1 << 22
# Faces of a luminaire: the names of the two sides of an area, and their axes with y up.
_FACES: dict[str, tuple[tuple[str, int], tuple[str, int]]] = {
    "Top": (("Width", 0), ("Length", 2)),
    "Bottom": (("Width", 0), ("Length", 2)),
    "C0": (("Length", 2), ("Height", 1)),
    "C180": (("Length", 2), ("Height", 1)),
    "C90": (("Width", 0), ("Height", 1)),
    "C270": (("Width", 0), ("Height", 1)),
}


def read_tm33(path: str | os.PathLike[str]) -> tuple[IntensityDistribution, RGB]:
    """Read a TM-33 file; photometry of Types A and B is converted to Type C.

    Warns of small negative intensities, tilt factors, a stated or rated luminous flux that the
    intensities do not have, and missing emission areas.

    Returns:
        The intensities of all emitters together, and the colour of their spectra, linear RGB of
        luminance 1; white without spectra, and of a lamp that emits nothing.

    Raises:
        LumitreeError: the file is missing or damaged, or has no luminous intensities.
    """
    name = shown(path, 300)
    content = read_bytes(path, f"an {KIND}", MAX_XML_BYTES)
    root = parse_xml(content, name, f"an {KIND}")
    try:
        with np.errstate(all="ignore"):
            return _Reader(path, root).read()
    except LumitreeError as error:
        raise LumitreeError(f"{name} is not a usable {KIND}: {error}") from None


class _Reader:
    def __init__(self, path: str | os.PathLike[str], root: Element) -> None:
        self._path, self._root = Path(path), root

    def read(self) -> tuple[IntensityDistribution, RGB]:
        emitters = self._root.findall("Emitter")
        if not 1 <= len(emitters) <= _MAX_EMITTERS:
            raise LumitreeError(f"it has {len(emitters)} emitters; expected 1 to {_MAX_EMITTERS}")
        found = [self._intensities(each) for each in emitters]
        opening = self._opening(emitters)
        powers = [stated_power(text_of(each, "InputWattage")) for each in emitters]
        distribution = dataclasses.replace(
            _sum(found),
            name=self._name(),
            opening=opening,
            watts=None if None in powers else sum(filter(None, powers)),
        )
        return distribution, _colour(emitters, [each.lumens for each in found])

    def _name(self) -> str:
        names = ("Header/Description", "Header/CatalogNumber")
        found = next((text for name in names if (text := text_of(self._root, name))), "")
        return shown(found or self._path.stem)

    def _intensities(self, emitter: Element) -> IntensityDistribution:
        data = next((each for each in emitter if each.tag in _DATA), None)
        if data is None:
            other = next((each.tag for each in emitter if each.tag in _OTHERS), None)
            raise LumitreeError(
                f"an emitter has {other or 'no intensities'}; expected LuminousData, intensities "
                "in candela"
            )
        inner = data.find("LuminousIntensity")
        table = data if inner is None else inner
        metric = text_of(table, "Metric")
        if metric not in ("", "Luminous"):
            raise LumitreeError(f"the metric is {shown(metric)!r}; expected Luminous")
        horizontal, vertical, values = _grid(table)
        scale = number_of(table, "Multiplier", 1.0) * self._factor(emitter, table)
        intensity = without_noise(self._path, values * scale)
        given, kind = (horizontal, vertical, intensity), self._type(table)
        if kind == "B":
            sphere = on_grid(turned_of_type_b(*given))
        else:
            sphere = type_a(*given) if kind == "A" else completed(*given)
        result = IntensityDistribution("", *sphere)
        stated = number_of(data, "LuminousFlux", 0.0)
        what = f"where it states {stated:g} lm"
        if not stated > 0:
            rated, count = number_of(emitter, "RatedLumens", 0.0), number_of(emitter, "Quantity", 1)
            # The rating is for one of several lamps, or for all.
            stated = min((rated, rated * count), key=lambda each: abs(each - result.lumens))
            what = f"where its lamps are rated at {rated:g} lm"
        warn_of_flux(self._path, result.lumens, stated, what)
        return result

    def _type(self, table: Element) -> str:
        """Type of photometry: "A", "B" or "C"."""
        paths = ("Equipment/Gonioradiometer/Type", "Equipment/Goniometer/GoniometerType")
        stated = text_of(table, "PhotometryType")
        for path in paths:
            stated = stated or text_of(self._root, path)
        # The schema was published with spaces around underscores.
        kind = stated.upper().replace(" ", "").replace("_", "")
        kind = kind.removeprefix("CIE").removeprefix("IES").removeprefix("TYPE") or "C"
        if kind not in ("A", "B", "C"):
            raise LumitreeError(f"its type of photometry is {shown(stated)!r}; expected A, B or C")
        return kind

    def _factor(self, emitter: Element, table: Element) -> float:
        """Ballast factor and tilt factor of relative photometry."""
        if text_of(table, "AbsolutePhotometry").lower() in ("true", "1"):
            return 1.0
        tilts = [
            (number_of(each, "angle"), number(each.text or "", "a tilt factor"))
            for each in emitter.iterfind("TiltAngles/Tilt")
        ]
        factor = 1.0
        if any(value != 1 for _, value in tilts):
            angles, factors = np.array(sorted(tilts)).T
            factor = float(np.interp(0.0, angles, factors))
            self._warn(f"of its tilt factors the one for 0 degrees, {factor:g}, is used")
        return factor * (number_of(emitter, "BallastFactor", 1.0) or 1.0)

    def _opening(self, emitters: Iterable[Element]) -> Opening:
        """Luminous opening around the emission areas of all emitters."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        faces, circles = set[str](), []
        for emitter in emitters:
            for face, axes in _FACES.items():
                for area in emitter.iterfind(f"EmissionAreas/{face}Face/{face}Area"):
                    for side, axis in axes:
                        half = abs(number_of(area, side)) / 2
                        middle = number_of(area, f"{side}Offset", 0.0)
                        low[axis] = min(low[axis], middle - half)
                        high[axis] = max(high[axis], middle + half)
                    faces.add(face)
                    circles.append(text_of(area, "Circular").lower() in ("true", "1"))
        if not faces:
            self._warn("it states no emission areas; the light comes from a cube of 1 cm")
            return POINT
        size = [number_of(self._root, f"Luminaire/Dimensions/{key}", 0.0)
                for key in ("Width", "Height", "Length")]  # fmt: skip
        sides = np.where(np.isfinite(low), high - low, np.array(size) if len(faces) > 1 else 0.0)
        x, y, z = (abs(float(side)) for side in sides)
        if circles == [True]:
            missing = int(np.argmin(sides))
            return Opening((x, y, z), "cylinder", missing)
        return Opening((x, y, z))

    def _warn(self, text: str) -> None:
        warn_of_file(self._path, text)


def _grid(table: Element) -> tuple[Array, Array, Array]:
    """Horizontal angles [H], vertical angles [V] and values [H, V] of a table of directions."""
    points = [each for each in table if each.tag in _POINTS]
    if not points:
        raise LumitreeError("its table of intensities is empty")
    rows = np.array(
        [
            (_angle(each, _HORIZONTAL), _angle(each, _VERTICAL), number(each.text or "", "a value"))
            for each in points
        ]
    )
    horizontal, column = np.unique(rows[:, 0], return_inverse=True)
    vertical, row = np.unique(rows[:, 1], return_inverse=True)
    if max(len(horizontal), len(vertical)) > MAX_ANGLES:
        raise LumitreeError(f"it has more than {MAX_ANGLES} angles")
    values = np.full((len(horizontal), len(vertical)), np.nan)
    values[column, row] = rows[:, 2]
    if values.size != len(rows) or np.isnan(values).any():
        raise LumitreeError(
            f"it has {len(rows)} intensities for {len(horizontal)} horizontal and {len(vertical)} "
            "vertical angles; expected one for each pair"
        )
    return horizontal, vertical, values


def _angle(point: Element, names: tuple[str, ...]) -> float:
    text = next((point.get(name) for name in names if point.get(name) is not None), None)
    return number(text or "", f"the angle {names[0]} of an intensity")


def _sum(parts: list[IntensityDistribution]) -> IntensityDistribution:
    """The intensities of several emitters together, on all of their angles."""
    if len(parts) == 1:
        return parts[0]
    c = np.unique(np.concatenate([each.c for each in parts]))
    gamma = np.unique(np.concatenate([each.gamma for each in parts]))
    if len(parts) * len(c) * len(gamma) > _MAX_SUMMED:
        raise LumitreeError(
            f"its {len(parts)} emitters have {len(c)} x {len(gamma)} different angles; expected at "
            f"most {_MAX_SUMMED} intensities of all together"
        )
    direction = direction_of(c[:, None], gamma)
    total = np.sum([each.at(direction) for each in parts], axis=0)
    return IntensityDistribution("", c, gamma, total)


def _colour(emitters: list[Element], lumens: list[float]) -> RGB:
    """Linear RGB of luminance 1 of the spectra of emitters, each weighted by its flux.

    White without spectra, or without flux.
    """
    if not sum(lumens) > 0:
        return (1.0, 1.0, 1.0)
    total = np.zeros(3)
    for emitter, flux in zip(emitters, lumens, strict=True):
        table = emitter.findall("SpectralData/EmitterSpectral/PwrData")
        if len(table) < 2:
            return (1.0, 1.0, 1.0)
        points = [(number_of(each, "w"), number(each.text or "", "a power")) for each in table]
        wavelength, power = np.array(sorted(points)).T
        # Two powers at one wavelength are a step.
        wavelength += 1e-9 * np.arange(len(wavelength))
        xyz = xyz_of_spectrum(sampled_spectrum(wavelength, np.maximum(power, 0)))
        if not xyz[1] > 0:
            raise LumitreeError("a spectrum has no visible light, or negative numbers")
        total += xyz / xyz[1] * flux
    rgb = np.maximum(srgb_from_xyz(total), 0)
    red, green, blue = (rgb / (rgb @ LUMA)).tolist()
    return red, green, blue
