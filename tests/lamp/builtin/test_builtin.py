"""The built-in lamps: closed glass, clear of everything, deterministic, and energy-preserving."""

import numpy as np
import pytest
import trimesh

from lumitree.errors import LumitreeError
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.loading import load_luminaire
from lumitree.lamp.meshes import frames, lathe, offset
from lumitree.lamp.opening import scene_path
from lumitree.lamp.scene_writer import SCENE_FILE, write_scene
from lumitree.lamp.source import as_source
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.trace.cameras import capture
from support.slow import slow_but


@pytest.fixture(scope="module")
def models():
    return {name: builtin.build() for name, builtin in BUILTIN.items()}


@pytest.fixture(scope="module")
def folders(models, tmp_path_factory):
    return {
        name: write_scene(model, tmp_path_factory.mktemp(name)).parent
        for name, model in models.items()
    }


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


@pytest.mark.parametrize("name", BUILTIN)
def test_output_is_the_same_byte_for_byte(folders, name, tmp_path):
    write_scene(BUILTIN[name].build(), tmp_path)
    names = sorted(path.relative_to(folders[name]) for path in files(folders[name]))
    assert names == sorted(path.relative_to(tmp_path) for path in files(tmp_path))
    assert SCENE_FILE in {path.as_posix() for path in names}
    for file in names:
        assert (folders[name] / file).read_bytes() == (tmp_path / file).read_bytes(), file


def files(folder):
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.mark.parametrize(
    ("name", "emitters", "extents"),
    [
        ("bulbs", 5, [None, 0.327, None]),
        ("dallas", 8, [0.651, 0.596, 0.651]),
        ("cluster", 13, [0.339, 0.556, 0.377]),
        ("neoclassical", 18, [0.820, 0.948, 0.820]),
        ("portica", 7, [0.411, 0.83, 0.359]),
        ("star", 26, [0.624, 0.752, 0.624]),
        ("arc", 1, [1.540, 2.050, 0.380]),
    ],
)
def test_scene_loads(mi, folders, name, emitters, extents):
    scene = mi.load_file(str(folders[name] / SCENE_FILE))
    assert len(scene.emitters()) == emitters
    assert not scene.sensors()
    for axis, extent in enumerate(extents):
        if extent is not None:
            assert scene.bbox().extents()[axis] == pytest.approx(extent, abs=2e-3)
    # Where it meets the ceiling, or the floor.
    origin = scene.bbox().min if name == "arc" else scene.bbox().max
    assert origin[1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("name", slow_but(["bulbs", "cluster"], BUILTIN))
def test_tiny_capture(mi, name, tmp_path):
    lamp = load_luminaire(name)
    assert lamp.has_media == (name in ("cluster", "star"))
    model = stored_geometry(lamp)
    assert (model.has_media, any(shape.scatters for shape in model.shapes)) == (
        lamp.has_media,
        lamp.scatters,
    )
    dataset = capture(lamp, tmp_path, views=2, resolution=16, spp=32)
    views = list(dataset.views())
    assert max(view.radiance.max() for view in views) > 0
    for view in views:
        assert 0 < view.straight_through.mean() <= view.geometric.mean() < 1


def test_unknown_name_is_told_the_known_ones():
    with pytest.raises(LumitreeError, match=r"'chandelier'.*bulbs"):
        scene_path(as_source("chandelier"))
