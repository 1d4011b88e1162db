"""The saved state of an unfinished bake: restored exactly, or refused with one line."""

import dataclasses
import json

import numpy as np
import pytest

from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError
from lumitree.fit.octree.config import OctreeConfig, RefineConfig, SplitConfig
from support.field_rays import FieldRays, truth_and_start

# As of the fields of `truth_and_start`.
CONFIG = OctreeConfig(l_max=1, refine=RefineConfig(rays=1 << 10))


def state_file(folder, config=CONFIG, fingerprint="abc", seed=0):
    from lumitree.fit.octree.rays import Subject
    from lumitree.fit.octree.saved_state import StateFile

    return StateFile(
        folder, Subject("lamp", fingerprint, LocalFrame(np.ones(3), np.eye(4))), config, seed
    )


def refiner(mi, seed=3):
    from lumitree.fit.octree.descent import Refiner

    truth, start = truth_and_start("linear", seed=seed)
    return Refiner(start, FieldRays(mi, truth), 1.0, CONFIG.refine, SplitConfig())


@pytest.fixture
def saved(mi, tmp_path):
    """A refiner after a step, whose state is saved with its first field as the best."""
    descent = refiner(mi)
    first = descent.field.copy()
    descent.advance(0.0)
    state_file(tmp_path).save(descent.state(), first, 12.5, 345, 6.75)
    return descent, first


def test_a_saved_state_is_restored(mi, saved, tmp_path):
    descent, first = saved
    # A budget may be another.
    config = dataclasses.replace(CONFIG, time=None, rays=1000)
    state = state_file(tmp_path, config).load()
    assert (state.seconds, state.rays, state.max_radiance) == (12.5, 345, 6.75)
    other = refiner(mi, seed=5)
    other.restore(state.arrays)
    best = {name: state.arrays[f"best_{name}"] for name in first.arrays()}
    for found, expected in ((best, first), (other.field.arrays(), descent.field)):
        for name, value in expected.arrays().items():
            assert np.array_equal(found[name], value)
    for name, value in descent.state().items():
        assert np.array_equal(other.state()[name], value), name


def test_without_a_file_there_is_no_state(mi, tmp_path):
    assert state_file(tmp_path).load() is None


@pytest.mark.parametrize(
    "other",
    [
        {"fingerprint": "abd"},
        {"seed": 1},
        {"config": dataclasses.replace(CONFIG, split=SplitConfig(max_leaves=7))},
    ],
)
def test_states_of_other_bakes_are_refused(saved, tmp_path, other):
    with pytest.raises(LumitreeError, match="unfinished bake of another") as refusal:
        state_file(tmp_path, **other).load()
    assert "\n" not in str(refusal.value)


def test_states_of_another_format_are_refused(saved, tmp_path):
    from lumitree.fit.octree.saved_state import STATE

    with np.load(tmp_path / STATE) as arrays:
        arrays = dict(arrays)
    record = json.loads(str(arrays["record"]))
    record["version"] -= 1
    arrays["record"] = np.array(json.dumps(record, sort_keys=True))
    np.savez(tmp_path / STATE, **arrays)
    with pytest.raises(LumitreeError, match="unfinished bake of another"):
        state_file(tmp_path).load()


@pytest.mark.parametrize("damage", ["empty", "cut", "text", "flipped"])
def test_damaged_states_are_refused(mi, tmp_path, damage):
    from lumitree.fit.octree.saved_state import STATE

    path = tmp_path / STATE
    np.savez(path, record=np.array("x"), cells=np.arange(30000))
    whole = path.read_bytes()
    middle = len(whole) // 2
    path.write_bytes(
        {
            "empty": b"",
            "cut": whole[:middle],
            "text": b"not a state at all",
            "flipped": whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :],
        }[damage]
    )
    with pytest.raises(LumitreeError, match="is damaged") as refusal:
        state_file(tmp_path).load()
    assert "\n" not in str(refusal.value)
    assert str(path) in str(refusal.value)


def changed(name, value):
    def change(arrays):
        arrays[name] = value(arrays[name])

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda arrays: arrays.pop("best_cells"), "best_cells is missing"),
        (lambda arrays: arrays.pop("seconds"), "seconds is missing"),
        (changed("seconds", lambda _: np.array("x")), "seconds is <U1"),
        (changed("rays", lambda value: np.array([value])), "rays is int64 [(]1,[)]"),
        (changed("coefficient_mean", lambda values: values[:-1]), "coefficient_mean is float32"),
        (changed("log_density", lambda values: values * np.nan), "not finite"),
        (changed("levels", lambda values: values + 9), "outside the tree"),
        (changed("cells", lambda values: values - 5), "outside the tree"),
        (changed("max_radiance", lambda value: -value), "out of range"),
        (changed("levels", lambda _: np.array(3)), "expected"),
    ],
)
def test_states_of_wrong_arrays_are_refused(saved, tmp_path, change, message):
    from lumitree.fit.octree.saved_state import STATE

    with np.load(tmp_path / STATE) as stored:
        arrays = dict(stored)
    change(arrays)
    np.savez(tmp_path / STATE, **arrays)
    with pytest.raises(LumitreeError, match=f"is damaged .*{message}.*remove its folder"):
        state_file(tmp_path).load()
