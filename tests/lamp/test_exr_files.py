"""OpenEXR images of scenes: those that are cut off are refused, and whole ones of any kind read."""

import numpy as np
import OpenEXR
import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.exr_files import check_exr_file
from lumitree.lamp.loading import load_luminaire
from lumitree.rendering.scene import load_scene
from support.damage import checked
from support.lamps import AREA, scene, sphere

COMPRESSIONS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
PIXELS = np.random.default_rng(0).random((300, 20, 3)).astype(np.float16)


def written(path, compression="ZIP", rows=40, **header):
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), **header}
    kind = header.setdefault("type", OpenEXR.scanlineimage)
    assert kind in (OpenEXR.scanlineimage, OpenEXR.tiledimage)
    OpenEXR.File(header, {"RGB": PIXELS[:rows]}).write(str(path))
    return path.read_bytes()


def tiles(mode):
    found = OpenEXR.TileDescription()
    found.xSize, found.ySize, found.mode = 16, 8, mode
    return {"type": OpenEXR.tiledimage, "tiles": found}


def several(path):
    parts = [
        OpenEXR.Part({"name": name, "type": OpenEXR.scanlineimage}, {"RGB": PIXELS[:40]})
        for name in "ab"
    ]
    OpenEXR.File(parts).write(str(path))
    return path.read_bytes()


def refused(path, content):
    path.write_bytes(content)
    with pytest.raises(LumitreeError, match="is a damaged OpenEXR image") as caught:
        check_exr_file(path)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("rows", [1, 31, 33, 300])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_images_that_are_cut_off(tmp_path, compression, rows):
    path = tmp_path / "a.exr"
    whole = written(path, compression, rows)
    check_exr_file(path)
    for length in (len(whole) - 1, len(whole) // 2, 400, 100, 9, 5):
        refused(path, whole[: min(length, len(whole) - 1)])


@pytest.mark.parametrize("kind", ["one level", "mipmap", "ripmap", "parts"])
def test_tiles_and_parts_that_are_cut_off(tmp_path, kind):
    path = tmp_path / "a.exr"
    if kind == "parts":
        whole = several(path)
    else:
        names = {
            "one level": OpenEXR.ONE_LEVEL,
            "mipmap": OpenEXR.MIPMAP_LEVELS,
            "ripmap": OpenEXR.RIPMAP_LEVELS,
        }
        whole = written(path, **tiles(names[kind]))
    check_exr_file(path)
    for length in (len(whole) - 1, len(whole) // 2, 200):
        refused(path, whole[:length])


def test_offsets_and_sizes_of_chunks(tmp_path):
    path = tmp_path / "a.exr"
    whole = written(path, "NO", 2)
    # Two offsets, then twice place and size of 2 * 3 * 20 bytes.
    table = len(whole) - 2 * 8 - 2 * (8 + 120)
    for offset in (0, 2**63, len(whole), len(whole) - 4):
        refused(path, whole[:table] + offset.to_bytes(8, "little") + whole[table + 8 :])
    for size in (121 + 128, 2**31 - 1, 2**32 - 1):
        at = table + 16 + 4
        refused(path, whole[:at] + size.to_bytes(4, "little") + whole[at + 4 :])


def test_chunks_that_are_mixed_up(tmp_path):
    path = tmp_path / "a.exr"
    whole = written(path, "NO", 2)
    table = len(whole) - 2 * 8 - 2 * (8 + 120)
    first, second, after = whole[table : table + 8], whole[table + 8 : table + 16], table + 16
    refused(path, whole[:table] + second + first + whole[after:])
    refused(path, whole[:after] + (7).to_bytes(4, "little") + whole[after + 4 :])


def test_lines_from_below(tmp_path):
    path = tmp_path / "a.exr"
    written(path, "ZIP", 40, lineOrder=OpenEXR.DECREASING_Y)
    check_exr_file(path)


@pytest.mark.parametrize("bit", range(8))
def test_damaged_headers_are_refused_or_left_to_mitsuba(tmp_path, bit):
    path = tmp_path / "a.exr"
    whole = written(path, "ZIP", 4)
    for at in range(4, 360):
        data = bytearray(whole)
        data[at] ^= 1 << bit
        path.write_bytes(data)
        checked(lambda: check_exr_file(path))


def test_other_files_are_left_to_mitsuba(tmp_path):
    check_exr_file(tmp_path / "none.exr")
    check_exr_file(tmp_path)
    (tmp_path / "a.exr").write_bytes(b"no image")
    check_exr_file(tmp_path / "a.exr")


def test_pixels_that_are_not_numbers_are_refused(mi, tmp_path):
    pixels = np.ones((4, 8, 3), np.float32)
    OpenEXR.File({}, {"RGB": pixels}).write(str(tmp_path / "sky.exr"))
    room = {
        "type": "scene",
        "integrator": {"type": "path"},
        "camera": {"type": "perspective"},
        "sky": {"type": "envmap", "filename": str(tmp_path / "sky.exr")},
    }
    load_scene(room)
    pixels[1, 2, 0], pixels[3, 3] = np.nan, np.inf
    OpenEXR.File({}, {"RGB": pixels}).write(str(tmp_path / "sky.exr"))
    with pytest.raises(LumitreeError, match=r"the emitter sky has \d+ of \d+ values in 'data'"):
        load_scene(room)


def test_a_texture_that_is_cut_off_is_refused(mi, tmp_path):
    path = tmp_path / "a.exr"
    whole = written(path)
    texture = (
        '<texture type="bitmap" name="reflectance">'
        '<string name="filename" value="a.exr"/></texture>'
    )
    lamp = tmp_path / "lamp.xml"
    lamp.write_text(scene(sphere("a", 1, inside=f'<bsdf type="diffuse">{texture}</bsdf>{AREA}')))
    assert load_luminaire(lamp).num_emitters == 1
    path.write_bytes(whole[:-9])
    with pytest.raises(LumitreeError, match=r"a\.exr is a damaged OpenEXR image: it is cut off"):
        load_luminaire(lamp)
