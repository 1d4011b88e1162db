"""The geometry of an asset for the page: triangles, and what their surfaces send out.

Symbols
    V, F    vertices and triangles
"""

import dataclasses
from collections.abc import Mapping

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.array_stream import Arrays
from lumitree.asset.asset import Asset
from lumitree.core.device import on_device
from lumitree.core.octahedral import octahedral
from lumitree.core.results import Json
from lumitree.exports.surfaces import geometry_meshes, meshed
from lumitree.rendering.asset_images import vertex_radiance
from lumitree.rendering.studio import portrait_half_width, studio_lights
from lumitree.viewer.surfaces import SIDE, WRAPS, Kind, PageSurface, Patterns, page_surface
from lumitree.viewer.triangles import Triangles, smoothed

# Codes of coordinates from -1 to 1, local units, and of octahedral coordinates of normals.
_POSITION_CODES, _NORMAL_CODES = 1 << 18, 1 << 11
# Codes of a side of an image.
_PLACE_CODES = 1 << 13
# Codes of radiance for a factor of 2, and factors of 2 from the least radiance to the largest.
_CODES_A_STOP, _STOPS = 32, 30
# Paths that end at all triangles together; and at one, at least and at most.
_PATHS, _LEAST_PATHS, _MOST_PATHS = 1 << 19, 4, 128


@dataclasses.dataclass(frozen=True)
class PageModel:
    """The geometry for the page.

    Attributes:
        description: numbers, for JSON.
        arrays: codes by name: "positions" [V, 3], "normals" [V, 2], "places" [V, 2] on the
            image of their pattern, "light" [V, 6] of the front's and the back's R, G and B, which
            the pattern is a factor of, and "soft" [V, 6], the same by the light of the studio
            only; "triangles" [F, 3], vertices; and "surfaces" [F], rows of the description's
            "surfaces".
    """

    description: Json
    arrays: Arrays


def page_model(asset: Asset) -> PageModel:
    """The geometry of an asset, which it has. Its surfaces' radiance is traced here."""
    assert asset.geometry is not None
    # Points on a chord of a curved surface are below it, so the page's triangles are traced.
    geometry = meshed(asset.geometry)
    asset = dataclasses.replace(asset, geometry=geometry)
    meshes = geometry_meshes(geometry, asset.frame.local_from_world)
    rows: list[PageSurface] = []
    patterns = Patterns(geometry)
    triangles = Triangles(patterns)
    for shape, mesh in zip(geometry.shapes, meshes, strict=True):
        surface = page_surface(geometry, shape, asset.frame.scale)
        pattern = patterns.of(shape) if surface.kind == Kind.BAKED else None
        if pattern is not None:
            number, texture = pattern
            wrap = WRAPS[texture.wrap_mode]
            surface = dataclasses.replace(surface, pattern=number + 1, wrap=wrap)
        if surface not in rows:
            rows.append(surface)
        triangles.add(mesh, rows.index(surface), surface.kind == Kind.BAKED, pattern)
    vertices, normals, places, means, faces, surfaces = triangles.joined()
    baked = np.array([row.kind == Kind.BAKED for row in rows])[surfaces]
    backs = baked & np.array([row.has_back for row in rows])[surfaces]
    visible = faces[baked], faces[backs]
    light = _sent_out(asset, vertices, means, *visible)
    largest = float(light.max()) or 1.0
    # The pattern of an emitter is the pattern of its emission.
    means[faces[np.array([row.emits for row in rows])[surfaces]]] = 1.0
    lights = studio_lights(portrait_half_width(asset), 1.0)
    # By the light of the studio alone, the lamp emits nothing.
    dark = tuple(dataclasses.replace(shape, radiance=None) for shape in geometry.shapes)
    unlit = dataclasses.replace(asset, geometry=dataclasses.replace(geometry, shapes=dark))
    soft = _sent_out(unlit, vertices, means, *visible, lights)
    largest_soft = float(soft.max()) or 1.0

    description = {
        "triangles": len(faces),
        "surfaces": [number for row in rows for number in row.numbers()],
        "max_radiance": largest,
        "max_soft": largest_soft,
        "patterns": patterns.encoded(),
        "pattern_side": SIDE,
        "codes": [
            _POSITION_CODES,
            _NORMAL_CODES,
            _CODES_A_STOP,
            _STOPS * _CODES_A_STOP,
            _PLACE_CODES,
        ],
    }
    on_octahedron = np.array(octahedral(on_device(mi.Vector3f, normals)), np.float32)
    arrays = {
        "positions": _codes(vertices, _POSITION_CODES).astype(np.int32),
        "normals": _codes(on_octahedron.reshape(2, -1).T, _NORMAL_CODES).astype(np.int16),
        "places": np.rint(places * _PLACE_CODES).astype(np.int32),
        "light": _radiance_codes(light / largest),
        "soft": _radiance_codes(soft / largest_soft),
        "triangles": faces.astype(np.int32),
        "surfaces": surfaces.astype(np.uint8 if len(rows) <= 256 else np.uint16),
    }
    return PageModel(description, arrays)


