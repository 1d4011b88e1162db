"""Photometric files and ray files: IES, EULUMDAT, TM-25, TM-33."""

import functools

import numpy as np

from fuzz import photometric_texts, words, xml_trees
from fuzz.reader import Reader
from fuzz.values import chance, pick
from lumitree.core.photometry import WAVELENGTHS
from lumitree.errors import LumitreeError
from lumitree.formats.ies import read_ies
from lumitree.formats.ldt import read_ldt
from lumitree.formats.tm25 import read_tm25
from lumitree.formats.tm33 import read_tm33
from support.damage import damaged
from support.sound_assets import assert_sound
from support.tm25_files import HEADER, file_bytes
from support.tm33_files import AREA, table, tm33

_DIRECTIONS = np.random.default_rng(0).normal(size=(40, 3))
_DIRECTIONS = np.concatenate([_DIRECTIONS, np.eye(3), -np.eye(3)])
# Lumens below which a lamp may be refused as one that emits nothing.
_DARK = 1e-6


def _text(make, name):
    """Function that makes a text and often changes it further."""

    def made(rng):
        content = make(rng)
        if chance(rng, 0.3):
            content = damaged(content, rng)
        return {name: content}

    return made


def _ies(rng):
    files = _text(photometric_texts.ies, "lamp.ies")(rng)
    if b"tilt.tlt" in files["lamp.ies"].lower():
        files["tilt.tlt"] = photometric_texts.tilt(rng).encode()
    return files


def _sound_distribution(lamp):
    assert np.isfinite(lamp.lumens)
    assert lamp.lumens >= 0
    values = lamp.at(_DIRECTIONS)
    assert np.isfinite(values).all()
    assert (values >= 0).all()
    assert lamp.name.isprintable()
    assert all(text.isprintable() for text in lamp.details.values())


def _bake(lamp, *colour):
    """The asset of intensities is sound, and is shown; if they are 0, that is said."""
    from lumitree.formats.light_field import bake_distribution

    try:
        asset = bake_distribution(lamp, *colour)
    except LumitreeError as error:
        if lamp.lumens > _DARK:
            raise AssertionError(f"intensities were read, but not baked: {error}") from error
        return
    _show(asset)


def _show(asset):
    # Mitsuba is loaded only for this.
    from fuzz.rendering import assert_renders

    assert_sound(asset)
    assert_renders(asset)


@functools.cache
def _tm25_kinds():
    """Columns of numbers after position and direction, flags, kind of spectra, and tables."""
    nanometres = np.array([[400.0, 1], [550, 3], [700, 2]])
    return (
        (1, [1, 1, 0, 0, 1, 0, 0, 0], 0, ()),
        (1, [1, 1, 1, 0, 0, 0, 0, 0], 0, ()),
        (3, [1, 1, 0, 0, 1, 0, 1, 0], 0, ()),
        (2, [1, 1, 1, 1, 0, 0, 0, 0], 2, ()),
        (8, [1, 1, 1, 0, 1, 1, 0, 0], 1, ()),
        (2, [1, 1, 0, 0, 1, 0, 0, 1], 4, (nanometres, nanometres[:2])),
        (1, [1, 1, 1, 0, 0, 0, 0, 0], 3, (nanometres,)),
    )


def _tm25(rng):
    """A ray file by the published layout, with changes that mostly keep its size right."""
    width, flags, kind, tables = pick(rng, _tm25_kinds())
    additional = pick(rng, (0, 0, 0, 2))
    count = int(rng.integers(1, 12))
    rows = rng.random((count, 6 + width + additional)).astype(np.float32)
    rows[:, 3:6] -= 0.5
    rows[:, 3:6] /= np.linalg.norm(rows[:, 3:6], axis=1, keepdims=True)
    if kind == 2:
        rows[:, 7] = rng.uniform(300, 900, count)
    if kind == 4:
        rows[:, 7] = rng.integers(1, 3, count)
    rows = words.changed_array(rows, rng) if chance(rng, 0.4) else rows
    if chance(rng, 0.3):
        tables = [words.changed_array(each.astype(np.float32), rng) for each in tables]
    if chance(rng, 0.1) and len(tables):
        tables = [np.resize(each, (int(rng.integers(0, 9)), 2)) for each in tables]
    totals = pick(rng, ((0, 0), (5, 5), (np.nan, np.inf)))
    lengths = pick(rng, ((np.nan,) * 3, (550.0, 400.0, 700.0), (0, 1e9, -1)))
    content = file_bytes(rows, flags, kind, lengths, tables, additional, 0, totals)
    if chance(rng, 0.5):
        content = _with_header(content, rng)
    if chance(rng, 0.1):
        content = damaged(content, rng) if chance(rng, 0.3) else words.flipped(content, rng)
    return {"lamp.ray": content}


