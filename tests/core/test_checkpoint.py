"""Checkpoints: restored exactly, refused for another job and where damaged."""

import numpy as np
import pytest

from lumitree.core import checkpoint as module
from lumitree.core.checkpoint import Checkpoint, OtherJobError, read_checkpoint
from lumitree.core.files import WriteError
from lumitree.errors import LumitreeError, LumitreeWarning

INPUTS = {"seed": 3, "config": {"rays": 5, "law": "linear"}, "lamp": "f" * 64}
ARRAYS = {"weights": np.arange(30000, dtype=np.float32), "steps": np.array(7)}


def checkpoint(folder, inputs=INPUTS):
    return Checkpoint(folder / "bake.npz", inputs, "bake")


@pytest.fixture
def saved(tmp_path):
    assert checkpoint(tmp_path).load() is None
    checkpoint(tmp_path).save(ARRAYS)
    return tmp_path


@pytest.mark.parametrize("name", ["a [1] & 100%", "Zoë (灯)"])
def test_arrays_are_restored_in_a_folder_of_any_name(tmp_path, name):
    checkpoint(tmp_path / name).save(ARRAYS)
    found = checkpoint(tmp_path / name).load()
    assert found.keys() == ARRAYS.keys()
    for key, array in ARRAYS.items():
        assert found[key].dtype == array.dtype
        np.testing.assert_array_equal(found[key], array)
    inputs, _ = read_checkpoint(tmp_path / name / "bake.npz")
    assert {key: inputs[key] for key in INPUTS} == INPUTS


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (INPUTS | {"seed": 4}, "seed 3 -> 4"),
        (INPUTS | {"config": {"rays": 5, "law": "exponential"}}, "config.law linear"),
        (INPUTS | {"lamp": "e" * 64}, "lamp"),
        ({"seed": 3}, "config"),
    ],
)
def test_other_jobs_are_refused_with_what_differs(saved, other, named):
    with pytest.raises(OtherJobError, match="unfinished bake with other inputs") as refusal:
        checkpoint(saved, other).load()
    assert named in str(refusal.value)
    assert str(refusal.value).isprintable()


def test_another_version_of_lumitree_is_another_job(saved, monkeypatch):
    monkeypatch.setattr(module, "__version__", "0.0.1")
    with pytest.raises(OtherJobError, match="lumitree"):
        checkpoint(saved).load()


@pytest.mark.parametrize("damage", ["empty", "cut", "text", "flipped", "plain"])
def test_damaged_files_are_refused(saved, damage):
    path = saved / "bake.npz"
    whole = path.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
    damages = {"empty": b"", "cut": whole[:middle], "text": b"no", "flipped": flipped}
    if damage == "plain":
        np.savez(path, **ARRAYS)
    else:
        path.write_bytes(damages[damage])
    with pytest.raises(LumitreeError, match="remove it to start again") as refusal:
        checkpoint(saved).load()
    assert str(refusal.value).isprintable()


def test_a_failed_save_keeps_the_one_before_and_warns_once(saved, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    job = checkpoint(saved)
    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(WriteError, match="No space left"):
        job.save({})
    with pytest.warns(LumitreeWarning, match="cannot be continued if it is killed"):
        job.try_save({})
    # Warnings are errors here.
    job.try_save({})
    monkeypatch.undo()
    np.testing.assert_array_equal(job.load()["weights"], ARRAYS["weights"])


def test_offers_are_saved_once_in_a_while(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    job = checkpoint(tmp_path)
    saved = []
    monkeypatch.setattr(job, "save", lambda arrays: saved.append(now[0]))

    def offers():
        job.offer(dict)
        return len(saved)

    assert offers() == 0
    now[0] += 31
    assert offers() == 1
