"""Text from files in messages."""

from lumitree.errors import shown, shown_names


def test_shown_text_is_one_short_line():
    assert shown("plain é") == "plain é"
    assert shown("\x1b[31mred\n\ud800") == "?[31mred??"
    assert shown("x" * 1000, 10) == "x" * 9 + "…"
    assert shown("x" * 10, 10) == "x" * 10


def test_shown_names_are_not_all():
    assert shown_names([]) == "none with a name"
    assert shown_names(["a", "b\n"]) == "a, b?"
    many = shown_names(["x" * 1000] * 5000)
    assert many.endswith("and 4988 more")
    assert len(many) < 600
