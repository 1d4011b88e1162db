"""Sizes of the project beside the most that it may have. `make budget` prints them.

A commit that needs more raises a number of `LINES`, `FILES` or `OTHERS`, and its message says why.
"""

import ast
import re
import statistics
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src/lumitree"

# Lines of Python by package of `src/lumitree`; "" are the modules beside the packages.
LINES = {
    "": 420,
    "asset": 2_800,
    "cli": 1_900,
    "core": 4_900,
    "exports": 3_600,
    "fit": 5_820,
    "formats": 4_100,
    "lamp": 10_369,
    "many": 620,
    "measure": 6_855,
    "octree": 1_050,
    "rendering": 10_000,
    "trace": 1_900,
    "viewer": 1_965,
}
FILES = 220
OTHERS = {
    "lines of tests": 43_460,
    "lines of benchmarks": 10_000,
    "words of docs by hand": 45_000,
    "lines of README.md": 90,
    "files that use the word gain": 12,
    "lines with Any": 195,
    "private functions used once": 326,
}


def modules() -> list[Path]:
    """All Python files of `src/lumitree`."""
    return sorted([*SOURCE.rglob("*.py"), *SOURCE.rglob("*.pyi")])


def lines_by_package() -> dict[str, int]:
    """Lines of `src/lumitree` by package."""
    found: Counter[str] = Counter()
    for path in modules():
        parts = path.relative_to(SOURCE).parts
        found[parts[0] if len(parts) > 1 else ""] += _lines(path)
    return dict(found)


def others() -> dict[str, int]:
    """Measures of the names of `OTHERS`."""
    texts = [path.read_text(encoding="utf-8") for path in modules()]
    pages = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *(ROOT / "docs").rglob("*.md")]
    pages = [page for page in pages if not {"generated", "_build"} & set(page.parts)]
    return {
        "lines of tests": sum(map(_lines, _tests())),
        "lines of benchmarks": sum(map(_lines, (ROOT / "benchmarks").rglob("*.py"))),
        "words of docs by hand": sum(len(page.read_text("utf-8").split()) for page in pages),
        "lines of README.md": _lines(ROOT / "README.md"),
        "files that use the word gain": sum(bool(re.search(r"\bgain\b", t)) for t in texts),
        "lines with Any": sum(
            bool(re.search(r"\bAny\b", line)) and "import" not in line
            for text in texts
            for line in text.splitlines()
        ),
        "private functions used once": _used_once(texts),
    }


def _tests() -> Iterator[Path]:
    yield from (ROOT / "tests").rglob("*.py")
    yield from (ROOT / "integrations").rglob("test_*.py")


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def _used_once(texts: list[str]) -> int:
    """Private functions and methods whose name occurs once beside its definition."""
    names: Counter[str] = Counter(name for text in texts for name in re.findall(r"\b_\w+", text))
    private = [
        node.name
        for text in texts
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef)
        and node.name.startswith("_")
        and not node.name.startswith("__")
    ]
    return sum(names[name] == 2 for name in private)


if __name__ == "__main__":
    by_package = lines_by_package()
    for name, lines in sorted(by_package.items()):
        print(f"{lines:7,} of {LINES.get(name, 0):7,}  {name or 'modules beside the packages'}")
    sizes = [_lines(path) for path in modules()]
    print(f"{sum(sizes):7,} of {sum(LINES.values()):7,}  lines of src/lumitree")
    print(f"{len(sizes):7,} of {FILES:7,}  files, of {statistics.median(sizes):.0f} lines (median)")
    for name, value in others().items():
        print(f"{value:7,} of {OTHERS[name]:7,}  {name}")
