"""Tests of `lumitree.core.tables`."""

import pytest

from lumitree.core.tables import read_toml
from lumitree.errors import LumitreeError

DEEP = ".".join("a" * 11)


def read(folder, text):
    path = folder / "settings.toml"
    path.write_text(text, encoding="utf-8")
    return read_toml(path, "a TOML file")


@pytest.mark.parametrize(
    "text",
    [
        f"{DEEP} = 1",
        f"[{DEEP}]",
        f"x = [{{ {DEEP} = 1 }}]",
        DEEP.replace(".", " . ") + " = 1",
        f'x = """a"""" \n{DEEP} = 1\ny = ""',
        f'x = {{ y = """a"""", {DEEP} = 1, z = "" }}',
        f"x = {{ y = '''a'''', {DEEP} = 1, z = '' }}",
        f'x = "\\"" # "\n{DEEP} = 1',
        ".".join("a" * 20_000) + " = 1",
    ],
)
def test_a_key_of_too_many_parts_is_refused_before_it_is_parsed(tmp_path, text):
    """tomllib takes 1.7 GB for a key of 20,000 parts, 40 kB."""
    with pytest.raises(LumitreeError, match=r"has a key of more than 10 parts joined by dots; wr"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    "value",
    [f'"{DEEP}"', f"'{DEEP}'", f'"""\n{DEEP}"""', f"'''\n{DEEP}'''", f'"\\"{DEEP}"', f"1 # {DEEP}"],
)
def test_dots_within_texts_and_comments_divide_no_key(tmp_path, value):
    assert str(read(tmp_path, f"x = {value}")["x"]).strip('\n"') in (DEEP, "1")


def test_numbers_and_ten_parts_are_read(tmp_path):
    table = read(tmp_path, f"x = [{', '.join(['1.5'] * 100)}]\n" + DEEP[2:] + " = 1")
    assert table["x"] == [1.5] * 100
    assert table["a"]
