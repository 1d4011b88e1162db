"""Receivers around a box, for tests of what samples the box."""

import numpy as np

HALF = np.array([1.0, 0.75, 0.5])
# Far and near, past an edge, past a corner, and just off a face that shines.
POINTS = {
    "far": (3.0, -40.0, 9.0),
    "below": (0.4, -4.0, 0.3),
    "beside": (2.5, 0.1, 0.2),
    "near": (0.2, 0.9, -0.1),
    "corner": (1.1, 0.8, 0.6),
    "touching": (-0.9, -0.7501, 0.2),
}


def device_point(mi, name):
    """mi.Point3f of one of `POINTS`."""
    import drjit as dr

    return mi.Point3f(*(dr.opaque(mi.Float, x) for x in POINTS[name]))


def uniform_samples(mi, count, seed=0):
    """Sampler of mi.Float [count]."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    return sampler
