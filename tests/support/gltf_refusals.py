"""Small glTF files to damage, and the check that they are refused."""

import json

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.importers.gltf import read_gltf
from support.gltf_builder import QUAD, QUAD_FACES, Gltf


def quad():
    gltf = Gltf()
    gltf.quad()
    return gltf


def textured(uri=None):
    gltf = Gltf()
    source = gltf.add("images", uri=uri) if uri else gltf.image(np.zeros((2, 2, 3)))
    texture = {"index": gltf.add("textures", source=source)}
    gltf.quad(gltf.material(pbrMetallicRoughness={"baseColorTexture": texture}))
    return gltf


def refused(path, match):
    with pytest.raises(LumitreeError, match=match) as caught:
        read_gltf(path)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400


def refused_json(folder, content, match):
    path = folder / "lamp.gltf"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    refused(path, match)


def sparse(count=1, at=(2,), **change):
    gltf = Gltf()
    where = {"bufferView": gltf.view(np.array(at, np.uint16).tobytes()), "componentType": 5123}
    new = {"bufferView": gltf.view(np.full((len(at), 3), 7, np.float32).tobytes())}
    fields = {"count": count, "indices": where, "values": new} | change
    index = gltf.accessor(QUAD, sparse=fields)
    gltf.node(gltf.primitive(QUAD, QUAD_FACES) | {"attributes": {"POSITION": index}})
    return gltf
