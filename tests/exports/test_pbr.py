"""Materials by metalness and roughness, their images, and meshes with them."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.geometry import Medium, MeshShape
from lumitree.asset.materials import (
    PLUGINS,
    Conductor,
    Dielectric,
    Principled,
    RoughConductor,
    RoughPlastic,
    ThinDielectric,
)
from lumitree.core.frames import rows_of
from lumitree.core.images import linear_from_srgb
from lumitree.exports.surfaces import PbrImages
from support.every_material import MATERIALS, TEXTURE, every_material
from support.geometry_assets import IDENTITY, small_geometry, with_geometry
from support.gltf_builder import sphere

pytestmark = pytest.mark.usefixtures("mi")


def converted(material, **shape):
    from lumitree.exports.pbr import shape_material

    geometry = small_geometry()
    geometry = small_geometry(materials=(material, *geometry.materials[1:]))
    found = shape_material(geometry, dataclasses.replace(geometry.shapes[0], **shape), (1, 1, 1))
    return found, found.lost


def test_all_plugins_that_an_asset_may_have_are_converted():
    from lumitree.exports.pbr import shape_material

    assert set(map(type, MATERIALS)) == set(PLUGINS.values())
    geometry, lost = every_material(), set()
    for shape in geometry.shapes:
        found = shape_material(geometry, shape, (2.0, 1.0, 0.5))
        lost |= found.lost
        assert found.emission.factor == (2.0, 1.0, 0.5)
        assert found.emission.texture == TEXTURE
        assert found.index >= 1
    assert any("media outside of a shape" in line for line in lost)
    assert any("bump maps" in line for line in lost)


@pytest.mark.parametrize("kind", [Dielectric, ThinDielectric, RoughPlastic])
@pytest.mark.parametrize("factor", [0.5, (1.0, 0.9, 0.8), TEXTURE])
def test_factors_of_what_glass_and_plastic_reflect_are_said_to_be_lost(kind, factor):
    assert not converted(kind(specular_reflectance=1.0))[1]
    _, lost = converted(kind(specular_reflectance=factor))
    assert any("factors of what glass and plastic reflect" in line for line in lost)


def test_roughness_is_the_root_of_alpha():
    assert converted(RoughPlastic(alpha=0.09))[0].roughness.number == 0.3
    assert converted(Conductor())[0].roughness.number == 0
    textured, _ = converted(RoughConductor(alpha=dataclasses.replace(TEXTURE, raw=True)))
    pixels = PbrImages(small_geometry().images).number_pixels(textured.roughness)
    image = small_geometry().images[1] / 255
    expected = np.sqrt(image) @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(pixels / 255, expected, atol=1 / 255)


def test_glass_that_faces_inwards_refracts_outwards():
    found, lost = converted(Dielectric(int_ior=1.0, ext_ior=1.5))
    assert found.index == pytest.approx(1.5)
    assert any("faces inwards" in line for line in lost)
    found, lost = converted(Dielectric(specular_transmittance=(1.0, 0.5, 0.2)))
    # Light crosses a solid twice.
    np.testing.assert_allclose(found.colour.factor, [1, 0.25, 0.04])
    assert not lost


def test_a_medium_is_inside_of_what_refracts():
    shape = {"interior": Medium((1.0, 2.0, 3.0))}
    assert converted(Dielectric(), **shape)[0].absorption == (1, 2, 3)
    assert converted(ThinDielectric(), **shape)[0].absorption is None
    milk = Medium((1.0, 0.0, 0.0), (5.0, 5.0, 5.0))
    found, lost = converted(Dielectric(), interior=milk)
    assert found.absorption == (1, 0, 0)
    assert any("do not scatter" in line for line in lost)


def test_colours_of_images_are_encoded_by_srgb():
    from lumitree.exports.pbr import layer

    random = np.random.default_rng(1)
    linear = random.uniform(0, 5, (4, 6, 3)).astype(np.float32)
    bytes_ = random.integers(0, 256, (4, 6, 1), np.uint8)
    images = PbrImages((linear, bytes_))
    texture = dataclasses.replace(TEXTURE, image=0)
    pixels, factor = images.colour_pixels(layer(texture))
    assert factor == pytest.approx(linear.max())
    found = factor * linear_from_srgb(pixels / 255)
    np.testing.assert_allclose(found, linear, atol=0.02 * linear.max())
    # Bytes that are encoded already stay, and linear ones are encoded.
    pixels, factor = images.colour_pixels(layer(TEXTURE))
    assert factor == 1
    np.testing.assert_array_equal(pixels, np.broadcast_to(bytes_, (4, 6, 3)))
    pixels, factor = images.colour_pixels(layer(dataclasses.replace(TEXTURE, raw=True)))
    np.testing.assert_allclose(
        factor * linear_from_srgb(pixels[..., :1] / 255), bytes_ / 255, atol=0.01
    )
    assert images.add(pixels) == images.add(pixels.copy())
    assert len(images.files) == 1


def test_surfaces_have_coordinates_for_each_map_of_a_texture():
    from lumitree.exports.surfaces import surfaces_of

    to_uv = rows_of([[0, 2, 0, 0.5], [1, 0, 0, 0], *IDENTITY[2:]])
    turned = dataclasses.replace(TEXTURE, to_uv=to_uv)
    material = Principled(base_color=TEXTURE, roughness=turned)
    geometry = small_geometry()
    geometry = small_geometry(materials=(material, *geometry.materials[1:]))
    (surface, *_), _ = surfaces_of(with_geometry(geometry), np.eye(3))
    u, v = geometry.texcoords.T
    assert (surface.uv_set(TEXTURE), surface.uv_set(turned)) == (0, 1)
    np.testing.assert_allclose(surface.uv[0], geometry.texcoords)
    np.testing.assert_allclose(surface.uv[1], np.stack([2 * v + 0.5, u], axis=1), rtol=1e-6)
    assert "colours" not in surface.mesh
    np.testing.assert_allclose(np.linalg.norm(surface.mesh["normals"], axis=1), 1, rtol=1e-6)


def test_the_thickness_of_a_shell_is_that_of_its_wall():
    from lumitree.exports.surfaces import surfaces_of

    outer, inner = sphere(0.5), sphere(0.48)
    vertices = np.concatenate([outer.vertices, inner.vertices]) + np.array([0.2, 0, 0])
    faces = np.concatenate([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)])
    none = np.zeros((0, 3), np.float32)
    shape = MeshShape(material=2, vertices=len(vertices), faces=len(faces))
    geometry = small_geometry(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.uint32),
        shapes=(shape,),
        normals=none,
        texcoords=none[:, :2],
        colours=none,
    )
    (surface,), _ = surfaces_of(with_geometry(geometry), np.eye(3))
    assert surface.thickness == pytest.approx(0.02, rel=0.01)
