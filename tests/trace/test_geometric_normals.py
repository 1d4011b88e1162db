"""Opaque surfaces with shading normals do not let light through."""

import numpy as np
import pytest
import trimesh

from lumitree.lamp.luminaire import load_luminaire
from lumitree.trace.flux import estimate_flux
from lumitree.trace.light_paths import trace_light
from support.camera_flux import flux_by_camera_paths
from support.lamps import AREA, lamp_of, scene, sphere

BSDFS = ("diffuse", "principled", "roughconductor")


@pytest.fixture
def shade(tmp_path):
    """A function that writes a bulb in a closed shade of 20 triangles, smoothly shaded."""

    def write(bsdf):
        ball = trimesh.creation.icosphere(subdivisions=0, radius=1.0)
        ball.export(tmp_path / "shade.ply", vertex_normal=True)
        mesh = (
            '<shape type="ply"><string name="filename" value="shade.ply"/>'
            f'<bsdf type="twosided"><bsdf type="{bsdf}"/></bsdf></shape>'
        )
        path = tmp_path / "lamp.xml"
        path.write_text(scene(sphere("bulb", 0.2, inside=AREA) + mesh))
        return path

    return write


@pytest.mark.parametrize("bsdf", BSDFS)
def test_light_paths_do_not_leave_a_closed_opaque_shade(mi, shade, bsdf):
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 1 << 16)
    paths = trace_light(load_luminaire(shade(bsdf)), sampler, 1 << 16, 64, all_light=True)
    # A few start within rounding of an edge; a tenth of all paths did so before.
    assert (np.array(paths.flux) > 0).any(axis=0).sum() < 8


@pytest.mark.parametrize("bsdf", BSDFS)
def test_camera_paths_do_not_see_into_a_closed_opaque_shade(mi, shade, bsdf):
    loaded = mi.load_file(str(shade(bsdf)))
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 32, "height": 32},
        }
    )
    image = {}
    for kind in ("path", "lumitree_path"):
        integrator = mi.load_dict({"type": kind})
        image[kind] = np.array(mi.render(loaded, sensor=sensor, integrator=integrator, spp=64))
    assert image["path"].sum() > 1
    assert image["lumitree_path"].sum() < 1e-3 * image["path"].sum()


@pytest.mark.slow
def test_light_paths_and_camera_paths_of_an_open_shade_agree(mi, tmp_path):
    """The rule is the same in both directions: the upper half of a smoothly shaded icosahedron."""
    ball = trimesh.creation.icosphere(subdivisions=0, radius=1.0)
    normals = ball.vertex_normals.copy()
    upper = ball.faces[ball.triangles_center[:, 1] > 0]
    half = trimesh.Trimesh(ball.vertices, upper, vertex_normals=normals, process=False)
    half.export(tmp_path / "shade.ply", vertex_normal=True)
    bsdf = '<bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>'
    mesh = (
        '<shape type="ply"><string name="filename" value="shade.ply"/>'
        f'<bsdf type="twosided">{bsdf}</bsdf></shape>'
    )
    lamp = lamp_of(tmp_path, sphere("bulb", 0.2, inside=AREA) + mesh)
    lights = estimate_flux(lamp, 1 << 20)
    tracer = mi.load_dict({"type": "lumitree_path", "max_depth": 64})
    seen = flux_by_camera_paths(lamp, 1 << 22, integrator=tracer)
    error = np.hypot(lights.watts_error, seen.watts_error)
    assert (np.abs(np.subtract(lights.watts, seen.watts)) < 4 * error).all()
    assert seen.watts_error[0] < 0.005 * seen.watts[0]
