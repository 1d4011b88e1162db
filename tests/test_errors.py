"""Text from files in messages."""

import pytest

from lumitree.errors import LumitreeError, explained, shown, shown_names


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


@explained
def failing(error):
    raise error


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[Texture] Texture::mean(): not implemented!", "Texture::mean(): not implemented!"),
        ("[area.cpp:12] no  shape\nat all", "no shape at all"),
        ("❌ [BitmapTextureImpl[uint8]] eval(): T[ a = [1], b ] is grey!", "eval(): T is grey!"),
        ('[parser.cpp:7] At "a": Traceback (most recent call last):\n'
         'LumitreeError: the file is bad\nmore', "the file is bad"),
    ],
)  # fmt: skip
def test_mitsubas_exceptions_are_one_line(text, expected):
    with pytest.raises(LumitreeError) as caught:
        failing(RuntimeError(text))
    assert str(caught.value) == f"Mitsuba stopped: {expected}"


def test_what_dr_jit_wraps_is_found():
    wrapper = RuntimeError("drjit.while_loop(): error (see above).")
    wrapper.__cause__ = RuntimeError("[Texture] not implemented!")
    with pytest.raises(LumitreeError, match="Mitsuba stopped: not implemented!"):
        failing(wrapper)


@pytest.mark.parametrize(
    "error",
    [
        RuntimeError("a mistake in lumitree"),
        RuntimeError("jit_var_gather(): attempted to gather from an empty array!"),
        RuntimeError("[parser.cpp:7] Traceback (most recent call last):\nAttributeError: 'x'"),
        ValueError("[Texture] no"),
    ],
)
def test_mistakes_in_the_program_stay_visible(error):
    with pytest.raises(type(error)) as caught:
        failing(error)
    assert caught.value is error
