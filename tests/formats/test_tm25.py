"""Ray files of TM-25, and the spectrum of their rays."""

import contextlib
import struct

import numpy as np
import pytest

from lumitree.core.photometry import (
    LUMENS_PER_WATT,
    WAVELENGTHS,
    luminance,
    matching_functions,
    sampled_spectrum,
)
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats.tm25 import Rays, rays_spectrum, read_tm25, write_tm25
from support.tm25_files import HEADER, file_bytes


def random_rays(count=50, seed=0):
    random = np.random.default_rng(seed)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return Rays(random.normal(size=(count, 3)), direction, random.random((count, 3)))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "lamp.ray"


def test_layout(path, mi):
    rays = random_rays(3)
    write_tm25(path, rays, "bulb ☀")
    data = path.read_bytes()
    assert len(data) == HEADER + 3 * 9 * 4
    assert data[:4] == b"TM25"
    version, method, lumens, watts, count = struct.unpack_from("<iiffQ", data, 4)
    assert (version, method, count) == (2013, 0, 3)
    assert lumens == pytest.approx(luminance(rays.flux.sum(axis=0)))
    assert np.isnan(watts)
    assert data[28:56].rstrip(b"\0").endswith(b"Z")
    start, spectrum, *nanometres, tables, items, text = struct.unpack_from("<iifffiii", data, 56)
    assert (start, spectrum, tables, items, text) == (0, 0, 0, 0, 0)
    assert np.isnan(nanometres).all()
    assert data[88:256] == bytes(168)
    # Position, direction, luminous flux, tristimulus.
    assert struct.unpack_from("<8i", data, 256) == (1, 1, 0, 0, 1, 0, 1, 0)
    assert data[288:4288].decode("utf-32-le").rstrip("\0") == "bulb ☀"
    row = struct.unpack_from("<9f", data, HEADER + 36)
    x, y, z = rays.origin[1]
    assert row[:3] == pytest.approx([1000 * x, -1000 * z, 1000 * y], rel=1e-6)
    x, y, z = rays.direction[1]
    assert row[3:6] == pytest.approx([x, -z, y], rel=1e-6)
    assert row[6] == pytest.approx(luminance(rays.flux[1]))


def test_round_trip(path, mi):
    rays = random_rays()
    write_tm25(path, rays, "name")
    again, name = read_tm25(path)
    assert name == "name"
    for member in ("origin", "direction", "flux"):
        # The primaries are rounded to four decimals.
        assert getattr(again, member) == pytest.approx(getattr(rays, member), abs=2e-3)
    assert luminance(again.flux) == pytest.approx(luminance(rays.flux), rel=1e-5)


GEOMETRY = [[1000, 2000, 3000, 0, 0, -1], [0, 0, 0, 0.6, 0.8, 0]]


def test_another_writers_file(path, mi):
    """Luminous flux alone, additional items and text; z is up, lengths are in mm."""
    rows = [[*geometry, 10.0 * (i + 1), 5, 6] for i, geometry in enumerate(GEOMETRY)]
    path.write_bytes(file_bytes(rows, [1, 1, 0, 0, 1, 0, 0, 0], additional=2, text=64))
    rays, name = read_tm25(path)
    assert name == "light ☀"
    assert rays.origin.tolist() == [[1, 3, -2], [0, 0, 0]]
    assert rays.direction == pytest.approx(np.array([[0, -1, 0], [0.6, 0, -0.8]]), abs=1e-6)
    assert luminance(rays.flux) == pytest.approx([10, 20])
    assert np.ptp(rays.flux, axis=1).max() < 1e-12


def read_flux(path, columns, *options, **more):
    rows = [[*geometry, *column] for geometry, column in zip(GEOMETRY, columns, strict=True)]
    path.write_bytes(file_bytes(rows, *options, **more))
    return read_tm25(path)[0].flux


@pytest.mark.parametrize(
    ("flags", "totals", "message"),
    [
        ([1, 1, 0, 0, 1, 0, 0, 0], (5e4, 0), "luminous flux of 50000 lm, but its rays have 5 lm"),
        ([1, 1, 0, 0, 1, 0, 0, 0], (5.2, 0), "luminous flux of 5.2 lm"),
        ([1, 1, 1, 0, 0, 0, 0, 0], (0, 0.5), "radiant flux of 0.5 W, but its rays have 5 W"),
        ([1, 1, 0, 0, 1, 0, 0, 0], (5.02, 9), None),
        # The light is white.
        ([1, 1, 1, 0, 0, 0, 0, 0], (9, np.nan), "of 9 lm, but its rays have 3415 lm"),
        ([1, 1, 1, 0, 0, 0, 0, 0], (3415, 5), None),
    ],
)
def test_a_header_with_another_total_is_said(path, mi, flags, totals, message):
    """The rays are used."""
    warned = pytest.warns(LumitreeWarning, match=message) if message else contextlib.nullcontext()
    with warned:
        flux = read_flux(path, [[2.0], [3.0]], flags, totals=totals)
    expected = 5 / LUMENS_PER_WATT if flags[4] else 5
    assert flux.sum(axis=0) == pytest.approx([expected] * 3)


def test_wavelengths(path, mi):
    """A watt of 555 nm has 683 lm; red is red, and luminous flux is kept in the gamut of sRGB."""
    one = read_flux(path, [[2.0], [1.0]], [1, 1, 1, 0, 0, 0, 0, 0], 1, (555, np.nan, np.nan))
    assert luminance(one) == pytest.approx([2 * LUMENS_PER_WATT, LUMENS_PER_WATT], rel=2e-3)
    each = read_flux(path, [[1.0, 460], [1.0, 630]], [1, 1, 1, 1, 0, 0, 0, 0], 2)
    # V(λ) of the CIE 1931 observer at 460 and 630 nm.
    assert luminance(each) == pytest.approx(LUMENS_PER_WATT * np.array([0.06, 0.265]), rel=0.01)
    assert each.argmax(axis=1).tolist() == [2, 0]
    # The spectrum gives the colour only, if there is luminous flux.
    both = read_flux(path, [[1, 460, 7], [1, 630, 8]], [1, 1, 1, 1, 1, 0, 0, 0], 2)
    assert luminance(both) == pytest.approx([7, 8])


