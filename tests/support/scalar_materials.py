"""Materials by Mitsuba's variant without compilation, in a process of its own: `scalar_materials.py
COUNT`. With 0 all pairs of parameters are tried, with another number so many of them.

Prints one JSON line: the number of materials that an asset may have, and those among them that
Mitsuba does not make, or of which it gives values that are not finite or negative.
"""

import itertools
import json
import sys

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)

from lumitree.asset.materials import Diffuse, check_coordinates  # noqa: E402
from lumitree.rendering.geometry import Materials  # noqa: E402
from support.material_combinations import (  # noqa: E402
    FACTS,
    FAR,
    FARTHER,
    IMAGES,
    accepted,
    materials,
    texture,
)

# Errors of rounding, relative to the largest value.
ROUNDING = 1e-6


def unit(direction):
    return mi.Vector3f(*(np.array(direction) / np.linalg.norm(direction)))


class Surface:
    """Points of a triangle with texture coordinates and colours, seen from both sides."""

    def __init__(self, farthest=1.0):
        mesh = mi.Mesh("triangle", 3, 1, has_vertex_texcoords=True)
        found = mi.traverse(mesh)
        found["vertex_positions"] = [-20, -20, 0, 40, -20, 0, -20, 40, 0]
        found["faces"], found["vertex_texcoords"] = [0, 1, 2], [0, 0, farthest, 0, 0, farthest]
        found.update()
        mesh.add_attribute("vertex_color", 3, [0, 0.2, 0.3, 0, 1, 0, 1, 1, 1])
        self._materials = Materials(IMAGES)
        # Kept: a pointer to a shape does not own it.
        self._scene = mi.load_dict({"type": "scene", "mesh": mesh})
        seen = [((0.2, 0.3, 1), (0.1, 0, -1)), ((5, 3, -1), (0, 0.3, 1))]
        seen += [((0.3, 0.3, 0.01), (1, 0.3, -0.03)), ((3, 7, -0.01), (-1, 1, 0.03))]
        rays = [mi.Ray3f(mi.Point3f(*origin), unit(towards)) for origin, towards in seen]
        self._points = [self._scene.ray_intersect(ray) for ray in rays]
        upwards = [(0, 0, 1), (0.5, 0.2, 0.7), (-0.9, -0.1, 0.01)]
        self._out = [unit(each) for each in upwards] + [-unit(each) for each in upwards]
        modes = (mi.TransportMode.Radiance, mi.TransportMode.Importance)
        self._contexts = [mi.BSDFContext(mode) for mode in modes]

    def fault(self, material):
        """The fault of a material's values, as text; an empty text if there is none."""
        try:
            found = np.array(list(self._values(self._materials.bsdf(material))), np.float64)
        except RuntimeError as error:
            return " ".join(str(error).split())[:200]
        if not np.isfinite(found).all():
            return "values are not finite"
        return "" if found.min() >= -ROUNDING * max(found.max(), 1) else f"value {found.min()}"

    def _values(self, bsdf):
        radiance, _ = self._contexts
        for point, out in itertools.product(self._points, self._out):
            yield from (*bsdf.eval(radiance, point, out), bsdf.pdf(radiance, point, out))
        for point, context in itertools.product(self._points, self._contexts):
            for choice in (0.01, 0.5, 0.99):
                sample, weight = bsdf.sample(context, point, choice, mi.Point2f(0.3, 0.8))
                yield from (*weight, sample.pdf)
            yield from bsdf.eval_null_transmission(point)


def far_textures():
    """Textures at the largest coordinates that are accepted, by name."""
    for kind, wrap in itertools.product(("bilinear", "nearest"), ("repeat", "mirror", "clamp")):
        looked_up = texture(4, True, FARTHER, kind, wrap)
        check_coordinates(looked_up, FACTS, np.array([FAR, FAR]))
        yield f"{kind} {wrap}", Diffuse(reflectance=looked_up)


if __name__ == "__main__":
    surface = Surface()
    tried = list(materials(int(sys.argv[1])))
    usable = [material for material in tried if accepted(material)]
    faults = {repr(m): fault for m in usable if (fault := surface.fault(m))}
    far = Surface(FAR)
    faults |= {name: fault for name, each in far_textures() if (fault := far.fault(each))}
    print(json.dumps({"tried": len(tried), "accepted": len(usable), "faults": faults}))
