"""Ray files of IES TM-25 (2013), read by optical design programs.

Layout, little-endian; the numbers are the sections of the standard:

    offset  bytes  4.7.1, file header
    0       4      "TM25"
    4       4      int32, version: 2013
    8       4      int32, creation method: 0 simulation, 1 measurement
    12      4      float32, total luminous flux, lm
    16      4      float32, total radiant flux, W
    20      8      uint64, number of rays
    28      28     date and time, ISO 8601, ASCII, filled up with 0
    56      4      int32, where the rays start: 0 unknown, ...
    60      4      int32, spectral data: 0 none, 1 one wavelength, 2 one of each ray, 3 one table,
                   4 a table of each ray
    64      12     float32, the one wavelength, the shortest and the longest, nm
    76      4      int32, number of spectral tables
    80      4      int32, number of additional items of each ray
    84      4      int32, bytes of the additional text, a multiple of 32
    88      168    0
                   4.7.2, known data flags
    256     32     int32 each: position, direction, radiant flux, wavelength, luminous flux, Stokes,
                   tristimulus, spectrum index
                   4.7.3, description
    288     36000  9 texts of 1000 characters, UTF-32, filled up with 0
                   4.7.4, spectral tables: int32, number n, then n pairs of float32, wavelength and
                   weight; filled up with 0 to a multiple of 32 bytes
                   4.7.5, names of the additional items, 512 bytes each, UTF-32
                   4.7.6, additional text, UTF-32
                   rays, float32: position x, y, z, mm; direction; then what the flags say:
                   radiant flux, wavelength, luminous flux, Stokes parameters (6 numbers),
                   tristimulus X and Z, spectrum index; additional items

Positions and directions have z up here.
"""

import dataclasses
import datetime
import math
import os
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.device import on_device
from lumitree.core.files import write_bytes
from lumitree.core.photometry import (
    LUMENS_PER_WATT,
    WAVELENGTHS,
    luminance,
    matching_functions,
    sampled_spectrum,
    srgb_from_xyz,
    xyz_from_srgb,
    xyz_of_spectrum,
)
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, shown
from lumitree.formats.reading import date_of_writing, warn_of_file
from lumitree.formats.type_c import y_up, z_up

