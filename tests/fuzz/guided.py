"""`python -m tests.fuzz.guided READER`: inputs that atheris finds, guided by coverage.

atheris is not among the dependencies: `pip install atheris`. Its first inputs are those of the
reader; it stops at the first failure, whose file it keeps in the current folder.
"""

import argparse
import sys
import tempfile
from pathlib import Path

# Tests import their packages by themselves.
sys.path.insert(0, str(Path(__file__).parents[1]))

import atheris

# Files of the readers of one file.
FILES = {
    "asset": "lamp.lumitree",
    "ies": "lamp.ies",
    "ldt": "lamp.ldt",
    "tm25": "lamp.ray",
    "tm33": "lamp.tm33",
    "gldf": "lamp.gldf",
    "gltf": "lamp.glb",
    "placements": "lights.toml",
    "points": "points.csv",
}
_FIRST, _MAX_BYTES = 200, 1 << 14


def main() -> None:
    """Run atheris for some seconds."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.guided", description=__doc__)
    parser.add_argument("reader", choices=FILES)
    parser.add_argument("--seconds", type=int, default=60, help="(default: 60)")
    parser.add_argument("--seed", type=int, default=1, help="of all inputs (default: 1)")
    options = parser.parse_args()
    with atheris.instrument_imports(include=["lumitree"]):
        from fuzz.reader import write_input
        from fuzz.registry import reader
        from support.damage import checked

        found = reader(options.reader)
    name = FILES[options.reader]
    with tempfile.TemporaryDirectory() as work:
        folder, corpus = Path(work) / "input", Path(work) / "corpus"
        folder.mkdir()
        corpus.mkdir()
        for number in range(_FIRST):
            write_input(found, options.seed, number, folder)
            # A reader of models makes files of other names, too.
            if (folder / name).exists():
                (folder / name).rename(corpus / str(number))

        def test_one(data: bytes) -> None:
            (folder / name).write_bytes(data)
            checked(lambda: found.use(found.read(folder)))

        limits = [f"-max_total_time={options.seconds}", f"-max_len={_MAX_BYTES}"]
        limits += [f"-seed={options.seed}", "-timeout=60", "-rss_limit_mb=4096"]
        atheris.Setup([sys.argv[0], *limits, str(corpus)], test_one)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
