"""Damaged and hostile glTF files are refused with one clear line, and nothing else is read."""

import json
import os
import struct

import numpy as np
import pytest

from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers import gltf_document as container
from lumitree.lamp.importers.gltf import read_gltf
from support.gltf_refusals import quad, refused, refused_json, textured


def test_gltf_and_glb_give_the_same(tmp_path):
    text, binary = read_gltf(quad().save(tmp_path)), read_gltf(quad().save(tmp_path, "lamp.glb"))
    for model in (text, binary):
        np.testing.assert_array_equal(model.parts[0].mesh.uv[:, 0] * 2 - 1,
                                      model.parts[0].mesh.vertices[:, 0])  # fmt: skip
    np.testing.assert_array_equal(text.parts[0].mesh.vertices, binary.parts[0].mesh.vertices)


def test_buffer_beside_the_file(tmp_path):
    gltf = quad()
    (tmp_path / "my data.bin").write_bytes(gltf.data)
    path = tmp_path / "lamp.gltf"
    path.write_text(json.dumps(gltf.with_buffer("my%20data.bin")))
    assert len(read_gltf(path).parts[0].mesh.faces) == 2


@pytest.mark.parametrize(
    "text",
    ["", "{", "[1]", '"x"', "{'a': 1}", '{"asset": NaN}', "\x00", '{"a": ' + "9" * 5000 + "}"],
)
def test_malformed_json(tmp_path, text):
    refused_json(tmp_path, text, r"lamp\.gltf.*(not valid JSON|expected a JSON object)")


def test_deeply_nested_json(tmp_path):
    refused_json(tmp_path, "[" * 200_000, "nested too deeply|not valid JSON")


@pytest.mark.parametrize("version", ["1.0", "3.0", "x"])
def test_other_versions(tmp_path, version):
    refused_json(tmp_path, {"asset": {"version": version}}, "version .*need 2.0")


def test_required_extensions(tmp_path):
    for name in ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"):
        gltf = quad()
        gltf.json["extensionsRequired"] = [name]
        refused(gltf.save(tmp_path), f"requires {name}")


def test_unknown_extension_that_is_not_required_is_reported(tmp_path):
    gltf = quad()
    gltf.json["extensionsUsed"] = ["VENDOR_magic", "KHR_materials_ior"]
    with pytest.warns(LumitreeWarning, match="ignored: extension VENDOR_magic$"):
        read_gltf(gltf.save(tmp_path))


def test_damaged_glb(tmp_path):
    good = quad().glb()
    path = tmp_path / "lamp.glb"

    def with_header(magic=b"glTF", version=2, length=None, rest=good[12:]):
        path.write_bytes(struct.pack("<4sII", magic, version, length or len(good)) + rest)
        return path

    assert read_gltf(with_header()).parts
    refused(with_header(magic=b"glTX"), "does not begin with 'glTF'")
    refused(with_header(version=1), "version 1; need 2")
    refused(with_header(length=len(good) + 1), "cut off")
    refused(with_header(length=16), "cut off")
    refused(with_header(rest=good[12:-8]), "cut off")
    refused(with_header(length=12, rest=b""), "without a JSON chunk")
    huge = struct.pack("<II", 2**32 - 1, 0x4E4F534A) + good[20:]
    refused(with_header(rest=huge), "cut off")
    path.write_bytes(b"glTF\2\0")
    refused(path, "cut off")


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "%2e%2e/secret.bin",
        "..\\secret.bin",
        "/etc/passwd",
        "file:///etc/passwd",
        "http://example.org/a.bin",
        "link.bin",
        "linked/secret.bin",
        "",
    ],
)
@pytest.mark.parametrize("kind", ["buffer", "image"])
def test_nothing_outside_the_folder_is_read(tmp_path, uri, kind):
    folder = tmp_path / "model"
    folder.mkdir()
    gltf = quad()
    (tmp_path / "secret.bin").write_bytes(bytes(gltf.data))
    os.symlink(tmp_path / "secret.bin", folder / "link.bin")
    os.symlink(tmp_path, folder / "linked")
    match = "model's folder"
    if kind == "buffer":
        refused_json(folder, gltf.with_buffer(uri), match)
        return
    gltf = textured("placeholder.png")
    gltf.json["images"][0]["uri"] = uri
    if uri.startswith("link"):
        refused(gltf.save(folder), match)
    else:
        with pytest.warns(LumitreeWarning, match="left out: .* is not in the model's folder"):
            assert read_gltf(gltf.save(folder)).parts


@pytest.mark.parametrize("uri", ["C:%5Cwork%5Cdata.bin", "file:///tmp/Data.BIN", "a/../data.bin"])
def test_files_beside_the_model_are_taken(tmp_path, uri):
    gltf = quad()
    (tmp_path / "data.bin").write_bytes(bytes(gltf.data))
    path = tmp_path / "lamp.gltf"
    path.write_text(json.dumps(gltf.with_buffer(uri)))
    with pytest.warns(LumitreeWarning, match="'data.bin' in the model's folder is taken") as caught:
        assert read_gltf(path).parts
    assert len(caught) == 1


@pytest.mark.parametrize("uri", ["\ud800.bin", "x" * 300, "a/" * 3000 + "b", "\x1b[31m.bin"])
def test_odd_names_are_not_there(tmp_path, uri):
    refused_json(tmp_path, quad().with_buffer(uri), "which is not in the model's folder")


def test_links_inside_the_folder_are_followed(tmp_path):
    gltf = quad()
    (tmp_path / "data.bin").write_bytes(gltf.data)
    os.symlink("data.bin", tmp_path / "link.bin")
    path = tmp_path / "lamp.gltf"
    path.write_text(json.dumps(gltf.with_buffer("link.bin")))
    assert read_gltf(path).parts


def test_huge_files_are_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(container, "MAX_FILE_BYTES", 2000)
    with open(tmp_path / "data.bin", "wb") as file:
        file.truncate(10**9)
    refused_json(tmp_path, quad().with_buffer("data.bin"), "data.bin is larger than")
    with open(tmp_path / "big.glb", "wb") as file:
        file.truncate(10**9)
    refused(tmp_path / "big.glb", "larger than 2000")


def test_damaged_data_uris(tmp_path):
    for uri in ("data:;base64,%%%", "data:;base64,AAA", "data:nothing"):
        refused_json(tmp_path, quad().with_buffer(uri), "data URI")
    refused_json(tmp_path, quad().with_buffer("data:;base64,AAAA"), "only 3 are there")


def test_buffer_without_data(tmp_path):
    refused_json(tmp_path, quad().with_buffer(), "has no data")
