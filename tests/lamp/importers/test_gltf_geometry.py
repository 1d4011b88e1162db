"""Nodes, meshes, instances, closed bodies and lights."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from lumitree.asset.materials import Dielectric, VertexColours
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp import parts as model_module
from lumitree.lamp.importers.gltf import oriented_outwards, read_gltf
from lumitree.lamp.importers.gltf_lights import LIGHT_RADIUS
from lumitree.lamp.luminaire import load_luminaire
from support.gltf_builder import QUAD, QUAD_FACES, QUAD_UV, Gltf, box, sphere
from support.gltf_models import instanced, lit

CLEAR = {
    "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 0},
    "extensions": {
        "KHR_materials_transmission": {"transmissionFactor": 1},
        "KHR_materials_volume": {"thicknessFactor": 0.1},
    },
}


def only(path, **options):
    (part,) = read_gltf(path, **options).parts
    return part


def world_mesh(part, place=0):
    """Vertices, normals and geometric face normals of a part in the world."""
    world = part.places[place]
    vertices = part.mesh.vertices @ world[:3, :3].T + world[:3, 3]
    normals = part.mesh.normals @ np.linalg.inv(world[:3, :3])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return vertices, normals, trimesh.Trimesh(vertices, part.mesh.faces, process=False)


def affine(linear=None, translation=(0, 0, 0)):
    matrix = np.eye(4)
    matrix[:3, :3] = np.eye(3) if linear is None else linear
    matrix[:3, 3] = translation
    return matrix


# Without normals every face has vertices of its own.
CORNERS = QUAD[QUAD_FACES.ravel()]
ROTATION = Rotation.from_euler("xyz", [0.3, -0.7, 1.1])
LINEAR = {
    "identity": np.eye(3),
    "similarity": 2.5 * ROTATION.as_matrix(),
    "stretched": ROTATION.as_matrix() @ np.diag([1, 2, 0.5]),
    "mirrored": ROTATION.as_matrix() @ np.diag([-1, 1, 1]),
    "point_mirror": -3.0 * np.eye(3),
    "sheared": np.array([[1, 0.7, 0], [0, 1, 0], [0.2, 0, 1.0]]),
}


@pytest.mark.parametrize("name", LINEAR)
def test_matrices_move_vertices_normals_and_windings(tmp_path, name):
    gltf = Gltf()
    matrix = affine(LINEAR[name], (1, 2, 3))
    gltf.sphere(segments=24, matrix=matrix.T.ravel().tolist())
    part = only(gltf.save(tmp_path))
    vertices, normals, solid = world_mesh(part)
    source = sphere(1.0, 24)
    expected = source.vertices @ LINEAR[name].T + (1, 2, 3)
    assert trimesh.Trimesh(vertices, part.mesh.faces).volume == pytest.approx(
        abs(np.linalg.det(LINEAR[name])) * trimesh.Trimesh(source.vertices, source.faces).volume
    )
    np.testing.assert_allclose(vertices, expected, atol=1e-5)
    # The true normals of an ellipsoid |A⁻¹ x| = 1.
    unit = (vertices - (1, 2, 3)) @ np.linalg.inv(LINEAR[name]).T @ np.linalg.inv(LINEAR[name])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    np.testing.assert_allclose(normals, unit, atol=1e-4)
    shading = normals[part.mesh.faces].mean(axis=1)
    assert (shading * solid.face_normals).sum(axis=1).min() > 0.5
    is_similarity = name in ("identity", "similarity")
    assert np.array_equal(part.places[0], np.eye(4)) != is_similarity


def test_children_follow_their_parents(tmp_path):
    gltf = Gltf()
    gltf.quad(translation=[1, 0, 0])
    turn = Rotation.from_euler("z", 90, degrees=True).as_quat().tolist()
    gltf.add("nodes", children=[0], rotation=turn)
    gltf.add("nodes", children=[1], scale=[2, 2, 2])
    gltf.json["scenes"][0]["nodes"] = [2]
    vertices, _, _ = world_mesh(only(gltf.save(tmp_path)))
    expected = 2 * np.stack([-CORNERS[:, 1], CORNERS[:, 0] + 1, CORNERS[:, 2]], axis=1)
    np.testing.assert_allclose(vertices, expected, atol=1e-6)


def test_copies_share_a_part_where_they_can(tmp_path):
    gltf = Gltf()
    gltf.quad(name="sheet")
    for fields in ({"translation": [5, 0, 0]}, {"scale": [2, 2, 2]}, {"scale": [1, 1, 4]}):
        gltf.node(mesh=0, **fields)
    parts = read_gltf(gltf.save(tmp_path)).parts
    assert sorted(len(part.places) for part in parts) == [1, 1, 2]
    assert len({id(part.mesh) for part in parts}) == 3
    shared = next(part for part in parts if len(part.places) == 2)
    np.testing.assert_allclose([place[0, 3] for place in shared.places], [0, 5])


def test_the_default_scene_is_read(tmp_path):
    gltf = Gltf()
    gltf.quad(name="first")
    gltf.quad(name="second")
    gltf.json["scenes"] = [{"nodes": [0]}, {"nodes": [1]}]
    gltf.json["scene"] = 1
    with pytest.warns(LumitreeWarning, match="scenes other than the default"):
        assert only(gltf.save(tmp_path)).name == "second"
    del gltf.json["scene"]
    with pytest.warns(LumitreeWarning, match="scenes other than the default"):
        assert only(gltf.save(tmp_path)).name == "first"
    del gltf.json["scenes"]
    assert len(read_gltf(gltf.save(tmp_path)).parts) == 2


@pytest.mark.parametrize(("mode", "order"), [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])])
def test_strips_and_fans(tmp_path, mode, order):
    gltf = Gltf()
    gltf.node(gltf.primitive(QUAD, np.array(order, np.uint8)) | {"mode": mode})
    part = only(gltf.save(tmp_path))
    _, _, solid = world_mesh(part)
    assert solid.area == pytest.approx(4)
    np.testing.assert_allclose(solid.face_normals, [[0, 0, 1]] * 2)


def test_triangles_without_indices_and_normals_are_flat(tmp_path):
    vertices, faces = box((0, 0, 0), (1, 2, 3))
    for arguments in ((vertices[faces].reshape(-1, 3),), (vertices, faces)):
        gltf = Gltf()
        gltf.node(gltf.primitive(*arguments))
        part = only(gltf.save(tmp_path))
        assert len(part.mesh.vertices) == 36
        expected = trimesh.Trimesh(vertices, faces, process=False).face_normals
        np.testing.assert_allclose(part.mesh.normals, np.repeat(expected, 3, axis=0), atol=1e-6)


def test_normals_are_made_unit_and_missing_ones_filled(tmp_path):
    normals = np.array([[0, 0, 3], [0, 0, 0], [0, 1, 1], [0, 0, 1]], np.float32)
    gltf = Gltf()
    gltf.node(gltf.primitive(QUAD, QUAD_FACES, NORMAL=normals))
    found = only(gltf.save(tmp_path)).mesh.normals
    expected = [[0, 0, 1], [0, 0, 1], [0, np.sqrt(0.5), np.sqrt(0.5)], [0, 0, 1]]
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_sparse_positions(tmp_path):
    gltf = Gltf()
    at = {"bufferView": gltf.view(np.array([2], np.uint8).tobytes()), "componentType": 5121}
    new = {"bufferView": gltf.view(np.array([[7, 8, 9]], np.float32).tobytes())}
    sparse = {"count": 1, "indices": at, "values": new}
    gltf.node(gltf.primitive(QUAD, QUAD_FACES))
    gltf.json["accessors"][0]["sparse"] = sparse
    expected = QUAD.copy()
    expected[2] = (7, 8, 9)
    found = only(gltf.save(tmp_path)).mesh.vertices
    np.testing.assert_array_equal(found, expected[QUAD_FACES.ravel()])


@pytest.mark.parametrize(("dtype", "largest"), [(np.uint8, 255), (np.uint16, 65535)])
def test_normalised_texture_coordinates_and_colours(tmp_path, dtype, largest):
    gltf = Gltf()
    uv = gltf.accessor((QUAD_UV * largest).astype(dtype), normalized=True)
    colours = np.array([[0, 0.2, 0.4, 1]] * 4) * largest
    colour = gltf.accessor(colours.astype(dtype), normalized=True)
    primitive = gltf.primitive(QUAD, QUAD_FACES, TEXCOORD_0=uv, COLOR_0=colour)
    gltf.node(primitive)
    model = read_gltf(gltf.save(tmp_path))
    np.testing.assert_allclose(model.parts[0].mesh.uv, QUAD_UV[QUAD_FACES.ravel()], atol=1e-6)
    np.testing.assert_allclose(model.parts[0].mesh.colours, [[0, 0.2, 0.4]] * 6, atol=1e-6)
    assert isinstance(model.materials[0].surface.base_color, VertexColours)


def test_quantised_positions(tmp_path):
    gltf = Gltf()
    gltf.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    packed = gltf.accessor((QUAD * 127).astype(np.int8), normalized=True)
    primitive = gltf.primitive(QUAD, QUAD_FACES)
    gltf.node({"attributes": {"POSITION": packed}, "indices": primitive["indices"]})
    np.testing.assert_allclose(np.unique(only(gltf.save(tmp_path)).mesh.vertices), [-1, 0, 1])


def test_interleaved_attributes(tmp_path):
    gltf = Gltf()
    record = np.concatenate([QUAD, QUAD_UV], axis=1).astype(np.float32)
    view = gltf.view(record.tobytes(), byteStride=20)
    fields = {"bufferView": view, "componentType": 5126, "count": 4}
    position = gltf.add("accessors", type="VEC3", **fields)
    uv = gltf.add("accessors", type="VEC2", byteOffset=12, **fields)
    indices = gltf.accessor(QUAD_FACES.ravel())
    gltf.node({"attributes": {"POSITION": position, "TEXCOORD_0": uv}, "indices": indices})
    mesh = only(gltf.save(tmp_path)).mesh
    np.testing.assert_allclose(mesh.uv[:, 0], (mesh.vertices[:, 0] + 1) / 2)


def joined(*meshes):
    from lumitree.lamp.meshes import join

    return join(meshes)


def body(radius, centre, inverted):
    mesh = sphere(radius, 16)
    faces = mesh.faces[:, ::-1] if inverted else mesh.faces
    normals = -mesh.normals if inverted else mesh.normals
    return type(mesh)(mesh.vertices + centre, normals, faces)


def volumes(mesh):
    pieces = trimesh.Trimesh(mesh.vertices, mesh.faces).split(only_watertight=False, repair=False)
    return sorted(round(float(np.sign(piece.volume) * abs(piece.volume) ** (1 / 3)), 2)
                  for piece in pieces)  # fmt: skip


@pytest.mark.parametrize("inverted", [False, True])
def test_walls_of_a_hollow_body_keep_their_sides(inverted):
    """A hollow bulb with a bead in a corner of its box, all inside out or not."""
    right = joined(body(1, 0, False), body(0.8, 0, True), body(0.1, 0.9, False))
    mesh = joined(body(1, 0, inverted), body(0.8, 0, not inverted), body(0.1, 0.9, inverted))
    fixed = oriented_outwards(mesh, "lamp")
    assert volumes(fixed) == volumes(right)
    np.testing.assert_allclose(fixed.normals, right.normals, atol=1e-12)


@pytest.mark.parametrize("inside_out", [False, True])
def test_glass_bodies_face_outwards(tmp_path, inside_out):
    gltf = Gltf()
    gltf.sphere(gltf.material(**CLEAR), inside_out=inside_out)
    model = read_gltf(gltf.save(tmp_path))
    mesh = model.parts[0].mesh
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).volume > 4
    np.testing.assert_allclose(mesh.normals, mesh.vertices, atol=1e-5)
    assert isinstance(model.materials[0].surface, Dielectric)


def test_point_lights_become_small_spheres(tmp_path):
    light = {"type": "point", "intensity": 100.0, "color": [1, 0.5, 0.25]}
    model = read_gltf(lit(light, translation=[1, 2, 3], scale=[9, 9, 9]).save(tmp_path))
    part = next(part for part in model.parts if part.name.startswith("light"))
    material = next(entry for entry in model.materials if entry.name == part.material)
    vertices, _, solid = world_mesh(part)
    np.testing.assert_allclose(np.linalg.norm(vertices - (1, 2, 3), axis=1), LIGHT_RADIUS)
    ideal = 100 / (np.pi * LIGHT_RADIUS**2) * np.array([1, 0.5, 0.25])
    np.testing.assert_allclose(np.array(material.radiance) * 683, ideal, rtol=0.02)
    # The flux of a light of I in all directions is 4π I; a Lambertian surface emits π L A.
    flux = 683 * np.pi * solid.area * np.array(material.radiance)
    np.testing.assert_allclose(flux, 4 * np.pi * 100 * np.array([1, 0.5, 0.25]), rtol=1e-6)


DOWN = Rotation.from_euler("x", -90, degrees=True).as_quat().tolist()


CONES = [
    (0, np.pi / 12),
    (0.25, np.pi / 12),
    (0, np.pi / 4),
    (0.3, 0.6),
    (0, np.pi / 2),
    (1.2, 1.5),
]


@pytest.mark.parametrize(("inner", "outer"), CONES)
def test_spot_lights_have_the_cone_of_the_file(mi, tmp_path, inner, outer):
    """Intensity by angle, and flux: the integral of KHR_lights_punctual's attenuation."""
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.lamp.scene_writer import write_scene
    from lumitree.trace.light_paths import trace_light

    spot = {"innerConeAngle": inner, "outerConeAngle": outer}
    light = {"type": "spot", "intensity": 50, "spot": spot}
    model = read_gltf(lit(light, rotation=DOWN, translation=[0, 0, 5]).save(tmp_path))
    parts = tuple(part for part in model.parts if part.name.startswith("light"))
    scene = write_scene(dataclasses.replace(model, parts=parts), tmp_path / "scene")
    lamp, count = load_luminaire(scene), 1 << 18
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    paths = trace_light(lamp, sampler, count, 8, all_light=True)
    flux = 683 * np.array(paths.flux, np.float64)[1] * lamp.frame.scale**2
    angle = np.arccos(np.clip(-np.array(paths.direction)[1], -1, 1))
    edges = np.linspace(0, outer, 6)
    found, number = np.histogram(angle, edges, weights=flux)[0], np.histogram(angle, edges)[0]
    fine = (np.arange(5000) + 0.5) / 5000 * outer
    scale, offset = 1 / (np.cos(inner) - np.cos(outer)), np.cos(outer)
    falloff = np.clip((np.cos(fine) - offset) * scale, 0, 1) ** 2
    expected = 50 * 2 * np.pi * (falloff * np.sin(fine) * outer / 5000).reshape(5, -1).sum(axis=1)
    error = expected / np.sqrt(np.maximum(number, 1))
    assert (np.abs(found - expected)[:-1] < 4 * error[:-1] + 0.01 * expected[:-1]).all()
    # The emitter has a size, so that the cone's edge is not sharp.
    assert flux.sum() == pytest.approx(expected.sum(), rel=0.003 + 4 / np.sqrt(number.sum()))
    assert flux[angle > 1.2 * outer + 0.02].sum() == 0


