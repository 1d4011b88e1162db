"""Materials as nodes of Blender, and shapes as meshes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lumitree.asset.geometry import Medium, MeshShape, UnitShape
from lumitree.asset.materials import PLUGINS, Conductor, NormalMap
from lumitree.core.frames import rows_of, similarity
from lumitree.exports.surfaces import LOST_MIRRORED, geometry_meshes, mirrored_share
from support.every_material import DIFFUSE, MATERIALS, TEXTURE, every_material
from support.geometry_assets import NOTHING, small_geometry

pytestmark = pytest.mark.usefixtures("mi")


def trees(geometry):
    from lumitree.exports.blender_nodes import BlenderMaterials

    surfaces, meshes = BlenderMaterials(geometry), geometry_meshes(geometry, np.eye(4))
    return list(map(surfaces.tree, geometry.shapes, meshes)), surfaces.lost


def nodes_of(tree):
    yield tree
    for value in tree["inputs"].values():
        if isinstance(value, dict):
            yield from nodes_of(value)


def test_emission_has_the_gain_of_the_asset_and_the_tint_of_the_lamp():
    """The gain as numbers, or as a node where a texture emits; the tint as a node with a driver."""
    from lumitree.exports.blender_nodes import BlenderMaterials

    geometry = small_geometry()
    shapes = [*geometry.shapes[1:], replace(geometry.shapes[0], radiance=TEXTURE)]
    colours = []
    for shape in shapes:
        (emission,) = (
            each
            for each in nodes_of(BlenderMaterials(geometry, (2.0, 1.0, 0.5)).tree(shape, {}))
            if each["node"] == "ShaderNodeEmission"
        )
        product = emission["inputs"]["Color"]
        assert product["set"]["blend_type"] == "MULTIPLY"
        assert product["inputs"][7]["set"]["name"] == "lumitree tint"
        colours.append(product["inputs"][6])
    assert colours[:2] == [[6.0, 2.0, 0.5], [5.0, 2.5, 1.25]]
    assert colours[2]["set"]["blend_type"] == "MULTIPLY"
    assert colours[2]["inputs"][7] == [2.0, 1.0, 0.5]


def test_all_plugins_that_an_asset_may_have_become_nodes():
    assert set(map(type, MATERIALS)) == set(PLUGINS.values())
    found, lost = trees(every_material())
    json.dumps(found, allow_nan=False)
    assert all(any(each["node"] == "ShaderNodeEmission" for each in nodes_of(t)) for t in found)
    assert any("normal incidence" in line for line in lost)
    assert any("media outside of a shape" in line for line in lost)
    normals = [
        each["inputs"]["Normal"]["node"]
        for tree in found
        for each in nodes_of(tree)
        if "Normal" in each["inputs"]
    ]
    assert normals == ["ShaderNodeNormalMap", "ShaderNodeBump"]


def test_media_that_scatter_absorb():
    milk = Medium((0.25, 1.0, 0.5), (8.0, 8.0, 8.0))
    first, *others = small_geometry().shapes
    _, lost = trees(small_geometry(shapes=(replace(first, interior=milk), *others)))
    assert any("media absorb light and do not scatter it" in line for line in lost)


def test_metals_reflect_at_normal_incidence_as_in_mitsuba(mi):
    (tree,), _ = trees(
        small_geometry(
            materials=(Conductor(material="Cu", specular_reflectance=0.5),),
            shapes=(replace(small_geometry().shapes[2], material=0, radiance=None),),
            **NOTHING,
        )
    )  # fmt: skip
    bsdf = mi.load_dict({"type": "conductor", "material": "Cu", "specular_reflectance": 0.5})
    import drjit as dr

    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi = mi.Vector3f(0, 0, 1)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5))
    np.testing.assert_allclose(tree["inputs"]["Color"], np.array(weight).ravel(), rtol=1e-3)


@pytest.mark.parametrize(
    ("signs", "share"), [([1, 1], 0.0), ([-1, -1], 1.0), ([-1, 1], 0.5)], ids=str
)
def test_normal_maps_are_turned_round_where_coordinates_are_mirrored(signs, share):
    """Two quads side by side, whose u runs along x or against it; v points down."""
    quad = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    uv = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    normal_map = NormalMap(normalmap=TEXTURE, nested=(DIFFUSE,))
    shape = MeshShape(material=0, vertices=8, faces=4, texcoords=True)
    geometry = small_geometry(
        materials=(normal_map,),
        shapes=(shape,),
        vertices=np.concatenate([quad, quad + np.array([1, 0, 0])]).astype(np.float32),
        texcoords=np.concatenate([uv * [sign, 1] for sign in signs]).astype(np.float32),
        faces=np.concatenate([faces, faces + 4]).astype(np.uint32),
        normals=np.zeros((0, 3), np.float32),
        colours=np.zeros((0, 3), np.float32),
    )
    (mesh,) = geometry_meshes(geometry, np.eye(4))
    assert mirrored_share(mesh) == pytest.approx(share)
    (tree,), lost = trees(geometry)
    (normals,) = (each for each in nodes_of(tree) if each["node"] == "ShaderNodeNormalMap")
    turned = normals["inputs"]["Color"]["node"] == "ShaderNodeVectorMath"
    assert turned == (share > 0.5)
    assert (LOST_MIRRORED in lost) == (0 < share < 1)


def test_coordinates_of_a_texture_are_mapped():
    from lumitree.exports.blender_nodes import texture

    matrix = np.eye(4)
    matrix[:2, [0, 1, 3]] = [[1, 2, 3], [4, 5, 6]]
    tree = texture(replace(TEXTURE, to_uv=rows_of(matrix)))
    vector = tree["inputs"]["Vector"]
    rows = [vector["inputs"][axis]["inputs"][1] for axis in (0, 1)]
    # From 1 - v to 1 - v'.
    assert rows == [[1, -2, 5], [-4, 5, -10]]
    assert vector["inputs"][0]["inputs"][0]["inputs"][1] == [0, 0, 1]


@pytest.mark.parametrize(
    ("kind", "area"),
    [("sphere", 4 * np.pi), ("disk", np.pi), ("cylinder", 2 * np.pi), ("rectangle", 4)],
)
@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("mirrored", [1, -1])
def test_analytic_shapes_become_meshes_whose_faces_turn_as_the_normals(
    kind, area, flipped, mirrored
):
    from lumitree.exports.surfaces import geometry_meshes

    matrix = np.diag([2.0, 2, 2 * mirrored, 1])
    matrix[:3, 3] = [0.1, 0.2, 0.3]
    shape = UnitShape(type=kind, to_world=rows_of(matrix), material=0, flipped=flipped)
    (mesh,) = geometry_meshes(
        small_geometry(
            shapes=(shape,), materials=(DIFFUSE,),
            **NOTHING,
        ),
        np.eye(4),
    )  # fmt: skip
    corners = mesh["vertices"][mesh["faces"]].astype(np.float64)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(cross, axis=1).sum() / 2 == pytest.approx(4 * area, rel=5e-3)
    normals = mesh["normals"][mesh["faces"]].sum(axis=1)
    assert ((cross * normals).sum(axis=1) > 0).all()
    if kind == "sphere":
        outwards = ((corners.mean(axis=1) - matrix[:3, 3]) * cross).sum(axis=1) > 0
        assert (outwards != flipped).all()


def test_meshes_are_turned_to_the_frame_of_blender():
    from lumitree.exports.surfaces import geometry_meshes

    geometry = small_geometry()
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    mesh = geometry_meshes(geometry, similarity(turn))[0]
    x, y, z = geometry.vertices[:4].T
    np.testing.assert_array_equal(mesh["vertices"], np.stack([x, -z, y], axis=-1))
    assert np.array_equal(mesh["faces"], geometry.faces[:4])
    assert {"normals", "texcoords", "colours"} <= set(mesh)
