"""Every reader with some inputs."""

import collections
import json
import os

import pytest

from fuzz import assets, gldf, json_trees, models, photometric, tables, xml_trees
from fuzz.reader import generator
from support.damage import damaged

SEED = 1
INPUTS = int(os.environ.get("LUMITREE_FUZZ_INPUTS", "0"))
MODULES = (assets, photometric, gldf, models, tables)
READERS = {reader.name: reader for module in MODULES for reader in module.READERS}


@pytest.mark.parametrize("name", READERS)
def test_inputs_are_read_or_refused_in_a_line(name, mi, tmp_path):
    reader, count = READERS[name], INPUTS or READERS[name].in_suite
    # None in full among few inputs: it takes seconds.
    full_share = reader.full_share if INPUTS else 0.0
    kinds = collections.Counter(
        reader.outcome(SEED, number, tmp_path, full_share) for number in range(count)
    )
    # Changes reach the code behind the first checks, and are noticed.
    assert kinds["accepted"] > count / 20
    assert kinds["refused"] > count / 20


@pytest.mark.slow
@pytest.mark.parametrize("name", ["asset", "ies", "tm25", "gldf", "obj", "gltf"])
def test_accepted_inputs_can_be_rendered(name, mi, tmp_path):
    kinds = [READERS[name].outcome(SEED + 1, number, tmp_path, 1.0) for number in range(30)]
    assert kinds.count("full") > 1


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
    xml, lines = b"<a x='1'><b>2</b><c y='3'/></a>", b"1 2 3\n4 5 6"
    for changed, content in ((xml_trees.changed, xml), (damaged, lines)):
        assert len({changed(content, generator("text", SEED, n)) for n in range(50)}) > 40
