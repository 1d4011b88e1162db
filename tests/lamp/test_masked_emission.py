"""Emission of surfaces with an opacity mask."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.materials import Diffuse, Texture
from lumitree.core.images import srgb_from_linear
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp import materials
from lumitree.lamp.importers.overrides import opacity_of_faces
from lumitree.lamp.materials import MaskedEmission, Material
from lumitree.lamp.meshes import Mesh

HALF = np.zeros((64, 64, 1), np.uint8)
HALF[:, 32:] = 255
# The unit square; its image has its left half masked.
SQUARE = Mesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
    np.tile([0.0, 0, 1], (4, 1)),
    np.array([[0, 1, 2], [0, 2, 3]]),
    np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]]),
)


MASK = Texture(image=0, raw=True)
LIGHT = Texture(image=1, raw=True)


def emitted(radiance, opacity, *images):
    """Emission, and its pixels if it is a texture."""
    images = [HALF, *images]
    found = MaskedEmission(images).of(Material("a", Diffuse(), radiance, opacity))
    return (found, images[found.image]) if isinstance(found, Texture) else found


def moved(scale, shift):
    return ((scale, 0, 0, shift), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))


def test_constants():
    assert emitted(None, 0.5) is None
    assert emitted((4.0, 2.0, 1.0), 0.0) is None
    assert emitted((4.0, 2.0, 1.0), 1.0) == (4, 2, 1)
    assert emitted((4.0, 2.0, 1.0), 0.5) == (2, 1, 0.5)


def test_a_constant_radiance_takes_the_image_of_the_opacity():
    opacity = dataclasses.replace(MASK, wrap_mode="clamp", to_uv=moved(1.0, 0.25))
    found, pixels = emitted((4.0, 2.0, 1.0), opacity)
    np.testing.assert_allclose(pixels, HALF / 255 * [4, 2, 1])
    assert found == dataclasses.replace(opacity, image=1)


@pytest.mark.parametrize("side", [1, 2, 64, 128])
def test_images_of_other_sizes_keep_the_finer_one(side):
    """Neither is reduced to the pixels of the other, which could all be masked."""
    _, found = emitted(LIGHT, MASK, np.full((side, side, 3), 3, np.float32))
    assert found.shape == (max(side, 64), max(side, 64), 3)
    assert found.mean() == pytest.approx(1.5)
    middle = found.shape[1] // 2
    np.testing.assert_allclose(found[:, : middle - 2], 0)
    np.testing.assert_allclose(found[:, middle + 2 :], 3)


def test_encoded_images_are_decoded():
    encoded = np.round(255 * srgb_from_linear(np.full((1, 1, 3), 0.2))).astype(np.uint8)
    found, pixels = emitted(Texture(image=1, raw=False), 0.5, encoded)
    assert found.raw
    np.testing.assert_allclose(pixels, 0.1, rtol=0.01)


def test_an_opacity_with_other_coordinates_counts_by_its_mean():
    with pytest.warns(LumitreeWarning, match="'a': its opacity has other texture coordinates"):
        _, found = emitted(
            LIGHT, dataclasses.replace(MASK, wrap_mode="mirror"), np.full((4, 4, 3), 3, np.float32)
        )
    np.testing.assert_allclose(found, 1.5)


def test_what_several_materials_share_is_made_once(monkeypatch):
    images = [HALF]
    emission = MaskedEmission(images)
    made = {emission.of(Material(name, Diffuse(), (1.0, 1.0, 1.0), MASK)).image for name in "ab"}
    assert made == {1}
    monkeypatch.setattr(materials, "_MAX_BYTES", int(1.5 * images[1].nbytes))
    with pytest.raises(LumitreeError, match="brings such"):
        emission.of(Material("c", Diffuse(), (2.0, 1.0, 1.0), MASK))


@pytest.mark.parametrize(
    ("wrap", "scale", "shift"),
    [("repeat", 2.0, 0.0), ("repeat", 1.0, 0.25), ("mirror", 0.5, -0.75), ("clamp", 2.0, 0.0)],
)
def test_the_opacity_of_faces_is_that_of_their_points(wrap, scale, shift):
    """Against the mean over many random points of the square."""
    texture = dataclasses.replace(MASK, wrap_mode=wrap, to_uv=moved(scale, shift))
    found = opacity_of_faces(texture, SQUARE, [HALF]).mean()
    u = scale * np.random.default_rng(1).random(200_000) + shift
    if wrap == "mirror":
        u = np.where(np.floor(u) % 2 == 0, u % 1, 1 - u % 1)
    u = u % 1 if wrap == "repeat" else np.clip(u, 0, 1)
    assert found == pytest.approx((u >= 0.5).mean(), abs=0.01)


def test_the_opacity_of_constants_and_of_meshes_without_coordinates():
    np.testing.assert_array_equal(opacity_of_faces(0.25, SQUARE), [0.25, 0.25])
    bare = Mesh(SQUARE.vertices, SQUARE.normals, SQUARE.faces)
    np.testing.assert_array_equal(opacity_of_faces(MASK, bare, [HALF]), [0, 0])
