"""Denoising of what a lamp shows of its own light, which few and bright samples find."""

import numpy as np
import pytest

import lumitree
from lumitree.rendering.layers import Recorded
from support.lamps import AREA, scene, sphere

pytest.importorskip("mitsuba_oidn")
ROUGH = '<bsdf type="roughdielectric"><float name="alpha" value="0.3"/></bsdf>'


def test_self_emission_keeps_its_mean(mi):
    """A disc whose light one sample in 120 finds, 2 a pixel; as illumination it gets darker."""
    from lumitree.rendering.layers import denoised

    random = np.random.default_rng(0)
    y, x = np.mgrid[:160, :160]
    found = random.binomial(2, 1 / 120, x.shape) * random.exponential(60, x.shape)
    found *= np.hypot(x - 80, y - 80) < 60
    noisy = np.repeat(found[..., None], 3, axis=-1).astype(np.float32)
    none, black = np.zeros_like(noisy)[None], np.zeros_like(noisy)
    shown = denoised(Recorded(none, noisy[None], none, none[..., 0], black, black)).self_emission[0]
    assert shown.mean() == pytest.approx(noisy.mean(), rel=0.03)
    assert shown.std() < 0.3 * noisy.std()
    lit = denoised(Recorded(none, none, noisy[None], none[..., 0], black, black)).lit[0]
    assert lit.mean() < 0.8 * noisy.mean()


@pytest.mark.slow
def test_a_denoised_lamp_of_two_samples_is_as_bright_as_a_converged_one(mi, tmp_path):
    """A globe of rough glass: nearly all of its light is self-emission."""
    from lumitree.rendering.layers import denoised
    from lumitree.rendering.passes import Budget
    from lumitree.rendering.render_job import Described, RenderJob

    globe = sphere("globe", 0.5, inside=ROUGH), sphere("hollow", 0.47, inside=ROUGH, flip=True)
    (tmp_path / "globe.xml").write_text(scene(*globe, sphere("bulb", 0.1, inside=AREA)))
    few = lumitree.LightFieldConfig(paths=1 << 17, depth=3, resolution=8)
    config = lumitree.BakeConfig(parts=("light", "geometry"), irradiance_paths=0, light=few)
    lumitree.bake(tmp_path / "globe.xml", tmp_path / "globe.lumitree", config, progress=None)
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(3)}
    look = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 256, "height": 192, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 40, "to_world": look, "film": film}
    path = {"type": "path", "max_depth": 16}
    room = {"type": "scene", "wall": wall, "sensor": sensor, "integrator": path}

    def recorded(samples, seed, width=None):
        placed = [lumitree.Placement(tmp_path / "globe.lumitree", size=1.0)]
        job = RenderJob(Described(room, placed, width, 1.0, True, False))
        return job.rendered(Budget(samples), seed, None, None, None)[1]

    converged = recorded(2048, 9, width=64)
    assert converged.self_emission.mean() > 5 * converged.seen.mean()
    few = [denoised(recorded(2, seed)).self_emission.mean() for seed in range(4)]
    assert np.mean(few) == pytest.approx(converged.self_emission.mean(), rel=0.03)
