"""Whatever is damaged in a glTF file, nothing but LumitreeError escapes."""

import copy
import json

import numpy as np

from lumitree.lamp.importers.gltf import read_gltf
from support.damage import damaged, refused
from support.gltf_builder import Gltf
from support.gltf_refusals import sparse


def rich():
    """A small file that uses everything."""
    gltf = Gltf()
    pixels = np.random.default_rng(1).integers(0, 255, (2, 2, 4))
    info = gltf.texture(pixels, wrapS=33071, magFilter=9728)
    info["extensions"] = {"KHR_texture_transform": {"offset": [0, 1], "rotation": 1.0}}
    extensions = {
        "transmission": {"transmissionFactor": 0.5, "transmissionTexture": info},
        "volume": {"thicknessFactor": 1, "attenuationColor": [1, 0, 1], "attenuationDistance": 1},
        "clearcoat": {"clearcoatFactor": 1, "clearcoatNormalTexture": info},
        "anisotropy": {"anisotropyStrength": 1, "anisotropyTexture": info},
        "sheen": {"sheenColorFactor": [1, 1, 1]},
        "specular": {"specularFactor": 0.5, "specularColorTexture": info},
        "ior": {"ior": 1.3},
        "emissive_strength": {"emissiveStrength": 3},
        "iridescence": {"iridescenceFactor": 1},
    }
    first = gltf.material(
        pbrMetallicRoughness={"baseColorTexture": info, "metallicRoughnessTexture": info},
        normalTexture=info | {"scale": 0.5},
        emissiveFactor=[1, 1, 1],
        emissiveTexture=info,
        alphaMode="MASK",
        extensions={f"KHR_materials_{name}": value for name, value in extensions.items()},
    )
    glossy = {"diffuseTexture": info, "specularGlossinessTexture": info, "glossinessFactor": 0.5}
    second = gltf.material(extensions={"KHR_materials_pbrSpecularGlossiness": glossy})
    gltf.quad(first, rotation=[0, 0, 0, 1], scale=[1, 2, 1], translation=[0, 0, 1])
    mappings = {"KHR_materials_variants": {"mappings": [{"material": second, "variants": [0]}]}}
    gltf.json["meshes"][0]["primitives"][0]["extensions"] = mappings
    gltf.node(mesh=0, matrix=np.eye(4).ravel().tolist())
    gltf.node(children=[])
    gltf.node(extensions={"KHR_lights_punctual": {"light": 0}})
    sparse_quad = sparse().json["accessors"][0]["sparse"]
    sparse_quad["indices"]["bufferView"] = gltf.view(np.array([2], np.uint16).tobytes())
    sparse_quad["values"]["bufferView"] = gltf.view(np.zeros(3, np.float32).tobytes())
    gltf.json["accessors"][0]["sparse"] = sparse_quad
    gltf.json["extensions"] = {
        "KHR_lights_punctual": {"lights": [{"type": "spot", "color": [1, 1, 1], "intensity": 2}]},
        "KHR_materials_variants": {"variants": [{"name": "v"}]},
    }
    return gltf


def places(value, path=()):
    """Paths of every value in a JSON document."""
    yield path
    if isinstance(value, dict | list):
        for key, entry in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(entry, (*path, key))


WRONG = (None, -1, 10**30, 1e308, True, "x", "\ud800", "\x1b" * 3000, [], [[]], {}, {"a": 1})


def test_any_wrong_value_is_refused_or_read(tmp_path):
    """Whatever stands anywhere in the JSON."""
    gltf = rich()
    whole = gltf.with_buffer(gltf.uri())
    path = tmp_path / "lamp.gltf"
    generator = np.random.default_rng(5)
    refusals = 0
    for place in places(whole):
        for pick in generator.choice(len(WRONG), 3, replace=False) if place else ():
            model = copy.deepcopy(whole)
            inner(model, place[:-1])[place[-1]] = WRONG[pick]
            path.write_text(json.dumps(model))
            variant = ("v", None)[pick % 2]
            refusals += refused(lambda variant=variant: read_gltf(path, variant=variant))
    assert refusals > 300


def test_flipped_bytes_are_refused_or_read(tmp_path):
    whole = rich().glb()
    path = tmp_path / "lamp.glb"
    generator = np.random.default_rng(2)
    for _ in range(300):
        data = bytearray(whole)
        for at in generator.integers(0, len(whole), 3):
            data[at] = generator.integers(0, 256)
        path.write_bytes(data[: generator.integers(1, 2 * len(whole))])
        refused(lambda: read_gltf(path))


def test_gltf_texts(tmp_path):
    gltf = rich()
    whole = json.dumps(gltf.with_buffer(gltf.uri()), indent=1).encode()
    rng = np.random.default_rng(8)
    path = tmp_path / "lamp.gltf"
    refusals = 0
    for _ in range(200):
        path.write_bytes(damaged(whole, rng))
        refusals += refused(lambda: read_gltf(path))
    assert refusals > 50


def test_gltf_structures(tmp_path):
    """Keys dropped, given twice, and values exchanged for others of the file."""
    whole = rich().with_buffer(rich().uri())
    every = [place for place in places(whole) if place]
    rng = np.random.default_rng(9)
    path = tmp_path / "lamp.gltf"
    refusals = 0
    for _ in range(200):
        model = copy.deepcopy(whole)
        for _ in range(rng.integers(1, 4)):
            place, other = (every[pick] for pick in rng.integers(len(every), size=2))
            try:
                parent, value = inner(model, place[:-1]), copy.deepcopy(inner(model, other))
                if rng.random() < 0.3:
                    del parent[place[-1]]
                else:
                    parent[place[-1]] = value
            except (KeyError, IndexError, TypeError):
                continue
        path.write_text(json.dumps(model))
        refusals += refused(lambda: read_gltf(path))
    assert refusals > 50


def inner(value, place):
    for key in place:
        value = value[key]
    return value