def test_instances_are_in_all_their_places(tmp_path):
    moved = np.array([[1, 0, 0], [2, 0, 0], [3, 5, 0]], np.float32)
    turns = Rotation.from_euler("xyz", [[0, 0, 0], [0.3, -0.7, 1.1], [0, 0, np.pi / 2]])
    scale = np.full((3, 3), [[1], [2], [3]], np.float32)
    quantised = np.round(turns.as_quat() * 32767).astype(np.int16)
    for rotation, within in ((turns.as_quat().astype(np.float32), 1e-6), (quantised, 1e-3)):
        made = instanced(True, TRANSLATION=moved, ROTATION=rotation, SCALE=scale)
        path = made.save(tmp_path)
        places = [place for part in read_gltf(path).parts for place in part.places]
        assert len(places) == 3
        places = sorted(places, key=lambda place: place[0, 3])
        for at, place in enumerate(places):
            linear = turns[at].as_matrix() * scale[at]
            expected = affine(translation=(0, 10, 0)) @ affine(linear, moved[at])
            np.testing.assert_allclose(place, expected, atol=3 * within)


def test_instances_may_lack_attributes(tmp_path):
    turned = np.array([[0, 0, 1, 1], [0, 0, 0, 2]], np.float32)
    part = only(instanced(ROTATION=turned).save(tmp_path))
    assert len(part.places) == 2
    np.testing.assert_allclose(part.places[0][:3, 0], [0, 1, 0], atol=1e-7)
    assert len(only(instanced().save(tmp_path)).places) == 1
    stretched = np.array([[1, 2, 3], [1, 1, 1]], np.float32)
    parts = read_gltf(instanced(SCALE=stretched).save(tmp_path)).parts
    assert sum(len(part.places) for part in parts) == 2


