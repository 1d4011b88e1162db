"""Materials of assets in all combinations of parameters, accepted or not."""

import itertools

import numpy as np

from lumitree.asset.materials import (
    PLUGINS,
    Dielectric,
    Diffuse,
    ImageFacts,
    Mask,
    MetallicRoughness,
    Principled,
    RoughConductor,
    Texture,
    TwoSided,
    VertexColours,
    check_material,
    make_material,
    parameter_kinds,
)
from lumitree.core.frames import rows_of
from lumitree.errors import LumitreeError

RANDOM = np.random.default_rng(0)
IMAGES = (
    *(np.full((2, 3, 1), value, np.float32) for value in (0, 1, -5, 1e12)),
    RANDOM.random((3, 2, 3)).astype(np.float32),
    *(RANDOM.integers(0, 256, (3, 2, channels), np.uint8) for channels in (1, 3, 4)),
    np.zeros((1, 1, 4), np.float32),
)
FACTS = [ImageFacts.of(image) for image in IMAGES]
DIFFUSE, GLASS, METAL = Diffuse(), Dielectric(), RoughConductor()
# Texture coordinates and their scale, whose product is just accepted for 3 pixels.
FAR, FARTHER = 3.5e4, 1e4


def texture(image, raw=True, scale=3.0, filter_type="bilinear", wrap_mode="repeat"):
    to_uv = rows_of(np.diag([scale, scale, 1, 1]))
    return Texture(image=image, raw=raw, filter_type=filter_type, wrap_mode=wrap_mode, to_uv=to_uv)


TEXTURES = [texture(index) for index in range(len(IMAGES))]
TEXTURES += [texture(5, False), texture(6, False), VertexColours()]
NEEDED = {
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
        found += [(0, 0, 0), (kind.colour,) * 3, (kind.colour, 0, kind.colour / 2)]
    if kind.boolean:
        found += [True, False]
    return found + TEXTURES


def nested(plugin):
    """BSDFs that each modifying plugin may contain, alone and in pairs."""
    alone = (DIFFUSE, GLASS, METAL, Principled(spec_trans=0.5))
    layers = (Mask(nested=(METAL,)), TwoSided(nested=(DIFFUSE,)))
    for count in plugin.num_nested:
        yield from itertools.product((*alone, *layers), repeat=count) if count else ()


def parameters(plugin):
    """No parameter, each value of each, and each pair of values of each pair."""
    kinds = parameter_kinds(plugin)
    single = [{name: value} for name, kind in kinds.items() for value in values(kind)]
    yield [{}, *single]
    yield [a | b for a, b in itertools.combinations(single, 2) if a.keys() != b.keys()]


def materials(count):
    """All materials; of those with two parameters, `count` alone unless it is 0."""
    pairs = []
    for name, plugin in PLUGINS.items():
        if plugin is MetallicRoughness:
            # A plugin in Python, which variants without compilation do not have.
            continue
        needed, inner = NEEDED.get(name, {}), [DIFFUSE] * plugin.num_nested[0]
        first, second = parameters(plugin)
        yield from (make_material(name, needed | given, inner) for given in first)
        yield from (make_material(name, needed, held) for held in nested(plugin))
        pairs += [(name, needed | given, inner) for given in second]
    chosen = RANDOM.permutation(len(pairs))[: count or None]
    yield from (make_material(*pairs[index]) for index in chosen)


def accepted(material):
    try:
        check_material(material, FACTS)
    except LumitreeError:
        return False
    return True
