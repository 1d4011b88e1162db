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

from lumitree.asset.materials import check_material  # noqa: E402
from lumitree.asset.plugins import PLUGINS  # noqa: E402
from lumitree.asset.textures import ImageFacts, check_coordinates  # noqa: E402
from lumitree.errors import LumitreeError  # noqa: E402
from lumitree.rendering.model_materials import Materials  # noqa: E402

RANDOM = np.random.default_rng(0)
IMAGES = (
    *(np.full((2, 3, 1), value, np.float32) for value in (0, 1, -5, 1e12)),
    RANDOM.random((3, 2, 3)).astype(np.float32),
    *(RANDOM.integers(0, 256, (3, 2, channels), np.uint8) for channels in (1, 3, 4)),
    np.zeros((1, 1, 4), np.float32),
)
FACTS = [ImageFacts.of(image) for image in IMAGES]
DIFFUSE, GLASS, METAL = {"type": "diffuse"}, {"type": "dielectric"}, {"type": "roughconductor"}
# Of rounding, relative to the largest value.
ROUNDING = 1e-6


# Texture coordinates and their scale, whose product is just accepted for 3 pixels.
FAR, FARTHER = 3.5e4, 1e4


def texture(image, raw=True, scale=3.0, filter_type="bilinear", wrap_mode="repeat"):
    transform = np.diag([scale, scale, 1, 1]).tolist()
    kinds = {"filter_type": filter_type, "wrap_mode": wrap_mode}
    return {"image": image, "raw": raw, **kinds, "to_uv": transform}


TEXTURES = [texture(index) for index in range(len(IMAGES))]
TEXTURES += [texture(5, False), texture(6, False), {"attribute": "vertex_color"}]
DEFAULTS = {
    "normalmap": {"normalmap": TEXTURES[4]},
    "bumpmap": {"bumpmap": TEXTURES[0]},
    "blendbsdf": {"weight": 0.5},
}


def values(kind):
    """Values of a parameter: the ends of its ranges, names, and all textures, accepted or not."""
    found = []
    if kind.range is not None:
        low, high = kind.range
        # A whole number may be written without its point.
        found += [low, high, low + 0.4 * (high - low), int(high), 0]
    if kind.names:
        found += [min(kind.names), max(kind.names), "air", "bk7", "none"]
    if kind.colour is not None:
        found += [[0, 0, 0], [kind.colour] * 3, [kind.colour, 0, kind.colour / 2]]
    if kind.boolean:
        found += [True, False]
    return found + TEXTURES


def nested(plugin):
    """What a plugin may hold, alone and in pairs."""
    alone = (DIFFUSE, GLASS, METAL, {"type": "principled", "spec_trans": 0.5})
    layers = ({"type": "mask", "nested": [METAL]}, {"type": "twosided", "nested": [DIFFUSE]})
    for count in PLUGINS[plugin].nested:
        yield from itertools.product((*alone, *layers), repeat=count) if count else ()


def parameters(plugin):
    """No parameter, each value of each, and each pair of values of each pair."""
    kinds = PLUGINS[plugin].parameters
    single = [{name: value} for name, kind in kinds.items() for value in values(kind)]
    yield [{}, *single]
    yield [a | b for a, b in itertools.combinations(single, 2) if a.keys() != b.keys()]


def materials(count):
    """All materials; of those with two parameters, `count` alone unless it is 0."""
    pairs = []
    for name, plugin in PLUGINS.items():
        base = {"type": name, **DEFAULTS.get(name, {})}
        if max(plugin.nested):
            base["nested"] = [DIFFUSE] * plugin.nested[0]
        first, second = parameters(name)
        yield from ({**base, **given} for given in first)
        yield from ({**base, "nested": list(inner)} for inner in nested(name))
        pairs += [{**base, **given} for given in second]
        # Without what a plugin needs.
        yield {key: value for key, value in base.items() if key in ("type", "nested")}
    chosen = RANDOM.permutation(len(pairs))[: count or None]
    yield from (pairs[index] for index in chosen)


def accepted(material):
    try:
        check_material(material, FACTS)
    except LumitreeError:
        return False
    return True


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
        """What is wrong with the values of a material; an empty text for nothing."""
        try:
            found = np.array(list(self._values(self._materials.bsdf(material))), np.float64)
        except RuntimeError as error:
            return " ".join(str(error).split())[:200]
        if not np.isfinite(found).all():
            return "values are not finite"
        return "" if found.min() >= -ROUNDING * max(found.max(), 1) else f"value {found.min()}"

    def _values(self, bsdf):
        for point, context in itertools.product(self._points, self._contexts):
            for out in self._out:
                value, density = bsdf.eval_pdf(context, point, out)
                yield from (*value, density, *bsdf.eval(context, point, out))
                yield bsdf.pdf(context, point, out)
            for choice in (0.01, 0.5, 0.99):
                sample, weight = bsdf.sample(context, point, choice, mi.Point2f(0.3, 0.8))
                yield from (*weight, sample.pdf)
            yield from bsdf.eval_null_transmission(point)


def far_textures():
    """Textures at the largest coordinates that are accepted, by name."""
    for kind, wrap in itertools.product(("bilinear", "nearest"), ("repeat", "mirror", "clamp")):
        looked_up = texture(4, True, FARTHER, kind, wrap)
        check_coordinates(looked_up, FACTS, np.array([FAR, FAR]))
        yield f"{kind} {wrap}", {"type": "diffuse", "reflectance": looked_up}


if __name__ == "__main__":
    surface = Surface()
    tried = list(materials(int(sys.argv[1])))
    usable = [material for material in tried if accepted(material)]
    faults = {json.dumps(m, sort_keys=True): fault for m in usable if (fault := surface.fault(m))}
    far = Surface(FAR)
    faults |= {name: fault for name, each in far_textures() if (fault := far.fault(each))}
    print(json.dumps({"tried": len(tried), "accepted": len(usable), "faults": faults}))
