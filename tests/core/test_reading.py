"""Files that are missing, unreadable or hostile: one line each."""

import contextlib
import os
from pathlib import Path

import numpy as np
import pytest

from lumitree.core.reading import label, parse_json, read_arrays, read_bytes
from lumitree.errors import LumitreeError


def refusal(function, *arguments):
    with pytest.raises(LumitreeError) as caught:
        function(*arguments)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 1000
    return message


def test_a_file_is_read(tmp_path):
    (tmp_path / "a").write_bytes(b"\x00\xffabc")
    assert read_bytes(tmp_path / "a", "a file", 5) == b"\x00\xffabc"
    assert read_bytes(str(tmp_path / "a"), "a file", 5) == b"\x00\xffabc"


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "file").write_bytes(b"123456")
    for path, message in (
        (tmp_path / "none", "does not exist; expected a thing"),
        (tmp_path, "is a folder; expected a thing"),
        (tmp_path / "pipe", "is not a regular file"),
        ("/dev/zero", "is not a regular file"),
        (tmp_path / "loop", "cannot read"),
        (tmp_path / "file" / "below", "cannot read"),
        (tmp_path / "file", "is larger than 5 bytes, the limit for a thing"),
        (tmp_path / ("x" * 300), "cannot read"),
        ("a\x00b", "is not a file name"),
    ):
        if not str(path).startswith("/dev") or Path(path).exists():
            assert message in refusal(read_bytes, path, "a thing", 5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        (b"\xff\xfe{}", "not valid JSON"),
        ('{"a": 1, "a": 2}', "two members of one name"),
        ("NaN", "holds NaN"),
        ("[" * 100_000, "too deep"),
        ('{"a":' * 100_000 + "1" + "}" * 100_000, "too deep"),
    ],
)
def test_bad_json_is_refused(text, message):
    assert message in refusal(parse_json, text)


def test_json_is_parsed():
    assert parse_json('{"a": [1, 2.5, "é", null, true]}') == {"a": [1, 2.5, "é", None, True]}
    assert parse_json('{"é": 1e2}'.encode()) == {"é": 100.0}


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("lamps/große Lampe", "lamps/große Lampe"),
        ("a\nb\x1b[2J\ud800", "a?b?[2J?"),
        ("x" * 5000, "x" * 1000),
    ],
)
def test_labels_are_what_files_may_hold(name, kept):
    assert label(name) == kept


def test_arrays_are_read(tmp_path):
    np.savez(tmp_path / "a.npz", one=np.arange(3), two=np.array("text"))
    assert read_arrays(tmp_path / "a.npz").keys() == {"one", "two"}
    assert read_arrays(tmp_path / "a.npz", "one")["one"].tolist() == [0, 1, 2]
    assert "damaged (KeyError)" in refusal(read_arrays, tmp_path / "a.npz", "three")
    assert "missing or no regular file" in refusal(read_arrays, tmp_path / "none.npz")
    assert "missing or no regular file" in refusal(read_arrays, tmp_path)


def test_archives_that_are_larger_in_memory_than_on_disk_have_a_limit(tmp_path, monkeypatch):
    monkeypatch.setattr("lumitree.core.reading._MAX_UNPACKED", 2**20)
    arrays = {f"part{i}": np.zeros(2**16) for i in range(2)}
    np.savez_compressed(tmp_path / "small.npz", **arrays)
    assert (tmp_path / "small.npz").stat().st_size < 2**17
    assert "1 MiB in memory" in refusal(read_arrays, tmp_path / "small.npz")
    # Stored without compression, it is as large as it says.
    np.savez(tmp_path / "large.npz", **arrays)
    assert read_arrays(tmp_path / "large.npz")["part1"].shape == (2**16,)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_damaged_archives_are_refused(tmp_path, save):
    path = tmp_path / "a.npz"
    save(path, one=np.arange(50), two=np.array("text"), three=np.ones((2, 3)))
    whole = path.read_bytes()
    np.save(tmp_path / "array.npy", np.arange(3))
    np.save(tmp_path / "objects.npy", np.array([{}]), allow_pickle=True)
    others = [(tmp_path / name).read_bytes() for name in ("array.npy", "objects.npy")]
    huge = (tmp_path / "array.npy").read_bytes().replace(b"(3,)", b"(9999999999999,)")
    for content in (b"", b"x", b"text" * 99, whole[:-1], whole[: len(whole) // 2], huge, *others):
        path.write_bytes(content)
        refusal(read_arrays, path)
    loaded = 0
    random = np.random.default_rng(0)
    for _ in range(400):
        content = bytearray(whole)
        for place in random.integers(len(content), size=random.integers(1, 4)):
            content[place] = random.integers(256)
        path.write_bytes(content)
        with contextlib.suppress(LumitreeError):
            read_arrays(path)
            loaded += 1
    # Most damage is noticed; what is not may only be in the numbers.
    assert loaded < 200
