"""Lamps whose files have them 4,200 km from the origin, as surveys do, are those at the origin."""

import numpy as np
import pytest

import lumitree
from lumitree.asset.file import load, save
from lumitree.core.frames import float32_step, is_far
from lumitree.errors import LumitreeWarning
from support import tiny_bakes
from support.geometry_assets import small_geometry, with_geometry
from support.gltf_builder import Gltf
from support.lamps import AREA, cube, scene, sphere
from support.slow import slow
from support.tiny_bakes import standard

FAR = (5e5, 4.2e6, 300.0)
KINDS = ("obj", "glb", "xml")
# A tent of two faces that emits, over a board that does not.
TENT = np.array([[0, 0.3, -0.2], [0, 0.3, 0.2], [-0.2, 0.1, 0], [0.2, 0.1, 0.05]])
TENT_FACES = np.array([[0, 2, 1], [0, 1, 3]])
BOARD = np.array([[-0.4, 0, -0.3], [-0.4, 0, 0.3], [0.4, 0, 0.3], [0.4, 0, -0.3]])
BOARD_FACES = np.array([[0, 1, 2], [0, 2, 3]])
ROOM = scene(
    '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
    '<sensor type="perspective"><transform name="to_world"><lookat origin="0,1,3" target="0,0,0" '
    'up="0,1,0"/></transform><film type="hdrfilm"><integer name="width" value="32"/>'
    '<integer name="height" value="32"/><rfilter type="box"/></film></sensor>'
    '<shape type="rectangle"><transform name="to_world"><scale value="3"/>'
    '<rotate x="1" angle="-90"/><translate y="-0.5"/></transform></shape>'
)


def write_obj(path, at):
    lines = [f"mtllib {path.stem}.mtl"]
    for first, name, vertices, faces in (
        (1, "light", TENT, TENT_FACES),
        (1 + len(TENT), "grey", BOARD, BOARD_FACES),
    ):
        lines += [f"o {name}", f"usemtl {name}"]
        lines += ["v " + " ".join(map(repr, vertex)) for vertex in (vertices + at).tolist()]
        lines += ["f " + " ".join(map(str, face)) for face in (faces + first).tolist()]
    path.write_text("\n".join(lines))
    path.with_suffix(".mtl").write_text("newmtl light\nKd 0 0 0\nKe 3 2 1\nnewmtl grey\nKd 1 1 1\n")


def write_glb(path, at):
    """Its vertices are float32 near the origin; its nodes are far."""
    gltf = Gltf()
    light = gltf.material(emissiveFactor=[1, 0.5, 0.2])
    for material, vertices, faces in (
        (light, TENT, TENT_FACES),
        (gltf.material(), BOARD, BOARD_FACES),
    ):
        primitive = gltf.primitive(np.float32(vertices), np.uint16(faces), material=material)
        gltf.node(primitive, translation=list(at))
    path.write_bytes(gltf.glb())


def write_xml(path, at):
    """Shapes that points, a transform, and both place."""
    x, y, z = at
    point = '<point name="{}" x="{!r}" y="{!r}" z="{!r}"/>'
    moved = f'<transform name="to_world"><translate x="{x!r}" y="{y!r}" z="{z!r}"/></transform>'
    path.write_text(
        scene(
            sphere("bulb", 0.1, at, AREA),
            f'<shape type="cylinder">{point.format("p0", x, y + 0.2, z)}'
            f'{point.format("p1", x, y + 0.25, z)}<float name="radius" value="0.3"/>'
            '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>',
            sphere("knob", 0.05, (0.3, 0, 0), moved),
        )
    )


WRITERS = {"obj": write_obj, "glb": write_glb, "xml": write_xml}


@pytest.fixture
def lamps(mi, tmp_path):
    """Files of one lamp by kind, at the origin and far from it."""

    def written(kind):
        paths = tmp_path / f"near.{kind}", tmp_path / f"far.{kind}"
        for path, at in zip(paths, ((0.0, 0.0, 0.0), FAR), strict=True):
            WRITERS[kind](path, at)
        return tuple(map(str, paths))

    return written


def leaving_flux(mi, luminaire, seed, count=1 << 16):
    """Mean and standard error [3] of the flux of light paths that leave, W."""
    from lumitree.trace.light_paths import trace_light

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    paths = trace_light(luminaire, sampler, count, 8, all_light=True)
    flux = np.zeros((count, 3))
    found = np.array(paths.flux).T * count * luminaire.frame.scale**2
    flux[: len(found)] = found
    return flux.mean(axis=0), flux.std(axis=0) / np.sqrt(count)


