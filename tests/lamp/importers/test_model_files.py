"""Files that a model names are found in its folder only, and its images have limits."""

import os
import struct

import pytest

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.importers.model_files import Images, ModelFolder

FILES = ("half.png", "Tex/half.png", "Tex/x/half.png")
# Other names, and the file of these that is taken for each.
TAKEN = {
    "/etc/half.png": 0,
    "../half.png": 0,
    "a/../../half.png": 0,
    "C:\\lamp\\half.png": 0,
    "C:half.png": 0,
    "..\\half.png": 0,
    "file:///etc/half.png": 0,
    "https://example.org/HALF.png": 0,
    "\\\\host\\half.png": 0,
    "lost/half.png": 0,
    "C:\\work\\tex\\half.png": 1,
    "/home/me/lamp/tex/X/Half.PNG": 2,
}
ABSENT = ("", "none.png", "/etc/passwd", "../secret.txt", "data:text/plain,x", "a\0b", "\ud800.png")
ABSENT += ("x" * 300, "a/" * 3000 + "b", "\x1b[31m.png", "file:///etc/passwd", "C:\\secret.txt")


@pytest.fixture
def folder(tmp_path):
    """The folder of a model; another file is outside of it."""
    (tmp_path / "secret.txt").write_text("secret")
    for name in FILES:
        (tmp_path / "model" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "model" / name).write_text(name)
    return ModelFolder(tmp_path / "model" / "lamp.obj")


@pytest.mark.parametrize("name", FILES)
def test_names_in_the_folder_are_taken_as_they_are(folder, name):
    assert folder.find(name, "a").read_text() == name


@pytest.mark.parametrize("name", TAKEN)
def test_the_file_with_most_of_the_last_components_is_taken_once_warned(folder, name):
    with pytest.warns(LumitreeWarning, match="in the model's folder is taken") as caught:
        found = [folder.find(name, "a") for _ in range(2)]
    assert len(caught) == 1
    assert [path.read_text() for path in found] == [FILES[TAKEN[name]]] * 2


@pytest.mark.parametrize("name", ABSENT)
def test_nothing_outside_the_folder_is_found(folder, name):
    assert folder.find(name, "a") is None


def test_links_are_followed_within_the_folder_only(folder, tmp_path):
    os.symlink("half.png", tmp_path / "model" / "inside.png")
    os.symlink(tmp_path / "secret.txt", tmp_path / "model" / "outside.png")
    os.symlink(tmp_path, tmp_path / "model" / "linked")
    assert folder.find("inside.png", "a").read_text() == "half.png"
    for name in ("outside.png", "linked/secret.txt"):
        with pytest.raises(LumitreeError, match="link out of the model's folder"):
            folder.find(name, "a")


SIDE = 64


def progressive(scans, between=b""):
    """A grey JPEG file of many scans, each of which leaves all coefficients 0."""

    def segment(marker, data):
        return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data

    def table(kind, symbol):
        return segment(0xC4, bytes([kind, 1, *[0] * 15, symbol]))

    def scan(first, last, data):
        return segment(0xDA, bytes([1, 1, 0, first, last, 0])) + data + between

    # The codes: no difference of the mean, and a run of 16384 blocks without detail.
    means, run = bytes((SIDE // 8) ** 2 // 8), b"\0\1"
    size = struct.pack(">BHHB", 8, SIDE, SIDE, 1) + bytes([1, 0x11, 0])
    head = segment(0xDB, b"\0" + b"\1" * 64) + segment(0xC2, size) + table(0, 0) + table(16, 0xE0)
    data = scan(0, 0, means) + scan(1, 63, run) * (scans - 1)
    return b"\xff\xd8" + head + data + b"\xff\xd9"


def decoded(data):
    return Images().decoded("a", lambda: data, "a.jpg", ("JPEG", "PNG"))


def test_progressive_images_have_a_limit_of_scans():
    """One of 424 kB with thousands of scans took 23 s."""
    assert (decoded(progressive(100)).pixels == [128, 128, 128, 255]).all()
    with pytest.raises(LumitreeError, match=r"^a.jpg has more than 100 scans; save it as a PNG"):
        decoded(progressive(101))
    # Padding before markers, and markers without a length, hide none.
    for between in (b"\xff\xff", b"\xff\x01", b"\xff\xd0", b"\xff\0"):
        with pytest.raises(LumitreeError, match="more than 100 scans"):
            decoded(progressive(101, between))
