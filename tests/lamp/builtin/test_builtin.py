"""The built-in lamps: closed glass, clear of everything, deterministic, and energy-preserving."""

import dataclasses

import numpy as np
import pytest
import trimesh

from lumitree.asset.geometry_media import scattering_sides
from lumitree.core.device import on_device
from lumitree.errors import LumitreeError
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.loading import load_luminaire
from lumitree.lamp.meshes import coil, frames, lathe, offset, smooth, sweep
from lumitree.lamp.opening import scene_path
from lumitree.lamp.parts import Glass
from lumitree.lamp.scene_writer import SCENE_FILE, write_scene
from lumitree.lamp.source import as_source
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.trace.capture import capture
from lumitree.trace.tracing import PATH_DEPTH
from support.slow import slow_but


@pytest.fixture(scope="module")
def models():
    return {name: builtin.build() for name, builtin in BUILTIN.items()}


@pytest.fixture(scope="module")
def parts(models):
    return {part.name: part for part in models["bulbs"].parts}


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


def test_sweep_is_a_closed_tube():
    path = smooth([[0, 0, 0], [2, 0, 0], [2, 3, 0], [5, 3, 1]])
    tube = sweep(path, 0.1, 32)
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert solid(tube).is_watertight
    assert solid(tube).volume == pytest.approx(np.pi * 0.01 * length, rel=0.03)


def test_coil_winds_at_its_radius():
    points = coil([[0, 0, 0], [0, 10, 0]], radius=0.5, pitch=1.0, samples=32)
    middle = points[40:-40]
    np.testing.assert_allclose(np.hypot(middle[:, 0], middle[:, 2]), 0.5, atol=1e-9)
    turns = np.unwrap(np.arctan2(middle[:, 0], middle[:, 2])) / (2 * np.pi)
    assert abs(np.ptp(turns)) == pytest.approx(np.ptp(middle[:, 1]), rel=1e-6)


def test_glass_is_closed_walls_of_positive_volume(parts):
    glass = solid(parts["bulb_glass"].mesh)
    assert glass.is_watertight
    assert glass.is_winding_consistent
    volumes = sorted(piece.volume for piece in glass.split(only_watertight=True, repair=False))
    assert len(volumes) == 3
    cavity, stem, outside = volumes
    assert cavity < 0 < stem < -cavity < outside
    assert glass.volume == pytest.approx(sum(volumes))


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


@pytest.mark.parametrize("name", ["arc", "bulbs", "dallas", "cluster"])
def test_nothing_touches_the_bulb_glass(models, name):
    """Exact distance to the turned glass, in the plane of its profile."""

    def meridian(points):
        return np.stack([np.hypot(points[..., 0], points[..., 2]), points[..., 1]], axis=-1)

    parts = {part.name: part for part in models[name].parts}
    bulb = "clear" if name == "cluster" else "bulb"
    glass = parts[f"{bulb}_glass"].mesh
    edges = np.concatenate([glass.faces[:, [0, 1]], glass.faces[:, [1, 2]], glass.faces[:, [2, 0]]])
    edges = meridian(glass.vertices[edges]).round(7)
    edges = np.unique(edges[np.ptp(edges, axis=1).max(axis=1) > 0], axis=0)
    start, step = edges[:, 0], edges[:, 1] - edges[:, 0]
    for other in ("socket", f"{bulb}_cap", f"{bulb}_supports", f"{bulb}_filament"):
        mesh = parts[other].mesh
        points = meridian(mesh.vertices[mesh.faces].mean(axis=1))[:, None]
        along = ((points - start) * step).sum(-1) / (step * step).sum(-1)
        nearest = start + np.clip(along, 0, 1)[..., None] * step
        assert np.linalg.norm(points - nearest, axis=-1).min() > 3e-4, other


@pytest.mark.parametrize("name", BUILTIN)
def test_number_of_triangles(models, name):
    total = sum(len(part.mesh.faces) * len(part.places) for part in models[name].parts)
    low, high = (30_000, 120_000) if name == "bulbs" else (20_000, 300_000)
    assert low <= total <= high


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