@pytest.mark.parametrize("kind", KINDS)
def test_a_far_lamp_has_the_size_and_the_flux_of_the_near_one(mi, lamps, kind):
    """Without this, the tent's flux is off by more than 10 %, or there is no lamp at all."""
    near, far = map(lumitree.load_luminaire, lamps(kind))
    assert not near.origin.any()
    assert np.allclose(far.size, near.size, rtol=1e-6)
    assert np.allclose(far.frame.centre, near.frame.centre + FAR, rtol=0, atol=1e-6)
    assert np.allclose(far.scene_frame.centre, 0, atol=0.5)
    mean, error = leaving_flux(mi, near, 1)
    other, other_error = leaving_flux(mi, far, 2)
    assert (mean > 0).all()
    assert (error < 0.01 * mean).all()
    assert (np.abs(other - mean) < 5 * np.hypot(error, other_error)).all()


def images(folder, *sources):
    """Radiance of a room with each source in the same place; equal seeds."""
    (folder / "room.xml").write_text(ROOM)
    return [
        lumitree.render(
            folder / "room.xml",
            [lumitree.Placement(source, at=(0, 0.2, 0))],
            spp=16,
        ).pixels
        for source in sources
    ]


def assert_similar(first, second):
    """A few paths may differ, where a comparison meets rounding."""
    assert first.mean() > 1e-6
    assert np.sqrt(((first - second) ** 2).mean()) < 0.05 * first.mean()


@pytest.mark.parametrize(
    ("kind", "parts"), [("xml", ("light", "geometry")), slow("obj", ("field",))]
)
def test_a_far_lamp_renders_as_the_near_one(mi, lamps, tmp_path, monkeypatch, kind, parts):
    tiny_bakes.set_qualities(monkeypatch.setattr, tree_depth=4, l_max=0, rays=1 << 14)
    near, far = (
        lumitree.bake(
            lamp,
            tmp_path / "lamp.lumitree",
            standard(parts=parts, irradiance_paths=0),
        ).asset
        for lamp in lamps(kind)
    )
    assert set(near.parts) == {"light", *parts}
    assert_similar(*images(tmp_path, near, far))
    if near.geometry is not None:
        assert np.abs(far.geometry.vertices).max(initial=0) < 1
        assert not any(near.geometry.origin)
        assert np.allclose(far.geometry.origin, FAR, atol=1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_far_explicit_lamp_renders_as_the_near_one(mi, lamps, tmp_path, kind):
    assert_similar(*images(tmp_path, *lamps(kind)))


def test_a_far_geometry_is_stored_with_its_origin(mi, tmp_path):
    frame = with_geometry(small_geometry()).frame.moved(FAR)
    asset = with_geometry(small_geometry(origin=FAR), frame)
    save(asset, tmp_path / "far.lumitree")
    assert load(tmp_path / "far.lumitree").geometry.origin == FAR
    save(with_geometry(small_geometry()), tmp_path / "near.lumitree")
    near = (tmp_path / "near.lumitree").read_bytes()
    assert b"origin" not in near


def test_an_asset_is_exported_near_the_origin(mi):
    from lumitree.exports.surfaces import geometry_meshes

    near = with_geometry(small_geometry())
    assert near.near_origin is near
    far = with_geometry(small_geometry(origin=FAR), near.frame.moved(FAR)).near_origin
    assert np.allclose(far.frame.world_from_local, near.frame.world_from_local)
    for mesh, other in zip(
        geometry_meshes(near.geometry, np.eye(4)),
        geometry_meshes(far.geometry, np.eye(4)),
        strict=True,
    ):
        assert np.allclose(mesh["vertices"], other["vertices"], atol=1e-6)


def test_a_scene_that_is_far_is_told_of(mi, lamps):
    """Its coordinates are float32 already."""
    lamp = {"type": "sphere", "center": [0, 1e5, 0], "emitter": {"type": "area"}}
    with pytest.warns(LumitreeWarning, match="rounded to multiples of 0.0078, 0.39% of"):
        lumitree.load_luminaire(mi.load_dict({"type": "scene", "lamp": lamp}))


def test_instances_of_a_group_are_moved_once(mi, tmp_path):
    """And not by the group as well."""
    (tmp_path / "lamp.xml").write_text(
        scene(
            sphere("bulb", 0.5, (0, 0, 0), AREA),
            f'<shape type="shapegroup" id="group">{cube("inner", 0.5)}</shape>',
            '<shape type="instance"><ref id="group"/><transform name="to_world">'
            '<translate x="2"/></transform></shape>',
        )
    )
    from lumitree.rendering.scene import place_shapes

    matrix = np.diag([2.0, 2, 2, 1])
    matrix[:3, 3] = [0, 7, 0]
    shapes = mi.load_dict({"type": "scene", **place_shapes(tmp_path / "lamp.xml", matrix)}).shapes()
    boxes = sorted(np.ravel([shape.bbox().min, shape.bbox().max]).tolist() for shape in shapes)
    assert np.allclose(boxes, [[-1, 6, -1, 1, 8, 1], [3, 6, -1, 5, 8, 1]], atol=1e-5)


def test_the_step_of_float32_numbers():
    assert float32_step([1.0, -3.0]) == 2.0**-22
    assert float32_step(1e300) > 1e30
    assert not is_far([800.0], 1)
    assert is_far([-1100.0], 1)
