"""Find sentences that break the rule of language: python tools/check_language.py [PATH ...]

No sentence of a docstring, comment, message or page contains `that of` or `those of`, or begins
with `What` or `Of`, unless it is a question: name the thing again. CONTRIBUTING.md has the reason.
"""

import ast
import io
import json
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Everything that is written by hand. Generated tables, in benchmarks/results, are not.
CHECKED = [
    *("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "SECURITY.md"),
    *("src", "docs", "benchmarks", "examples", "integrations", "tests", "tools"),
]
# The tests of this check contain sentences that break the rule.
EXCLUDED = ("docs/_build", "docs/generated", "benchmarks/results", "tests/test_check_language.py")
SUFFIXES = (".py", ".md", ".ipynb")
_POINTER = r"\b(?:that|those)\s+of\b"
# After the end of a sentence, in a new paragraph, item, cell or heading.
_BEGINNING = r"(?:\A|(?<=[.!?:;]\s)|(?<=\n\n)|(?<=[|*#-] ))\**(?:What|Of)\b"
_END = re.compile(r"[.!?](?=\s|\Z)|\n\n|\Z")


def violations(text: str) -> Iterator[tuple[int, str]]:
    """Line, counted from 0, and passage of each break of the rule in a text."""
    text = re.sub(r"\n[ \t]+", "\n", re.sub(r"`[^`\n]*`", "`x`", text))
    found = [*re.finditer(_POINTER, text, re.IGNORECASE)]
    for match in re.finditer(_BEGINNING, text):
        end = _END.search(text, match.end())
        if end is not None and end.group() != "?":
            found.append(match)
    for match in found:
        passage = text[max(0, match.start() - 40) : match.end() + 40]
        yield text.count("\n", 0, match.start()), re.sub(r"\s+", " ", passage).strip()


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """First line and text of each docstring, message, block of comments or page of a file."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        yield from _strings(ast.parse(source))
        yield from _comments(source)
        return
    pages = [source]
    if path.suffix == ".ipynb":
        cells = json.loads(source)["cells"]
        pages = ["".join(each["source"]) for each in cells if each["cell_type"] == "markdown"]
    for page in pages:
        yield 1, re.sub(r"```.*?```", lambda m: "\n" * m[0].count("\n"), page, flags=re.DOTALL)


def _strings(tree: ast.AST) -> Iterator[tuple[int, str]]:
    inside: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            inside |= {id(each) for each in node.values}
            parts = (each.value if isinstance(each, ast.Constant) else "x" for each in node.values)
            yield node.lineno, "".join(map(str, parts))
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in inside
        ):
            yield node.lineno, node.value


def _comments(source: str) -> Iterator[tuple[int, str]]:
    block: list[str] = []
    start = last = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        if token.start[0] != last + 1 and block:
            yield start, "\n".join(block)
            block = []
        last = token.start[0]
        start = start if block else last
        block.append(token.string.lstrip("#: "))
    if block:
        yield start, "\n".join(block)


def files(path: Path) -> list[Path]:
    """The files below a path that are checked."""
    found = [path] if path.is_file() else sorted(each for each in path.rglob("*.*"))
    excluded = [ROOT / each for each in EXCLUDED]
    return [
        each
        for each in found
        if each.suffix in SUFFIXES and not any(map(each.is_relative_to, excluded))
    ]


def main(arguments: list[str]) -> int:
    """Print what is found; the exit status."""
    count = 0
    for path in [Path(each).resolve() for each in arguments] or [ROOT / each for each in CHECKED]:
        for file in files(path):
            for first, text in texts(file):
                for line, passage in violations(text):
                    count += 1
                    print(f"{file.relative_to(ROOT)}:{first + line}: ... {passage} ...")
    if count:
        print(f"{count} sentences with `that of`, `those of`, or `What` or `Of` at the beginning")
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
