"""Emission of surfaces with an opacity mask."""

import numpy as np
import pytest

from lumitree.core.images import srgb_from_linear
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp import scene_writer as masked_emission
from lumitree.lamp.importers.overrides import opacity_of_faces
from lumitree.lamp.meshes import Mesh
from lumitree.lamp.parts import Diffuse, Material, Texture
from lumitree.lamp.scene_writer import MaskedEmission

HALF = np.zeros((64, 64, 1), np.uint8)
HALF[:, 32:] = 255
# The unit square; its image has its left half masked.
SQUARE = Mesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
    np.tile([0.0, 0, 1], (4, 1)),
    np.array([[0, 1, 2], [0, 2, 3]]),
    np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]]),
)


def emitted(radiance, opacity):
    return MaskedEmission().of(Material("a", Diffuse(), radiance, opacity))


def test_constants():
    assert emitted(None, 0.5) is None
    assert emitted((4.0, 2.0, 1.0), 0.0) is None
    assert emitted((4.0, 2.0, 1.0), 1.0) == (4, 2, 1)
    assert emitted((4.0, 2.0, 1.0), 0.5) == (2, 1, 0.5)


def test_a_constant_radiance_takes_the_image_of_the_opacity():
    moved = np.array([[1, 0, 0.25], [0, 1, 0], [0, 0, 1.0]])
    found = emitted((4.0, 2.0, 1.0), Texture(HALF, False, "clamp", uv_transform=moved))
    np.testing.assert_allclose(found.pixels, HALF / 255 * [4, 2, 1])
    assert (found.wrap, found.encoded) == ("clamp", False)
    np.testing.assert_array_equal(found.uv_transform, moved)


@pytest.mark.parametrize("side", [1, 2, 64, 128])
def test_images_of_other_sizes_keep_the_finer_one(side):
    """Neither is reduced to the pixels of the other, which could all be masked."""
    light = Texture(np.full((side, side, 3), 3, np.float32), False)
    found = emitted(light, Texture(HALF, False)).pixels
    assert found.shape == (max(side, 64), max(side, 64), 3)
    assert found.mean() == pytest.approx(1.5)
    middle = found.shape[1] // 2
    np.testing.assert_allclose(found[:, : middle - 2], 0)
    np.testing.assert_allclose(found[:, middle + 2 :], 3)


def test_encoded_images_are_decoded():
    encoded = np.round(255 * srgb_from_linear(np.full((1, 1, 3), 0.2))).astype(np.uint8)
    found = emitted(Texture(encoded, True), 0.5)
    assert not found.encoded
    np.testing.assert_allclose(found.pixels, 0.1, rtol=0.01)


def test_an_opacity_with_other_coordinates_counts_by_its_mean():
    light = Texture(np.full((4, 4, 3), 3, np.float32), False)
    with pytest.warns(LumitreeWarning, match="'a': its opacity has other texture coordinates"):
        found = emitted(light, Texture(HALF, False, "mirror"))
    np.testing.assert_allclose(found.pixels, 1.5)


def test_what_several_materials_share_is_made_once(monkeypatch):
    emission, mask = MaskedEmission(), Texture(HALF, False)
    first, second = (
        emission.of(Material(name, Diffuse(), (1.0, 1.0, 1.0), mask)).pixels for name in "ab"
    )
    assert first is second
    monkeypatch.setattr(masked_emission, "_MAX_BYTES", int(1.5 * first.nbytes))
    with pytest.raises(LumitreeError, match="brings such"):
        emission.of(Material("c", Diffuse(), (2.0, 1.0, 1.0), mask))


@pytest.mark.parametrize(
    ("wrap", "scale", "shift"),
    [("repeat", 2.0, 0.0), ("repeat", 1.0, 0.25), ("mirror", 0.5, -0.75), ("clamp", 2.0, 0.0)],
)
def test_the_opacity_of_faces_is_that_of_their_points(wrap, scale, shift):
    """Against the mean over many random points of the square."""
    transform = np.array([[scale, 0, shift], [0, 1, 0], [0, 0, 1]])
    found = opacity_of_faces(Texture(HALF, False, wrap, uv_transform=transform), SQUARE).mean()
    u = scale * np.random.default_rng(1).random(200_000) + shift
    if wrap == "mirror":
        u = np.where(np.floor(u) % 2 == 0, u % 1, 1 - u % 1)
    u = u % 1 if wrap == "repeat" else np.clip(u, 0, 1)
    assert found == pytest.approx((u >= 0.5).mean(), abs=0.01)


def test_the_opacity_of_constants_and_of_meshes_without_coordinates():
    np.testing.assert_array_equal(opacity_of_faces(0.25, SQUARE), [0.25, 0.25])
    bare = Mesh(SQUARE.vertices, SQUARE.normals, SQUARE.faces)
    np.testing.assert_array_equal(opacity_of_faces(Texture(HALF, False), bare), [0, 0])
