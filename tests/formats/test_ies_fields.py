"""Fields of LM-63 whose meaning depends on the edition."""

import contextlib

import pytest

from lumitree.errors import LumitreeWarning
from lumitree.formats.ies import GENERATIONS, SIMULATED, read_ies, second_number, write_ies

ACCREDITED = "1.10000"


@pytest.mark.parametrize(
    ("text", "year", "factor", "generation", "remark"),
    [
        # A ballast-lamp photometric factor until 1991.
        ("0.9", 1986, 0.9, None, ""),
        ("0.9", 1991, 0.9, None, ""),
        (ACCREDITED, 1991, 1.1, None, ""),
        ("0", 1991, 1, None, "no factor"),
        ("-1", 1986, 1, None, "no factor"),
        # For future use, and 1.
        ("1", 1995, 1, None, ""),
        ("0.9", 1995, 0.9, None, "taken as a factor"),
        ("1.0", 2002, 1, None, ""),
        ("0", 2002, 1, None, ""),
        ("0.9", 2002, 1, None, "no meaning in LM-63-2002"),
        # The file generation type; a file without an edition may be of any.
        (ACCREDITED, 1986, 1, ACCREDITED, "taken as a file generation type"),
        ("1.00000", 1986, 1, "1.00000", ""),
        ("1.1", 1986, 1.1, None, ""),
        ("1", 2019, 1, None, ""),
        ("1.0", 2019, 1, None, ""),
        ("1.1", 2019, 1, ACCREDITED, ""),
        ("1.0001", 2019, 1, SIMULATED, ""),
        ("1.01010", 2019, 1, None, "no file generation type"),
        ("0.9", 2019, 1, None, "no file generation type"),
        *((code, 2019, 1, code, "") for code in GENERATIONS),
    ],
)
def test_the_number_after_the_ballast_factor(text, year, factor, generation, remark):
    found = second_number(text, float(text), year)
    assert (found.factor, found.generation) == (factor, generation)
    assert (remark in found.remark) == (found.remark != "") or found.remark == remark == ""


def text_of(first="IES:LM-63-2019", lumens="1000", factors="1 1.00010 10"):
    return (
        f"{first}\n[TEST] own\nTILT=NONE\n1 {lumens} 2 3 1 1 2 0.1 0.1 0\n{factors}\n"
        "0 45 90\n0\n9 8 7\n"
    )


def read(tmp_path, text):
    path = tmp_path / "lamp.ies"
    path.write_text(text)
    return read_ies(path)


@pytest.mark.parametrize("code", GENERATIONS)
def test_generation_types_are_read_and_written(tmp_path, code):
    lamp = read(tmp_path, text_of(factors=f"1 {code} 10"))
    assert lamp.generation == code
    assert lamp.details["file_generation_type"] == GENERATIONS[code]
    write_ies(tmp_path / "again.ies", lamp)
    # All five digits: programs compare the text.
    assert f"\n1.0 {code} 10.0\n" in (tmp_path / "again.ies").read_text()
    again = read_ies(tmp_path / "again.ies")
    assert (again.generation, again.watts) == (code, 10)


@pytest.mark.parametrize("watts", ["0", "-1", "1e10"])
def test_a_power_that_is_none(tmp_path, watts):
    lamp = read(tmp_path, text_of(factors=f"1 1 {watts}"))
    assert lamp.watts is None
    write_ies(tmp_path / "again.ies", lamp)
    assert read_ies(tmp_path / "again.ies").watts is None


@pytest.mark.parametrize(
    ("changes", "peak", "message"),
    [
        ({}, 18, None),
        ({"factors": "0.5 1 10"}, 9, None),
        ({"lumens": "-1"}, 18, None),
        ({"lumens": "-1", "factors": "0.5 1 10"}, 9, "absolute photometry and a ballast factor"),
        ({"factors": "1 0.5 10"}, 18, "0.5 is no file generation type"),
        ({"first": "IESNA:LM-63-2002", "factors": "1 0.5 10"}, 18, "0.5 has no meaning"),
        ({"first": "IESNA:LM-63-1995", "factors": "0.8 0.5 10"}, 7.2, "0.5 is taken as a factor"),
        ({"first": "IESNA91", "factors": "0.8 0.5 10"}, 7.2, None),
    ],
)
def test_factors_that_may_be_read_in_two_ways_are_said(tmp_path, changes, peak, message):
    """The product of candela multiplier, ballast factor and ballast-lamp photometric factor."""
    said = pytest.warns(LumitreeWarning, match=message) if message else contextlib.nullcontext()
    with said:
        lamp = read(tmp_path, text_of(**changes))
    assert lamp.at([0.0, -1, 0]) == pytest.approx(peak)
    assert (lamp.emitted_lumens is None) == (changes.get("lumens") == "-1")
