"""Small glTF models: one that uses everything, a sparse accessor, a light, instances."""

import numpy as np

from support.gltf_builder import QUAD, QUAD_FACES, Gltf


def sparse(count=1, at=(2,), **change):
    made = Gltf()
    where = {"bufferView": made.view(np.array(at, np.uint16).tobytes()), "componentType": 5123}
    new = {"bufferView": made.view(np.full((len(at), 3), 7, np.float32).tobytes())}
    index = made.accessor(QUAD, sparse={"count": count, "indices": where, "values": new} | change)
    made.node(made.primitive(QUAD, QUAD_FACES) | {"attributes": {"POSITION": index}})
    return made


def lit(light, **node):
    """A quad, and a node with a light."""
    made = Gltf()
    made.quad()
    made.json["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    made.node(extensions={"KHR_lights_punctual": {"light": 0}}, **node)
    return made


def instanced(required=False, **attributes):
    """Instances of a quad at (0, 10, 0), by arrays of their attributes."""
    made, name = Gltf(), "EXT_mesh_gpu_instancing"
    indices = {
        key: made.accessor(values, **({"normalized": True} if values.dtype.kind == "i" else {}))
        for key, values in attributes.items()
    }
    made.quad(translation=[0, 10, 0], extensions={name: {"attributes": indices}})
    made.json["extensionsUsed"] = [name]
    if required:
        made.json["extensionsRequired"] = [name]
    return made


def rich():
    """The model, as `Gltf`."""
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
