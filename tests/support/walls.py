"""The irradiance of a small wall, by next-event estimation."""

import numpy as np
import pytest


def white(mi, point, normal, half=0.04):
    """A small white wall."""
    up = [0, 0, 1] if abs(normal[1]) > 0.9 else [0, 1, 0]
    target = (np.array(point) + normal).tolist()
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at(point, target, up).scale(half),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
    }


def irradiance(
    mi, things, point, normal, seed=0, samples=1 << 20, kind="lumitree_path", path_depth=2
):
    """Irradiance [3] of a wall at a point by next-event estimation with MIS, and standard error."""
    normal = np.array(normal) / np.linalg.norm(normal)
    scene = mi.load_dict(
        {
            "type": "scene",
            "wall": white(mi, point, normal.tolist()),
            "sensor": {
                "type": "radiancemeter",
                "origin": (np.array(point) + 0.01 * normal).tolist(),
                "direction": (-normal).tolist(),
                "film": {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}},
            },
            **things,
        }
    )
    integrator = mi.load_dict({"type": kind, "max_depth": path_depth})
    seen = [
        np.array(mi.render(scene, integrator=integrator, spp=samples // 16, seed=seed + i)).ravel()
        for i in range(16)
    ]
    return np.pi * np.mean(seen, 0)[:3], np.pi * np.std(seen, 0, ddof=1)[:3] / 4


def agree(first, second):
    """Within 1 %; that the errors allow to tell."""
    (a, error_a), (b, error_b) = first, second
    assert (np.hypot(error_a, error_b) < 0.003 * b).all()
    assert a == pytest.approx(b, rel=0.01)
