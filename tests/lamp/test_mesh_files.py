"""Mesh files of scenes: what would end the process is refused, and all else is left to Mitsuba."""

import struct
import zlib

import numpy as np
import pytest
import trimesh

from lumitree.errors import LumitreeError
from lumitree.lamp.loading import load_luminaire
from lumitree.lamp.mesh_files import check_mesh_file
from support.lamps import AREA, scene

BALL = trimesh.creation.icosphere(subdivisions=0)
PLAIN = "ply\nformat {}\ncomment made by hand\nelement vertex {}\n{}element face {}\n{}end_header\n"
XYZ = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_index\n"
TRIANGLE = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def text(body=TRIANGLE, vertices=3, faces=1, properties=XYZ, face=LIST):
    head = PLAIN.format("ascii 1.0", vertices, properties, faces, face)
    return (head + body).encode()


def binary(faces, order="<", vertices=3, count=None, face=LIST, code="i"):
    kind = {"<": "binary_little_endian 1.0", ">": "binary_big_endian 1.0"}[order]
    head = PLAIN.format(kind, vertices, XYZ, len(faces) if count is None else count, face)
    rows = b"".join(struct.pack(f"{order}B3{code}", 3, *each) for each in faces)
    points = [0, 0, 0, 1, 0, 0, 0, 1, 0]
    return head.encode() + struct.pack(f"{order}9f", *points) + rows


def serialized(faces, vertices=3, flags=0x1000, version=4, more=0, listed=None):
    """A file of one mesh, or of it and of further ones of one triangle."""
    parts = [(faces, vertices)] + more * [([(0, 1, 2)], 3)]
    content, starts = b"", []
    kind = "d" if flags & 0x2000 else "f"
    for triangles, stated in parts:
        starts.append(len(content))
        numbers = 3 + 3 * bool(flags & 1) + 2 * bool(flags & 2) + 3 * bool(flags & 8)
        body = struct.pack("<I", flags) + (b"mesh\0" if version == 4 else b"")
        body += struct.pack("<QQ", stated, len(triangles))
        body += struct.pack(f"<{3 * numbers}{kind}", *np.random.default_rng(0).random(3 * numbers))
        body += b"".join(struct.pack("<3I", *each) for each in triangles)
        content += struct.pack("<HH", 0x041C, version) + zlib.compress(body)
    width = "Q" if version == 4 else "I"
    count = len(parts) if listed is None else listed
    return content + struct.pack(f"<{len(starts)}{width}I", *starts, count)


GOOD = {
    "text.ply": text(),
    "little.ply": binary([(0, 1, 2)]),
    "big.ply": binary([(0, 1, 2)], ">"),
    "short.ply": binary([(0, 1, 2)], face="property list uchar ushort vertex_indices\n", code="H"),
    "a.serialized": serialized([(0, 1, 2)]),
    "double.serialized": serialized([(0, 1, 2)], flags=0x200B),
    "old.serialized": serialized([(0, 1, 2)], version=3),
    "more.serialized": serialized([(0, 1, 2)], more=2),
}


def shape(name, rest=""):
    plugin = name.rpartition(".")[2]
    return (
        f'<shape type="{plugin}"><string name="filename" value="{name}"/>{rest}'
        f'<bsdf type="diffuse"/>{AREA}</shape>'
    )


def lamp(folder, name, content, rest=""):
    (folder / name).write_bytes(content)
    (folder / "lamp.xml").write_text(scene(shape(name, rest)))
    return load_luminaire(folder / "lamp.xml")


@pytest.mark.parametrize("name", GOOD)
def test_good_files_are_loaded(mi, tmp_path, name):
    index = '<integer name="shape_index" value="2"/>' if name == "more.serialized" else ""
    found = lamp(tmp_path, name, GOOD[name], index)
    assert found.num_triangles == 1


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", text(TRIANGLE.replace("1 2\n", "1 3\n")), "not among its 3"),
        ("a.ply", text(TRIANGLE.replace("1 2\n", "1 -1\n")), "not among its 3"),
        ("a.ply", text(TRIANGLE.replace("1 2\n", "1 2.5\n")), "no integers"),
        ("a.ply", text(TRIANGLE + "9"), "14 numbers, where it states 13"),
        ("a.ply", text(vertices=10**15), "4 billion"),
        ("a.ply", text(vertices=2**32 + 3), "4 billion"),
        ("a.ply", text(vertices="-3"), "states '-3' elements"),
        ("a.ply", text(face=LIST + "element vertex 1\n" + XYZ, body=TRIANGLE + "0 0 0"), "repeats"),
        ("a.ply", text()[:40], "no header"),
        ("a.ply", text(properties="property real x\n"), "no header"),
        ("a.ply", b"\n" * 5000 + text(), "no header"),
        ("a.ply", b"x" * 100_000, "no header"),
        ("a.ply", binary([(0, 1, 3)]), "not among its 3"),
        ("a.ply", binary([(0, 1, 3)], ">"), "not among its 3"),
        ("a.ply", binary([(0, 1, -1)]), "not among its 3"),
        ("a.ply", binary([(0, 1, 2)], vertices=4), "cut off: it states 1 face"),
        ("a.ply", binary([(0, 1, 2)], count=2), "cut off: it states 2 face"),
        ("a.ply", binary([(0, 1, 2)], vertices=10**9), "cut off: it states 1000000000 vertex"),
        ("a.serialized", serialized([(0, 1, 3)]), "not among its 3"),
        ("a.serialized", serialized([(0, 1, 2)], vertices=4), "cut off"),
        ("a.serialized", serialized([(0, 1, 2)], vertices=2**32 + 3), "states 4294967299"),
        ("a.serialized", serialized([(0, 1, 2)])[:30], "cut off|decompressed"),
        ("a.serialized", serialized([(0, 1, 2)])[:4] + bytes(40), "decompressed"),
    ],
)
def test_damaged_files_are_refused(mi, tmp_path, name, content, message):
    with pytest.raises(LumitreeError, match=f"{name} is a damaged mesh: .*({message})") as caught:
        lamp(tmp_path, name, content)
    assert str(caught.value).isprintable()


def test_meshes_of_a_serialized_file_that_are_not_there(tmp_path):
    path = tmp_path / "a.serialized"
    path.write_bytes(serialized([(0, 1, 2)], more=1, listed=900))
    with pytest.raises(LumitreeError, match="number 1 is not among them"):
        check_mesh_file("serialized", path, 1)
    path.write_bytes(GOOD["more.serialized"])
    with pytest.raises(LumitreeError, match="number 3 is not among them"):
        check_mesh_file("serialized", path, 3)


def test_other_files_are_left_to_mitsuba(tmp_path):
    check_mesh_file("ply", tmp_path / "none.ply")
    check_mesh_file("ply", tmp_path)
    (tmp_path / "a.obj").write_text("no mesh")
    check_mesh_file("obj", tmp_path / "a.obj")
