"""The check of language finds what it is for. `make lint` runs it on the whole project."""

import pytest
from check_language import texts, violations


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("κ is that of the farthest distance.", [0]),
        ("The curve, and\n    those\n    of others.", [1]),
        ("What is left over.", [0]),
        ("Emission. Of all lamps, this one.", [0]),
        ("A list:\n\n* What it is.\n* Of the rest, nothing.", [2, 3]),
        ("| What | is |", [0]),
        ("What is it? A lamp.", []),
        ("Write `that of` never.", []),
        ("It says what it is, of course.", []),
    ],
)
def test_a_text(text, lines):
    assert sorted(line for line, _ in violations(text)) == lines


def test_all_texts_of_a_module(tmp_path):
    path = tmp_path / "module.py"
    path.write_text(
        '"""What this is."""\n\n# The flux and\n# those of others.\n\nerror = f"{1} is that of a"\n'
    )
    found = [first + line for first, text in texts(path) for line, _ in violations(text)]
    assert sorted(found) == [1, 4, 6]