def _sent_out(
    asset: Asset,
    vertices: NDArray[np.float32],
    pattern: NDArray[np.floating],
    fronts: NDArray[np.integer],
    backs: NDArray[np.integer],
    lights: Mapping[str, object] | None = None,
) -> NDArray[np.float32]:
    """Mean radiance [V, 6] that vertices send out at front and back, over the mean of a pattern."""
    count = len(vertices)
    if not len(fronts):
        return np.zeros((count, 6), np.float32)
    # The back is another surface, whose triangles turn the other way.
    faces = np.concatenate([fronts, backs[:, ::-1] + count])
    paths = int(np.clip(_PATHS // len(faces), _LEAST_PATHS, _MOST_PATHS))
    both, patterns = np.concatenate([vertices, vertices]), np.concatenate([pattern, pattern])
    name = f"surfaces of {asset.luminaire}" + (", softly lit" if lights else "")
    # Half of the paths alike for all triangles, half by area, which a pattern's means do not count.
    corners = both[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    shaded = (patterns[faces] != 1).any(axis=(1, 2))
    share = np.where(shaded, 1, np.rint(area / area.mean())).astype(np.int64)
    rows = np.repeat(faces, 1 + share, axis=0)
    radiance, variance = vertex_radiance(
        asset, both, rows.astype(np.uint32), paths // 2, name, lights
    )
    # A path counts for three vertices.
    number = np.bincount(rows.ravel(), minlength=2 * count) * (paths // 2 / 3)
    used, order = np.unique(faces, return_inverse=True)
    columns = radiance[used]
    if shaded.any():
        columns = np.concatenate([columns, patterns[used]], axis=1)
    found = smoothed(columns, variance[used], number[used], both[used], order.reshape(faces.shape))
    if shaded.any():
        found = found[:, :3] / np.maximum(found[:, 3:], 1e-9)
    result = np.zeros((2 * count, 3), np.float32)
    result[used] = found
    front, back = np.split(result, 2)
    return np.concatenate([front, back], axis=1)


def _codes(values: NDArray[np.floating], count: int) -> NDArray[np.floating]:
    """Integers from 0 to `count` - 1 of values from -1 to 1."""
    return np.rint((np.clip(values, -1, 1) + 1) / 2 * (count - 1))


def _radiance_codes(relative: NDArray[np.floating]) -> NDArray[np.int16]:
    """Codes of radiance [V, 6] from 0 to 1: R and B of each side as the difference to G.

    A code c > 0 is 2^(c / `_CODES_A_STOP` - `_STOPS`), and 0 is 0.
    """
    stops = np.log2(np.maximum(relative, 2.0 ** -(_STOPS + 1))) + _STOPS
    codes = np.rint(np.maximum(stops, 0) * _CODES_A_STOP).astype(np.int16).reshape(-1, 2, 3)
    codes[..., ::2] -= codes[..., 1:2]
    return codes.reshape(-1, 6)
