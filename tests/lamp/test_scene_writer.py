"""The scene writer: what a model says is what Mitsuba loads."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Diffuse, MetallicRoughness, Texture, VertexColours
from lumitree.lamp.materials import Material, glass, metal
from lumitree.lamp.meshes import Mesh
from lumitree.lamp.parts import Geometry, Part
from lumitree.lamp.scene_file import SceneFile
from lumitree.lamp.scene_writer import write_scene

# A square that faces +z; v = 0 at its top.
SQUARE = Mesh(
    np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
    np.tile([0.0, 0, 1], (4, 1)),
    np.array([[0, 1, 2], [0, 2, 3]]),
    np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]]),
    np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]),
)
IMAGES = (np.full((2, 2, 3), (128, 128, 255), np.uint8), np.full((2, 2, 1), 99, np.uint8))
FLAT, GREY = (Texture(image=at, raw=True) for at in range(2))


ONE_PLACE = (np.eye(4),)


def written(mi, folder, surface, places=ONE_PLACE, images=IMAGES, **fields):
    material = Material("coat", surface, **fields)
    model = Geometry((Part("square", SQUARE, "coat", places),), (material,), images)
    return mi.load_file(str(write_scene(model, folder)))


def hit(mi, scene, x, y, side=1.0):
    origin = mi.Point3f([float(x)], [float(y)], [5 * side])
    return scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -side)))


def reflectance(mi, scene, x, y):
    si = hit(mi, scene, x, y)
    return np.array(si.bsdf().eval_diffuse_reflectance(si)).ravel()


@pytest.mark.parametrize("coordinates", [True, False])
def test_masked_emitters_emit_where_they_are(mi, tmp_path, coordinates):
    """The mask of a mesh without texture coordinates has one value, at (0, 0)."""
    mask = Texture(image=0, raw=True, filter_type="nearest")
    image = np.array([[[51], [255]], [[255], [0]]], np.uint8)
    mesh = SQUARE if coordinates else dataclasses.replace(SQUARE, uv=None)
    material = Material("coat", Diffuse(), (3.0, 2.0, 1.0), mask)
    model = Geometry((Part("square", mesh, "coat", ONE_PLACE),), (material,), (image,))
    scene = mi.load_file(str(write_scene(model, tmp_path)))
    for x, y, share in ((-0.5, 0.5, 0.2), (0.5, 0.5, 1), (0.5, -0.5, 0)):
        si = hit(mi, scene, x, y)
        found = np.array(si.emitter(scene).eval(si)).ravel()
        np.testing.assert_allclose(
            found, (share if coordinates else 0.2) * np.array([3, 2, 1]), rtol=1e-4
        )


@pytest.mark.parametrize(
    ("surface", "plugin"),
    [
        (metal(roughness=0.6), {"type": "roughconductor", "material": "none"}),
        (
            glass(ior=1.5, roughness=0.6),
            {"type": "roughdielectric", "int_ior": 1.5, "ext_ior": 1.0},
        ),
    ],
)
def test_microfacets_are_those_of_ggx(mi, tmp_path, surface, plugin):
    """As of glTF's materials: highlights have long tails; and no light is lost between them."""
    scene = written(mi, tmp_path, surface)
    si = hit(mi, scene, 0, 0)
    si.wi = mi.Vector3f(0, 0, 1)
    # Beyond the peak, where Beckmann's distribution has half as much.
    out = mi.Vector3f(float(np.sin(1.25)), 0, float(np.cos(1.25)))

    def reflected(bsdf):
        return np.array(bsdf.eval(mi.BSDFContext(), si, out)).ravel()

    single = reflected(mi.load_dict({**plugin, "distribution": "ggx", "alpha": 0.36}))
    assert (single > 1.2 * reflected(mi.load_dict({**plugin, "alpha": 0.36}))).all()
    # Light that is scattered more than once is a part of the diffuse lobe.
    context = mi.BSDFContext()
    context.type_mask = mi.BSDFFlags.Glossy
    found = np.array(si.bsdf().eval(context, si, out)).ravel()
    np.testing.assert_allclose(found, single, rtol=1e-4)
    assert (reflected(si.bsdf()) > 1.02 * single).all()


