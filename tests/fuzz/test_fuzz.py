"""Every reader with some inputs: they are read, or refused in a line."""

import collections
import contextlib
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from fuzz.readers import READERS
from support.damage import checked

INPUTS = int(os.environ.get("LUMITREE_FUZZ_INPUTS", "0"))


@contextlib.contextmanager
def at_most(memory):
    """Limit the address space to its present size and so many bytes more, on Linux."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (ImportError, OSError):
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def outcomes(name, count, folder, use=False):
    """How many inputs were accepted and refused."""
    reader, found = READERS[name], collections.Counter()

    @settings(
        max_examples=count,
        derandomize=not INPUTS,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, Phase.shrink),
    )
    @given(files=reader.inputs)
    def run(files):
        for file, content in files.items():
            (folder / file).write_bytes(content)

        def read():
            with at_most(reader.memory):
                value = reader.read(folder / next(iter(files)))
                reader.check(value)
            if use and reader.use:
                reader.use(value)

        message = checked(read)
        assert "not enough memory" not in (message or "")
        found["accepted" if message is None else "refused"] += 1

    run()
    return found


@pytest.mark.parametrize("name", READERS)
def test_inputs_are_read_or_refused_in_a_line(name, mi, tmp_path):
    count = INPUTS or READERS[name].count
    found = outcomes(name, count, tmp_path)
    # Changes reach the code behind the first checks, and are noticed.
    assert found["accepted"] > count / 20
    assert found["refused"] > count / 20


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, reader in READERS.items() if reader.use])
def test_accepted_inputs_can_be_rendered(name, mi, tmp_path):
    assert outcomes(name, 40, tmp_path, use=True)["accepted"] > 1
