"""Every reader with some inputs; the runner has more, and limits time and memory."""

import collections
import dataclasses
import json

import pytest

from fuzz import json_trees, words, xml_trees
from fuzz.reader import Reader, generator, outcome_of, write_input
from fuzz.registry import NAMES, reader
from fuzz.runner import Run, part_of, run, without_values
from lumitree.errors import LumitreeError
from support.slow import slow

SEED = 1


@pytest.mark.parametrize("name", NAMES)
def test_inputs_are_read_or_refused_in_a_line(name, mi, tmp_path):
    if name == "run":
        pytest.importorskip("jax")
    # None in full, which takes seconds.
    found, counts = dataclasses.replace(reader(name), full_share=0), collections.Counter()
    for number in range(found.in_suite):
        outcome = outcome_of(found, SEED, number, tmp_path)
        assert outcome.kind != "failed", f"{number}: {outcome.message}\n{outcome.detail}"
        counts[outcome.kind] += 1
    # Changes reach what is behind the first checks, and are seen.
    assert counts["accepted"] > found.in_suite / 20
    assert counts["refused"] > found.in_suite / 20 or name in ("record", "settings")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["asset", "ies", "tm25", "gldf", "obj", "gltf"])
def test_what_is_accepted_can_be_shown(name, mi, tmp_path):
    found, counts = dataclasses.replace(reader(name), full_share=1), collections.Counter()
    for number in range(30):
        outcome = outcome_of(found, SEED + 1, number, tmp_path)
        assert outcome.kind != "failed", f"{number}: {outcome.message}\n{outcome.detail}"
        counts[outcome.kind] += 1
    assert counts["full"] > 1


@pytest.mark.parametrize("name", NAMES)
def test_an_input_depends_on_its_number_alone(name, mi, tmp_path):
    found = reader(name)
    if name == "layers":
        pytest.skip("OpenEXR writes the time of day")
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
    write_input(found, SEED, 3, tmp_path / "first")
    write_input(found, SEED, 5, tmp_path / "second")
    for path in (tmp_path / "second").rglob("*"):
        if path.is_file():
            path.unlink()
    write_input(found, SEED, 3, tmp_path / "second")
    first, second = (
        {path.name: path.read_bytes() for path in (tmp_path / folder).rglob("*") if path.is_file()}
        for folder in ("first", "second")
    )
    assert first == second


def test_changed_texts_are_mostly_still_texts_of_their_kind():
    value = {"a": [1, 2.5, {"b": "c"}], "d": None}
    valid = 0
    for number in range(200):
        tree = json_trees.changed(value, generator("json", SEED, number))
        content = json_trees.written(tree)
        try:
            valid += json.loads(content) != value
        except (ValueError, RecursionError):
            continue
    assert valid > 100
    xml = b"<a x='1'><b>2</b><c y='3'/></a>"
    changed = {xml_trees.changed(xml, generator("xml", SEED, number)) for number in range(50)}
    assert len(changed) > 40
    lines = b"1 2 3\n4 5 6"
    assert len({words.changed(lines, generator("words", SEED, n)) for n in range(50)}) > 40


class BrokenError(Exception):
    """What a reader must not raise."""


def of_numbers(read):
    """A reader of files that hold their own random number."""
    return Reader(
        "ies",
        lambda rng: {"number": str(int(rng.integers(1000))).encode()},
        lambda folder: read(int((folder / "number").read_text())),
        in_suite=1,
    )


def test_failures_are_told_from_refusals(tmp_path):
    def refuse(_):
        raise LumitreeError("it is 3; expected 4")

    def long(_):
        raise LumitreeError("x" * 1001)

    def broken(_):
        raise BrokenError("no")

    def lines(_):
        raise LumitreeError("two\nlines")

    kinds = [
        outcome_of(of_numbers(read), SEED, 0, tmp_path).kind
        for read in (str, refuse, long, broken, lines)
    ]
    assert kinds == ["accepted", "refused", "failed", "failed", "failed"]


def test_runs_continue_and_count(tmp_path):
    path, said = tmp_path / "ies.json", []
    found = reader("ies")
    run(found, Run.open(path, "ies", SEED, {}), 30, 1, say=said.append)
    whole = Run.open(path, "ies", SEED, {})
    assert whole.done == [[0, 30]]
    assert sum(whole.counts.values()) == 30
    assert list(whole.todo(100, 40)) == [(30, 70), (70, 100)]
    run(found, whole, 50, 1, say=said.append)
    again = Run.open(path, "ies", SEED, {})
    assert again.done == [[0, 50]]
    assert sum(again.refusals.values()) == again.counts["refused"]
    alone = [outcome_of(found, SEED, number, tmp_path).kind for number in range(50)]
    assert again.counts == collections.Counter(alone)
    assert len(said) == 2


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("crash", "the process ended: -11"),
        ("exit", "the process ended: 3"),
        ("reserve", "MemoryError"),
        slow("hang", "the process ended: -27"),
    ],
)
def test_faults_are_failures_of_their_input(tmp_path, name, message):
    # Of this seed, all of these readers are at fault after the first input.
    found, seed, count = reader(name), 3, 4
    expected = []
    for number in range(count):
        write_input(found, seed, number, tmp_path)
        expected.append((tmp_path / "fault").read_text() == "yes")
    assert True in expected[1:]
    outcomes = part_of(found, seed, 0, count, tmp_path)
    assert [outcome["number"] for outcome in outcomes] == list(range(count))
    assert [outcome["kind"] == "failed" for outcome in outcomes] == expected
    assert all(message in each["message"] for each in outcomes if each["kind"] == "failed")
    traced = any("faults.py" in outcome.get("detail", "") for outcome in outcomes)
    assert traced == (name != "exit")


def test_messages_of_one_kind_are_equal():
    first = without_values("FOLDER/a.ies: line 12 is 'x', 1.5e-7 of [3, 4]")
    assert first == without_values("FOLDER/a.ies: line 7 is 'yy', -inf of [5, 12]")
    assert first != without_values("FOLDER/a.ies: line 7 is 'yy' or 2 of [5, 12]")