def test_instances_count_as_shapes(tmp_path, monkeypatch):
    three = np.zeros((3, 3), np.float32)
    with pytest.warns(LumitreeWarning, match="attributes of instances _ID"):
        read_gltf(instanced(TRANSLATION=three, _ID=np.zeros(3, np.float32)).save(tmp_path))
    monkeypatch.setattr(model_module, "MAX_SHAPES", 2)
    with pytest.raises(LumitreeError, match="3 shapes; at most 2"):
        read_gltf(instanced(TRANSLATION=three).save(tmp_path))


def test_lights_that_do_not_emit_leave_no_part(tmp_path):
    with pytest.warns(LumitreeWarning, match="directional light"):
        assert len(read_gltf(lit({"type": "directional"}).save(tmp_path)).parts) == 1
    dark = {"type": "point", "intensity": 0}
    assert len(read_gltf(lit(dark).save(tmp_path)).parts) == 1


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_lights_keep_their_size_in_models_of_another_unit(tmp_path, kind):
    """Their intensity is in cd, whatever the unit of the model; only their place is in it."""
    light = {"type": kind, "intensity": 100.0, "spot": {"outerConeAngle": 0.5}}
    path = lit(light, translation=[0, 300, 0]).save(tmp_path)
    (tmp_path / "lamp.toml").write_text('units = "cm"\nup = "z"\n')
    lamp = load_luminaire(path)
    balls = [shape for shape in lamp.scene.shapes() if shape.id().startswith("light")]
    lower, upper = (np.ravel(each) for each in (balls[-1].bbox().min, balls[-1].bbox().max))
    assert (upper + lower) / 2 == pytest.approx([0, 0, -3], abs=1e-4)
    assert upper - lower == pytest.approx(np.full(3, 2 * LIGHT_RADIUS), rel=0.01)


def test_skins_and_morph_targets_are_reported(tmp_path):
    gltf = Gltf()
    gltf.quad()
    gltf.json["nodes"][0]["skin"] = 0
    gltf.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 0}]
    with pytest.warns(LumitreeWarning, match=r"ignored: skins .*; morph targets"):
        read_gltf(gltf.save(tmp_path))