def _with_header(content, rng):
    """A file with other integers or floats in its header."""
    data = np.frombuffer(content, np.uint8).copy()
    # Numbers before the texts, and the first table.
    places = [*range(4, 88, 4), *range(256, 288, 4), 288, HEADER]
    for at in rng.choice(places, int(rng.integers(1, 3))):
        kind = pick(rng, ("<i4", "<f4"))
        if at + 4 <= len(data):
            old = data[at : at + 4].view(kind)
            small = np.array([int(rng.integers(-2, 6))]).astype(kind)
            new = small if chance(rng, 0.4) else words.changed_array(old, rng)
            data[at : at + 4] = new.view(np.uint8)
    return data.tobytes()


def _sound_rays(found):
    rays, name = found
    assert name.isprintable()
    assert len(rays) > 0
    for values in (rays.origin, rays.direction, rays.flux):
        assert np.isfinite(values).all()
    assert np.allclose(np.linalg.norm(rays.direction, axis=1), 1, atol=1e-3)
    assert (rays.flux >= 0).all()
    assert rays.flux.any()
    if rays.spectrum is not None:
        assert rays.spectrum.shape == WAVELENGTHS.shape
        assert np.isfinite(rays.spectrum).all()
        assert (rays.spectrum >= 0).all()


def _bake_rays(found):
    from lumitree.formats.light_field import bake_rays
    from lumitree.trace.light_field_config import LightFieldConfig

    _show(bake_rays(*found, LightFieldConfig(depth=3, resolution=32)))


_SPECTRUM = (
    "<SpectralData><EmitterSpectral><PwrData w='400'>1</PwrData><PwrData w='500'>2</PwrData>"
    "<PwrData w='700'>1</PwrData></EmitterSpectral></SpectralData>"
)
_TILTS = "<BallastFactor>0.9</BallastFactor><TiltAngles><Tilt angle='0'>0.8</Tilt></TiltAngles>"
_KIND = "<Equipment><Gonioradiometer><Type>CIE{}</Type></Gonioradiometer></Equipment>"
_FULL_AREAS = AREA + AREA.replace("Bottom", "Top").replace("Width", "Width")


@functools.cache
def _tm33_texts():
    """Small valid files."""
    c, gamma, half = np.arange(0, 360, 90.0), np.arange(0, 181, 45.0), np.arange(-90, 91, 45.0)
    small = table(c, gamma)
    return (
        tm33(small),
        tm33(table([0.0], gamma), after=_SPECTRUM, before=_TILTS),
        tm33(table(half, half), top=_KIND.format("A")),
        tm33(table(half, half), top=_KIND.format("B")),
        tm33(table(c, gamma, extra="<Multiplier>2</Multiplier>"), areas=_FULL_AREAS, emitters=2),
        tm33(table(c, gamma, point="IntensityData", keys=("horz", "vert")), root="IESTM33"),
    )


def _tm33(rng):
    content = pick(rng, _tm33_texts()).encode()
    if chance(rng, 0.15):
        return {"lamp.tm33": damaged(content, rng)}
    return {"lamp.tm33": xml_trees.changed(content, rng)}


def _sound_tm33(found):
    lamp, colour = found
    _sound_distribution(lamp)
    assert np.isfinite(colour).all()
    assert min(colour) >= 0


READERS = (
    Reader(
        "ies",
        _ies,
        lambda folder: read_ies(folder / "lamp.ies"),
        _sound_distribution,
        _bake,
        in_suite=120,
    ),
    Reader(
        "ldt",
        _text(photometric_texts.ldt, "lamp.ldt"),
        lambda folder: read_ldt(folder / "lamp.ldt"),
        _sound_distribution,
        _bake,
        in_suite=120,
    ),
    Reader(
        "tm25",
        _tm25,
        lambda folder: read_tm25(folder / "lamp.ray"),
        _sound_rays,
        _bake_rays,
        in_suite=80,
    ),
    Reader(
        "tm33",
        _tm33,
        lambda folder: read_tm33(folder / "lamp.tm33"),
        _sound_tm33,
        lambda found: _bake(*found),
        in_suite=80,
    ),
)
