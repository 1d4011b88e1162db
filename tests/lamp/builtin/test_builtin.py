"""The built-in lamps: closed glass, clear of everything, deterministic, and energy-preserving."""

import numpy as np
import pytest
import trimesh

from lumitree.asset.materials import Dielectric, RoughDielectric
from lumitree.core.device import on_device
from lumitree.core.mitsuba_meshes import make_mesh
from lumitree.errors import LumitreeError
from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.meshes import frames, join, lathe, moved, offset
from lumitree.lamp.read_source import scene_path
from lumitree.lamp.scene_writer import write_scene
from lumitree.lamp.source import as_source
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.trace.cameras import capture
from support.slow import slow_but


@pytest.fixture(scope="module")
def models():
    return {name: builtin.build() for name, builtin in BUILTIN.items()}


def solid(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def agreement(mesh):
    """Cosine [F] between each face's own normal and the mean of its vertices' normals."""
    shading = mesh.normals[mesh.faces].mean(axis=1)
    shading /= np.linalg.norm(shading, axis=1, keepdims=True)
    return (solid(mesh).face_normals * shading).sum(axis=1)


def test_lathe_and_offset_make_a_sphere():
    angle = np.linspace(-np.pi / 2, np.pi / 2, 65)
    profile = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    sphere, inner = lathe(profile, 128), lathe(offset(profile, 0.25), 128)
    assert solid(sphere).is_watertight
    assert solid(sphere).volume == pytest.approx(4 / 3 * np.pi, rel=2e-3)
    assert solid(inner).volume == pytest.approx(4 / 3 * np.pi * 0.75**3, rel=2e-3)
    np.testing.assert_allclose(sphere.normals, sphere.vertices, atol=1e-9)
    assert solid(lathe(profile[::-1], 128)).volume < 0


def test_lathe_keeps_sharp_corners_hard():
    can = lathe([[0, 0], [1, 0], [1, 2], [0, 2]], 64)
    np.testing.assert_allclose(np.abs(can.normals[:, 1]).round(12) % 1, 0)
    assert trimesh.Trimesh(can.vertices, can.faces).volume == pytest.approx(2 * np.pi, rel=2e-3)


def test_frames_are_orthonormal_and_do_not_twist():
    t = np.linspace(0, 4, 400)
    path = np.stack([np.cos(t), np.sin(t), 0.3 * t], axis=1)
    tangent, side, up = frames(path)
    matrices = np.stack([tangent, side, up], axis=-1)
    identity = np.broadcast_to(np.eye(3), matrices.shape)
    np.testing.assert_allclose(matrices.transpose(0, 2, 1) @ matrices, identity, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(matrices), 1, atol=1e-6)
    turning = (np.gradient(side, t, axis=0) * up).sum(axis=1)[2:-2]
    np.testing.assert_allclose(turning, 0, atol=1e-3)


@pytest.mark.parametrize("name", BUILTIN)
def test_everything_is_closed_and_faces_outwards(models, name):
    surfaces = {material.name: material.surface for material in models[name].materials}
    for part in models[name].parts:
        np.testing.assert_allclose(np.linalg.norm(part.mesh.normals, axis=1), 1, atol=1e-9)
        assert agreement(part.mesh).min() > 0.3, part.name
        if not getattr(surfaces[part.material], "thin", False):
            # Hard edges have two vertices in one place: merge those before asking.
            merged = trimesh.Trimesh(part.mesh.vertices.round(9), part.mesh.faces)
            assert merged.is_watertight, part.name
            assert merged.volume > 0, part.name


@pytest.mark.parametrize("name", slow_but(["bulbs"], BUILTIN))
def test_output_is_the_same_byte_for_byte(name, tmp_path):
    def files(folder):
        write_scene(BUILTIN[name].build(), folder)
        paths = [path for path in folder.rglob("*") if path.is_file()]
        return {path.relative_to(folder): path.read_bytes() for path in paths}

    assert files(tmp_path / "first") == files(tmp_path / "second")


# Emitters, and the sides of the bounding box, metres.
LAMPS = {
    "bulbs": (5, [0.302, 0.327, 0.313]),
    "dallas": (8, [0.651, 0.596, 0.651]),
    "cluster": (13, [0.339, 0.556, 0.377]),
    "neoclassical": (18, [0.820, 0.948, 0.820]),
    "portica": (7, [0.411, 0.83, 0.359]),
    "star": (26, [0.624, 0.752, 0.624]),
    "arc": (1, [1.540, 2.050, 0.380]),
}


@pytest.mark.parametrize("name", slow_but(["bulbs", "cluster", "arc"], LAMPS))
def test_its_figures_are_those_of_its_scene(mi, models, name):
    lamp, found = load_luminaire(name), BUILTIN[name].figures()
    assert (lamp.num_emitters, lamp.size.tolist()) == (
        LAMPS[name][0],
        pytest.approx(LAMPS[name][1], abs=2e-3),
    )
    assert (found["triangles"], found["emitters"]) == (lamp.num_triangles, lamp.num_emitters)
    assert found["size"] == pytest.approx(lamp.size, rel=1e-4)
    assert found["has_media"] == lamp.has_media == (name in ("cluster", "star"))
    # Where it meets the ceiling, or the floor.
    box = lamp.scene.bbox()
    assert (box.min if name == "arc" else box.max)[1] == pytest.approx(0, abs=1e-6)
    geometry = stored_geometry(lamp)
    scatters = any(shape.scatters for shape in geometry.shapes)
    assert (geometry.has_media, scatters) == (lamp.has_media, lamp.scatters)


@pytest.mark.parametrize("name", slow_but(["bulbs", "cluster"], BUILTIN))
def test_tiny_capture(mi, name, tmp_path):
    dataset = capture(load_luminaire(name), tmp_path, views=2, resolution=16, spp=32)
    views = list(dataset.views())
    assert max(view.radiance.max() for view in views) > 0
    for view in views:
        assert 0 < view.straight_through.mean() <= view.geometric.mean() < 1


def test_unknown_name_is_told_the_known_ones():
    with pytest.raises(LumitreeError, match=r"'chandelier'.*bulbs"):
        scene_path(as_source("chandelier"))


CLEARANCE = 2e-4  # metres


def is_glass(model, part):
    return isinstance(model.material(part).surface, Dielectric | RoughDielectric)


def standing(parts):
    """All copies of the parts where they stand, as one mesh."""
    return join(moved(part.mesh, place) for part in parts for place in part.places)


def load(mi, mesh):
    shape = make_mesh("mesh", {"vertices": mesh.vertices, "faces": mesh.faces})
    return mi.load_dict({"type": "scene", "mesh": shape})


def crossed(mi, scene, mesh):
    """Number of the mesh's edges that cut the scene's surface."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    start, end = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]]
    length = np.linalg.norm(end - start, axis=1)
    start, end, length = start[length > 0], end[length > 0], length[length > 0]
    direction = on_device(mi.Vector3f, (end - start) / length[:, None])
    ray = mi.Ray3f(on_device(mi.Point3f, start), direction)
    ray.maxt = on_device(mi.Float, length)
    return np.count_nonzero(np.array(scene.ray_test(ray)))


def inside(mi, scene, points):
    """Number of points within the scene's solids: the next surface is left, not entered."""
    direction = mi.Vector3f(0.267, 0.802, 0.535)
    si = scene.ray_intersect(mi.Ray3f(on_device(mi.Point3f, points), direction))
    leaving = np.array(si.n.x * 0.267 + si.n.y * 0.802 + si.n.z * 0.535) > 0
    return np.count_nonzero(leaving & np.array(si.is_valid()))


def centroids(mesh):
    return mesh.vertices[mesh.faces].mean(axis=1)


@pytest.mark.parametrize("name", slow_but(["bulbs", "cluster"], BUILTIN))
def test_nothing_cuts_the_glass_or_lies_in_it(mi, models, name):
    model = models[name]
    glass = standing([part for part in model.parts if is_glass(model, part)])
    others = standing([part for part in model.parts if not is_glass(model, part)])
    glass_scene, others_scene = load(mi, glass), load(mi, others)
    assert crossed(mi, glass_scene, others) == 0
    assert crossed(mi, others_scene, glass) == 0
    assert inside(mi, glass_scene, centroids(others)) == 0
    # Just outside its surface there is no other glass either.
    corners = glass.vertices[glass.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert inside(mi, glass_scene, centroids(glass) + CLEARANCE * normal) == 0
    assert inside(mi, glass_scene, centroids(glass) - CLEARANCE / 10 * normal) > 0