MAX_BYTES = 1 << 32
VERSION = 2013
_MAGIC = b"TM25"
_MM_PER_M = 1000.0
_HEADER = np.dtype(
    [
        ("magic", "S4"),
        ("version", "<i4"),
        ("creation_method", "<i4"),
        ("lumens", "<f4"),
        ("watts", "<f4"),
        ("num_rays", "<u8"),
        ("date", "S28"),
        ("start_position", "<i4"),
        ("spectrum", "<i4"),
        ("wavelengths", "<f4", 3),
        ("num_tables", "<i4"),
        ("num_additional", "<i4"),
        ("text_bytes", "<i4"),
        ("reserved", "V168"),
        ("flags", "<i4", 8),
        ("texts", "<u4", (9, 1000)),
    ]
)
# Columns that the last six flags add to position and direction, in the order of the file.
_COLUMNS = (
    ("radiant", 2, 1),
    ("wavelength", 3, 1),
    ("luminous", 4, 1),
    ("stokes", 5, 6),
    ("tristimulus", 6, 2),
    ("table", 7, 1),
)
# Kinds of spectral data.
_ONE_WAVELENGTH, _WAVELENGTHS, _ONE_TABLE, _TABLES = 1, 2, 3, 4
_TABLE_ALIGNMENT, _NAME_BYTES = 32, 512
_MAX_TABLES, _MAX_ADDITIONAL = 1000, 1000
# Relative difference of fluxes that rounding may cause.
_TOTAL_ERROR = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Rays:
    """Rays in the frame of a luminaire's file, y up.

    Attributes:
        origin: [N, 3] where each starts, m.
        direction: [N, 3] unit direction of travel.
        flux: [N, 3] radiant flux of R, G and B, W; the sum is the flux of the source.
        spectrum: [471] power per nm of all rays together at `core.photometry.WAVELENGTHS`, in any
            unit; None if it is not known.
    """

    origin: NDArray[np.float64]
    direction: NDArray[np.float64]
    flux: NDArray[np.float64]
    spectrum: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.origin)

    @staticmethod
    def joined(parts: "Sequence[Rays]") -> "Rays":
        """Rays of independent estimates of one source, whose mean is taken."""
        if not parts:
            return Rays(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
        return Rays(
            np.concatenate([part.origin for part in parts]),
            np.concatenate([part.direction for part in parts]),
            np.concatenate([part.flux for part in parts]) / len(parts),
        )


def write_tm25(path: str | os.PathLike[str], rays: Rays, name: str) -> None:
    """Write rays with luminous flux and tristimulus values.

    Y is the luminous flux of a ray in lm; X and Z are in the same unit. Rays start at the last
    vertex inside the luminaire, which need not be on one surface.

    Args:
        name: of the light source.

    Raises:
        LumitreeError: the file cannot be written.
    """
    header = np.zeros((), _HEADER)
    header["magic"], header["version"] = _MAGIC, VERSION
    header["lumens"] = luminance(rays.flux.sum(axis=0))
    header["watts"] = np.nan
    header["num_rays"] = len(rays)
    date = date_of_writing().astimezone(datetime.UTC)
    header["date"] = date.strftime("%Y-%m-%dT%H:%M:%SZ").encode()
    header["wavelengths"] = np.nan
    header["flags"] = [1, 1, 0, 0, 1, 0, 1, 0]
    for text, value in zip(
        header["texts"], (shown(name), "unknown", "lumitree", "lumitree", "lumitree"), strict=False
    ):
        text[: len(value)] = [ord(char) for char in value]
    xyz = LUMENS_PER_WATT * xyz_from_srgb(rays.flux)
    # Equal up to rounding of the primaries.
    xyz[:, 1] = luminance(rays.flux)
    table = np.concatenate(
        [z_up(rays.origin) * _MM_PER_M, z_up(rays.direction), xyz[:, [1, 0, 2]]], axis=1
    )
    write_bytes(path, header.tobytes() + table.astype("<f4").tobytes())


def read_tm25(path: str | os.PathLike[str]) -> tuple[Rays, str]:
    """Rays of a TM-25 file, and the name of its light source.

    Colour is taken from tristimulus values, wavelengths or spectral tables. Rays without colour
    have R = G = B: with luminous flux, so that the flux is right in lm, else in W. Colours outside
    the gamut of sRGB are clipped; their luminous flux is kept.

    Raises:
        LumitreeError: the file is missing, damaged, of another version, or emits nothing.
    """
    content = read_bytes(path, "a TM-25 ray file", MAX_BYTES)
    try:
        # Numbers of any size are checked where they are used.
        with np.errstate(all="ignore"):
            return _parse(content, path)
    except LumitreeError as error:
        raise LumitreeError(f"{shown(path, 300)} is not a usable TM-25 file: {error}") from None


def _parse(content: bytes, path: str | os.PathLike[str]) -> tuple[Rays, str]:
    if len(content) < _HEADER.itemsize or content[:4] != _MAGIC:
        raise LumitreeError(f"{len(content)} bytes that begin with {shown(content[:4])}")
    header = np.frombuffer(content, _HEADER, 1)[0]
    _check(header)
    tables, offset = _tables(content, int(header["num_tables"]))
    offset += _NAME_BYTES * int(header["num_additional"]) + int(header["text_bytes"])
    flags = header["flags"]
    columns: dict[str, slice] = {}
    width = 6
    for name, flag, count in _COLUMNS:
        if flags[flag]:
            columns[name] = slice(width, width + count)
            width += count
    width += int(header["num_additional"])
    count = int(header["num_rays"])
    if len(content) != offset + 4 * width * count:
        raise LumitreeError(
            f"it has {len(content)} bytes; expected {offset + 4 * width * count} for {count} rays "
            f"of {width} numbers"
        )
    table = np.frombuffer(content, "<f4", count * width, offset).reshape(count, width)
    items = {name: table[:, where].astype(np.float64) for name, where in columns.items()}
    position, direction = (table[:, part].astype(np.float64) for part in (slice(3), slice(3, 6)))
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    if not (np.abs(position) < 1e12).all() or not (np.abs(length - 1) < 0.01).all():
        raise LumitreeError("a ray has no finite position or no direction of length 1")
    flux = _flux(items, tables, int(header["spectrum"]), float(header["wavelengths"][0]))
    # Colours are clipped at 0, so a negative flux need not be seen in them.
    given = [items[kind] for kind in ("radiant", "luminous") if kind in items]
    sound = all(((each >= 0) & (each < 1e15)).all() for each in (flux, *given))
    if not sound or not flux.any():
        raise LumitreeError("a ray's flux is not a number, negative or too large, or all are 0")
    _compare_totals(path, float(header["lumens"]), float(luminance(flux).sum()), "luminous", "lm")
    if "radiant" in items:
        watts = float(items["radiant"].sum())
        _compare_totals(path, float(header["watts"]), watts, "radiant", "W")
    name = "".join(chr(code) for code in header["texts"][0] if 0 < code < 0x110000)
    spectrum = rays_spectrum(items, tables, int(header["spectrum"]), header["wavelengths"][0])
    rays = Rays(y_up(position) / _MM_PER_M, y_up(direction / length), flux, spectrum)
    return rays, shown(name) or "rays"


def _compare_totals(
    path: str | os.PathLike[str], stated: float, total: float, kind: str, unit: str
) -> None:
    """Warn of a header whose flux differs from the rays'; NaN and 0 stand for an unknown flux."""
    if math.isfinite(stated) and stated > 0 and abs(total - stated) > _TOTAL_ERROR * stated:
        warn_of_file(
            path,
            f"its header states a {kind} flux of {stated:g} {unit}, but its rays have {total:g} "
            f"{unit}; the flux of the rays is used (state a known flux by lumens)",
        )


def _check(header: np.void) -> None:
    flags = header["flags"]
    for what, found, low, high in (
        ("version", header["version"], VERSION, VERSION),
        ("number of rays", header["num_rays"], 1, MAX_BYTES),
        ("kind of spectral data", header["spectrum"], 0, 4),
        ("number of spectral tables", header["num_tables"], 0, _MAX_TABLES),
        ("number of additional items", header["num_additional"], 0, _MAX_ADDITIONAL),
        ("size of the additional text", header["text_bytes"], 0, MAX_BYTES),
        ("smallest of the known data flags", flags.min(), 0, 1),
        ("largest of the known data flags", flags.max(), 0, 1),
        ("flag of position and direction", flags[:2].min(), 1, 1),
        ("flag of radiant or luminous flux", flags[[2, 4]].max(), 1, 1),
    ):
        if not low <= int(found) <= high:
            raise LumitreeError(f"the {what} is {int(found)}; expected {low} to {high}")


def _tables(content: bytes, count: int) -> tuple[list[NDArray[np.float64]], int]:
    """Spectral tables, [n, 2] wavelength and weight each, and where they end."""
    offset, tables = _HEADER.itemsize, []
    for _ in range(count):
        length = int.from_bytes(content[offset : offset + 4], "little", signed=True)
        if not 0 < length <= (len(content) - offset - 4) // 8:
            raise LumitreeError(f"a spectral table has {length} entries")
        table = np.frombuffer(content, "<f4", 2 * length, offset + 4).reshape(length, 2)
        if not ((table > 0).any() and (table >= 0).all() and (table < 1e9).all()):
            raise LumitreeError("a spectral table has NaN or negative numbers")
        tables.append(table.astype(np.float64))
        offset += 4 + 8 * length
    return tables, offset + (_HEADER.itemsize - offset) % _TABLE_ALIGNMENT


def _flux(
    items: dict[str, NDArray[np.float64]],
    tables: list[NDArray[np.float64]],
    spectrum: int,
    wavelength: float,
) -> NDArray[np.float64]:
    """Radiant flux [N, 3] of R, G and B."""
    xyz = None
    if "tristimulus" in items and "luminous" in items:
        x, z = items["tristimulus"].T
        xyz = np.stack([x, items["luminous"][:, 0], z], axis=1)
    elif spectrum == _ONE_WAVELENGTH:
        xyz = _line_colour(np.array([wavelength]))
    elif spectrum == _WAVELENGTHS and "wavelength" in items:
        xyz = _line_colour(items["wavelength"][:, 0])
    elif spectrum == _ONE_TABLE and tables:
        xyz = xyz_of_spectrum(_spectrum_of_a_watt(tables[0]))[None]
    elif spectrum == _TABLES and tables and "table" in items:
        index = _table_indices(tables, items)
        xyz = xyz_of_spectrum([_spectrum_of_a_watt(each) for each in tables])[index]
    if xyz is None:
        flux = items["luminous"] / LUMENS_PER_WATT if "luminous" in items else items["radiant"]
        return np.repeat(flux, 3, axis=1)
    if "luminous" in items:
        # The colour of the spectrum, and the flux of the ray.
        y = np.where(xyz[:, 1:2] > 0, xyz[:, 1:2], 1)
        xyz = xyz / y * items["luminous"] / LUMENS_PER_WATT
    else:
        xyz = xyz * items["radiant"]
    return _in_gamut(xyz)


def _line_colour(wavelength: NDArray[np.float64]) -> NDArray[np.float64]:
    """XYZ [N, 3] of one watt of light of one wavelength [N], nm, each; Y is V(λ)."""
    mi = load_mitsuba()
    return np.array(mi.cie1931_xyz(on_device(mi.Float, wavelength)), np.float64).T


def _in_gamut(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """RGB [N, 3] of XYZ [N, 3], clipped at 0; Y is kept."""
    rgb = np.maximum(srgb_from_xyz(xyz), 0)
    y, kept = xyz[:, 1:2], luminance(rgb)[:, None] / LUMENS_PER_WATT
    return rgb * np.divide(y, kept, out=np.zeros_like(y), where=kept > 0)


def rays_spectrum(
    items: dict[str, NDArray[np.float64]],
    tables: list[NDArray[np.float64]],
    kind: int,
    wavelength: float,
) -> NDArray[np.float64] | None:
    """Power per nm of all rays, in any unit.

    Args:
        items: columns of the rays, [N, 1]: "radiant" flux, "luminous" flux or both; and
            "wavelength", nm, or "table", from 1 on.
        tables: [n, 2] wavelengths, nm, and weights each.
        kind: of spectral data, as in the header.
        wavelength: of kind 1, nm.

    Returns:
        [471] at `WAVELENGTHS`; None if the file states no spectrum, or none that can be used. Its
        colours may still be known from tristimulus values.
    """
    try:
        if kind == _ONE_WAVELENGTH:
            return sampled_spectrum([wavelength], [1])
        if kind == _WAVELENGTHS and "wavelength" in items:
            return _lines(items["wavelength"][:, 0], items)
        if kind == _ONE_TABLE and tables:
            return sampled_spectrum(*tables[0].T)
        if kind == _TABLES and tables and "table" in items:
            index = _table_indices(tables, items)
            spectra = np.array([_spectrum_of_a_watt(each) for each in tables])
            power = _power(items, (spectra @ matching_functions()[1])[index])
            return np.bincount(index, power, len(tables)) @ spectra
    except LumitreeError:
        return None
    return None


def _lines(
    wavelength: NDArray[np.float64], items: dict[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Rays of one wavelength [N] each, divided between the wavelengths next to it."""
    visible = (wavelength >= WAVELENGTHS[0]) & (wavelength <= WAVELENGTHS[-1])
    place = np.where(visible, wavelength - WAVELENGTHS[0], 0)
    efficacy = np.interp(wavelength, WAVELENGTHS, matching_functions()[1], left=0, right=0)
    power = np.where(visible, _power(items, efficacy), 0)
    lower = place.astype(np.int64)
    size = len(WAVELENGTHS) + 1
    parts = (lower, 1 - (place - lower)), (lower + 1, place - lower)
    binned = sum(np.bincount(at, power * part, size) for at, part in parts)
    return np.asarray(binned, np.float64)[:-1]


def _table_indices(
    tables: list[NDArray[np.float64]], items: dict[str, NDArray[np.float64]]
) -> NDArray[np.int64]:
    """Index [N] of the table of each ray."""
    number = items["table"][:, 0]
    if not ((number >= 1) & (number <= len(tables))).all():
        raise LumitreeError(f"a ray names none of the {len(tables)} spectral tables")
    return number.astype(np.int64) - 1


def _power(items: dict[str, NDArray[np.float64]], efficacy: ArrayLike) -> NDArray[np.float64]:
    """Radiant flux [N] of rays whose luminous efficacy [N] is known, relative."""
    if "radiant" in items:
        return items["radiant"][:, 0]
    flux = items["luminous"][:, 0]
    return np.divide(flux, efficacy, out=np.zeros_like(flux), where=np.asarray(efficacy) > 0)


def _spectrum_of_a_watt(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power per nm [471] at `WAVELENGTHS` of a spectral table; the watt has its invisible light.

    The table is [n, 2] wavelengths, nm, and weights, linear between them; one entry is a line.
    """
    total = np.trapezoid(table[:, 1], table[:, 0]) if len(table) > 1 else table[0, 1]
    return sampled_spectrum(*table.T, means=True) / max(float(total), 1e-300)
