"""Light paths against closed forms; that they agree with camera paths is tested with the bake."""

import numpy as np
import pytest

import lumitree
from lumitree.lamp.luminaire import load_luminaire
from lumitree.trace.light_paths import trace_light
from support.camera_flux import flux_by_camera_paths
from support.fields import uniform_asset
from support.lamps import AREA, lamp_of, scene, sphere


@pytest.mark.slow
def test_a_mesh_of_smooth_normals_emits_what_camera_paths_see_of_it(mi, tmp_path):
    """A face turned by δ from its shading normal emits π L A (1 + cos δ) / 2 into its front.

    All its light paths carry the same.
    """
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
    path = tmp_path / "ball.ply"
    ball.export(path, vertex_normal=True)
    lamp_file = tmp_path / "lamp.xml"
    mesh = f'<shape type="ply" id="ball"><string name="filename" value="{path}"/>{AREA}</shape>'
    lamp_file.write_text(scene(mesh))
    lamp = load_luminaire(lamp_file)

    corners = np.sort(np.random.default_rng(0).random((4096, 2)), axis=1)
    weights = np.stack([corners[:, 0], np.diff(corners, axis=1)[:, 0], 1 - corners[:, 1]], axis=1)
    normals = np.einsum("nc,fcx->fnx", weights, ball.vertex_normals[ball.faces])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    cosine = np.einsum("fnx,fx->fn", normals, ball.face_normals).mean(axis=1)
    expected = np.pi * (ball.area_faces * (1 + cosine) / 2).sum() * np.array([3, 2, 1])
    assert expected[2] < 0.995 * np.pi * ball.area

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 1 << 18)
    paths = trace_light(lamp, sampler, 1 << 18, 8, all_light=True)
    flux = np.array(paths.flux, np.float64)
    assert (flux[:, flux[0] > 0] > 0.999 * flux.max(axis=1, keepdims=True)).all()
    found = flux.sum(axis=1) * lamp.frame.scale**2
    assert found == pytest.approx(expected, rel=2e-3)
    seen = flux_by_camera_paths(lamp, 1 << 20)
    assert (np.abs(seen.watts - found) < 4 * np.array(seen.watts_error) + 1e-3 * found).all()


def test_only_bent_light_is_returned_unless_all_is_asked_for(mi, tmp_path):
    """A bare sphere is seen straight alone."""
    lamp = lamp_of(tmp_path, sphere("ball", 1, inside=AREA))
    flux = []
    for all_light in (False, True):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, 1 << 12)
        paths = trace_light(lamp, sampler, 1 << 12, 8, all_light=all_light)
        flux.append(np.array(paths.flux, np.float64).sum(axis=1))
    assert (flux[0] == 0).all()
    assert flux[1] == pytest.approx(4 * np.pi**2 * np.array([3, 2, 1]), rel=1e-4)


def test_a_baked_lamp_in_the_same_process_does_not_disturb(mi, tmp_path):
    """Mitsuba compiles a call on a pointer to an emitter for all emitters that there are."""
    lamp_file = tmp_path / "lamp.xml"
    lamp_file.write_text(scene(sphere("ball", 1, inside=AREA)))
    baked = mi.load_dict(lumitree.shape(uniform_asset(1.0, [1, 1, 1])))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 1 << 12)
    paths = trace_light(load_luminaire(lamp_file), sampler, 1 << 12, 8, all_light=True)
    flux = np.array(paths.flux, np.float64).sum(axis=1)
    assert flux == pytest.approx(4 * np.pi**2 * np.array([3, 2, 1]), rel=1e-4)
    assert baked.is_emitter()