ROWS = [[*geometry, 1.0] for geometry in GEOMETRY]
GOOD = [1, 1, 0, 0, 1, 0, 0, 0]


def changed(offset, form, value):
    data = bytearray(file_bytes(ROWS, GOOD))
    struct.pack_into(form, data, offset, value)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "0 bytes"),
        (b"RAYS" + file_bytes(ROWS, GOOD)[4:], "begin with"),
        (changed(4, "<i", 2020), "version is 2020"),
        (changed(20, "<Q", 0), "number of rays is 0"),
        (changed(20, "<Q", 3), "bytes; expected"),
        (changed(60, "<i", 5), "kind of spectral data is 5"),
        (changed(76, "<i", 1), "spectral table has"),
        (changed(80, "<i", 2**30), "additional items"),
        (changed(256, "<i", 0), "position and direction"),
        (changed(272, "<i", 0), "radiant or luminous"),
        (changed(HEADER, "<f", np.nan), "position"),
        (changed(HEADER + 12, "<f", 3.0), "length 1"),
        (changed(HEADER + 24, "<f", -1.0), "flux"),
        # Its colour would be black.
        (
            file_bytes(
                [[*row[:6], -1, 1] for row in ROWS] + [[*ROWS[0], 1]],
                [*GOOD[:7], 1],
                4,
                tables=[[[400, 1], [700, 1]]],
            ),
            "flux",
        ),
        (
            file_bytes(
                [[*row[:6], np.inf] for row in ROWS],
                [1, 1, 1, 0, 0, 0, 0, 0],
                1,
                wavelengths=(550, 400, 700),
            ),
            "flux",
        ),
        (file_bytes([[*row[:6], 0] for row in ROWS], GOOD), "flux"),
        (file_bytes(ROWS, GOOD, 3, tables=[[[500, 1], [400, 1]]]), "do not increase"),
        (file_bytes(ROWS, GOOD, 3, tables=[[[500, np.nan], [600, 1]]]), "NaN"),
        (file_bytes([[*row, 3] for row in ROWS], [*GOOD[:7], 1], 4, tables=[[[500, 1]]]), "none"),
    ],
)
def test_bad_files_are_refused_in_a_line(path, mi, data, message):
    path.write_bytes(data)
    with pytest.raises(LumitreeError, match=message) as error:
        read_tm25(path)
    assert str(error.value).isprintable()


BLUE, RED = np.array([[440.0, 0], [450, 2], [460, 0]]), np.array([[600.0, 1], [700, 1]])


def column(*values):
    return np.array(values, np.float64)[:, None]


def lines(*pairs):
    return sum(power * sampled_spectrum([at], [1]) for at, power in pairs)


def test_one_wavelength(mi):
    found = rays_spectrum({"radiant": column(1, 2)}, [], 1, 555.25)
    assert found == pytest.approx(lines((555.25, 1)))


@pytest.mark.parametrize("kind", ["radiant", "luminous"])
def test_a_wavelength_of_each_ray(mi, kind):
    """Luminous flux is radiant flux times V(λ)."""
    items = {kind: column(1, 2, 4, 8), "wavelength": column(400, 555.25, 700, 900)}
    efficacy = np.interp([400, 555.25, 700], WAVELENGTHS, matching_functions()[1])
    power = np.array([1, 2, 4]) / (efficacy if kind == "luminous" else 1)
    found = rays_spectrum(items, [], 2, np.nan)
    assert found == pytest.approx(lines(*zip([400, 555.25, 700], power, strict=True)))


def test_one_table(mi):
    found = rays_spectrum({"luminous": column(1, 2)}, [RED, BLUE], 3, np.nan)
    assert found.tolist() == sampled_spectrum(*RED.T).tolist()


def test_a_table_of_each_ray(mi):
    """By their power: tables are weights, which may have any sum."""
    items = {"radiant": column(1, 2, 4), "table": column(1, 2, 1)}
    found = rays_spectrum(items, [BLUE, [1, 7] * RED], 4, np.nan)
    blue, red = (sampled_spectrum(*each.T, means=True) for each in (BLUE, RED))
    expected = 5 * blue / 20 + 2 * red / 100
    assert found == pytest.approx(expected)


def test_luminous_flux_of_each_table(mi):
    items = {"luminous": column(1, 2, 4), "table": column(1, 2, 1)}
    found = rays_spectrum(items, [BLUE, RED], 4, np.nan)
    visible = matching_functions()[1]
    blue, red = (sampled_spectrum(*each.T, means=True) for each in (BLUE, RED))
    assert found == pytest.approx(5 * blue / (blue @ visible) + 2 * red / (red @ visible))


@pytest.mark.parametrize(
    ("items", "tables", "kind"),
    [
        ({}, [], 0),
        ({}, [], 1),
        ({}, [], 2),
        ({}, [], 3),
        ({}, [BLUE], 4),
        ({}, [BLUE[::-1]], 3),
        ({"table": column(2)}, [BLUE], 4),
        ({"table": column(np.nan)}, [BLUE], 4),
    ],
)
def test_files_without_a_usable_spectrum_have_none(mi, items, tables, kind):
    """Their colours may be known from tristimulus values."""
    assert rays_spectrum({"luminous": column(1), **items}, tables, kind, np.nan) is None