@pytest.mark.parametrize(
    ("name", "radiance"),
    [
        ("dallas", 20),
        ("cluster", 40),
        ("neoclassical", 24),
        ("portica", 22),
        ("star", 10),
        ("arc", 150),
    ],
)
def test_emitted_radiance_is_warm(models, name, radiance):
    emitting = [material for material in models[name].materials if material.radiance is not None]
    assert len(emitting) == 1
    red, green, blue = emitting[0].radiance
    assert red == radiance
    assert red > green > blue > 0


def test_media_are_where_they_are_promised(models):
    media = {
        name: [
            material.surface.medium
            for material in model.materials
            if isinstance(material.surface, Glass) and material.surface.medium is not None
        ]
        for name, model in models.items()
    }
    assert {name for name, found in media.items() if found} == {"cluster", "star"}
    for medium in media["cluster"]:
        assert min(medium.absorption) > 0
        assert max(medium.scattering) == 0
    assert max(media["star"][0].absorption) == 0
    assert min(media["star"][0].scattering) > 0


@pytest.mark.parametrize("name", slow_but(["bulbs", "cluster"], BUILTIN))
def test_tiny_capture(mi, name, tmp_path):
    lamp = load_luminaire(name)
    assert lamp.has_media == (name in ("cluster", "star"))
    model = stored_geometry(lamp)
    assert (model.has_media, any(map(scattering_sides, model.shapes))) == (
        lamp.has_media,
        lamp.scatters,
    )
    dataset = capture(lamp, tmp_path, num_views=2, resolution=16, samples_per_pixel=32)
    views = list(dataset.views())
    assert max(view.radiance.max() for view in views) > 0
    for view in views:
        assert 0 < view.straight_through.mean() <= view.geometric.mean() < 1


def test_star_is_seen_at_radiance_of_about_four_and_a_half(mi):
    """Its emitters are hidden: what counts is the wall where it is brightest, in 5 mm pixels."""
    view = mi.ScalarTransform4f().look_at([0.2, -0.04, 0.47], [0.1, -0.34, 0], [0, 1, 0])
    sensor = mi.load_dict(
        {
            "type": "orthographic",
            "to_world": view @ mi.ScalarTransform4f().scale([0.06, 0.06, 1]),
            "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
        }
    )
    integrator = mi.load_dict({"type": "volpath", "max_depth": PATH_DEPTH})
    scene = load_luminaire("star").scene
    radiance = np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=256))
    assert np.percentile(radiance.max(axis=-1), 99) == pytest.approx(4.5, rel=0.15)


def test_the_arc_lamp_is_stored_and_leaves_its_box_empty(mi):
    lamp = load_luminaire("arc")
    assert stored_geometry(lamp).shapes
    x, y, z = np.random.default_rng(0).uniform(-1, 1, (3, 4096)) * lamp.frame.half_extents[:, None]
    points = np.stack([x, y, z], axis=1) * lamp.frame.scale + lamp.frame.centre
    scene = lamp.scene
    near = np.array(scene.ray_intersect(mi.Ray3f(on_device(mi.Point3f, points), [0, 0, 1])).t)
    near = np.minimum(
        near, np.array(scene.ray_intersect(mi.Ray3f(on_device(mi.Point3f, points), [0, 0, -1])).t)
    )
    assert np.isinf(near).mean() > 0.9


def test_unknown_name_is_told_the_known_ones():
    with pytest.raises(LumitreeError, match=r"'chandelier'.*bulbs"):
        scene_path(as_source("chandelier"))


def test_builtins_are_frozen_and_described():
    for name, builtin in BUILTIN.items():
        assert name == builtin.name
        assert builtin.description
        assert (
            name in ("bulbs", "arc")
            or f"stand-in for the paper's {name.title()}" in builtin.description
        )
        with pytest.raises(dataclasses.FrozenInstanceError):
            builtin.name = "other"