def corners():
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0], pixels[0, 1], pixels[1, 0] = (188, 0, 0), (0, 188, 0), (0, 0, 188)
    return pixels


@pytest.mark.parametrize(("encoded", "value"), [(True, 0.5029), (False, 188 / 255)])
def test_the_first_row_is_at_v_0_and_values_are_decoded(mi, tmp_path, encoded, value):
    scene = written(
        mi,
        tmp_path,
        Diffuse(reflectance=Texture(image=0, raw=not encoded, filter_type="nearest")),
        images=(corners(),),
    )
    for x, y, channel in ((-0.5, 0.5, 0), (0.5, 0.5, 1), (-0.5, -0.5, 2)):
        expected = np.zeros(3)
        expected[channel] = value
        np.testing.assert_allclose(reflectance(mi, scene, x, y), expected, atol=1e-3)


@pytest.mark.parametrize(
    "surface",
    [
        glass(tint=(1, 0.5, 0.2), roughness=0.3),
        glass(thin=True),
        metal((0.9, 0.8, 0.7), 0.2, "Au"),
        MetallicRoughness(thin=True, diff_trans=1.0),
        MetallicRoughness(base_color=VertexColours(), roughness=GREY),
    ],
)
def test_every_surface_loads_under_every_layer(mi, tmp_path, surface):
    fields = {"opacity": 0.5, "normal_map": FLAT, "two_sided": True}
    scene = written(mi, tmp_path, surface, **fields)
    si = hit(mi, scene, 0.1, 0.2)
    sample, weight = si.bsdf().sample(
        mi.BSDFContext(), si, mi.Float([0.2]), mi.Point2f([0.3], [0.6])
    )
    assert np.isfinite(np.array(weight)).all()
    assert np.linalg.norm(np.array(sample.wo).ravel()) == pytest.approx(1, abs=1e-3)


def test_copies_share_a_mesh_and_stand_in_their_places(mi, tmp_path):
    places = []
    for x in (-4.0, 4.0):
        place = 0.5 * np.eye(4)
        place[:, 3] = (x, 0, 0, 1)
        places.append(place)
    scene = written(mi, tmp_path, Diffuse(), tuple(places))
    assert len(scene.shapes()) == 2
    assert [path.name for path in (tmp_path / "meshes").iterdir()] == ["square.ply"]
    np.testing.assert_allclose(np.ravel(scene.bbox().min), (-4.5, -0.5, 0), atol=1e-6)
    np.testing.assert_allclose(np.ravel(scene.bbox().max), (4.5, 0.5, 0), atol=1e-6)


def test_media_have_their_coefficients(mi, tmp_path):
    medium = Medium((2.0, 0.5, 0.0), (0.0, 1.5, 0.25), 0.3)
    scene = written(mi, tmp_path, glass(), medium=medium)
    parameters = mi.traverse(scene.shapes()[0].interior_medium())
    scale = np.ravel(parameters["scale"])
    extinction = np.ravel(parameters["sigma_t.value.value"]) * scale
    albedo = np.ravel(parameters["albedo.value.value"])
    np.testing.assert_allclose(extinction, (2, 2, 0.25), rtol=1e-5)
    np.testing.assert_allclose(extinction * albedo, (0, 1.5, 0.25), atol=1e-6)


def test_names_of_copies_materials_and_parts_do_not_collide(tmp_path):
    """Whatever they are called: shapes and materials have one namespace in a scene."""
    places = (np.eye(4), np.diag([1.0, 1, -1, 1]))
    grey = Diffuse(reflectance=(0.5, 0.5, 0.5))
    parts = (
        Part("crystal", SQUARE, "bulb", places),
        Part("crystal_2", SQUARE, "bulb"),
        Part("crystal_1", SQUARE, "bulb"),
        Part("material_bulb", SQUARE, "bulb"),
    )
    scene = write_scene(Geometry(parts, (Material("bulb", grey),)), tmp_path)
    names = [shape.name for shape in SceneFile(scene).shapes]
    assert names == ["crystal_1_2", "crystal_2_2", "crystal_2", "crystal_1", "material_bulb_2"]
