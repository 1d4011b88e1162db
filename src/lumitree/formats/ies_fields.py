"""Fields of IES LM-63 files whose meaning depends on the edition.

Sources: Ashdown, "Parsing the IESNA LM-63 photometric data file" (1998), for 1986 to 1995; Table 2
and sections 5.12 and 5.13 of ANSI/IES LM-63-19, as two programs that read it cite them, for the
file generation type.
"""

import dataclasses
import re

# The edition of a file that names none.
FIRST_EDITION = 1986
SIMULATED, UNDEFINED = "1.00010", "1.00001"
# Titles of Table 2 of LM-63-2019. Programs may show only them and their descriptions, and no other
# judgement of a file. The digits after the point are flags: accredited, interpolated, scaled,
# simulated, undefined.
GENERATIONS = {
    UNDEFINED: "Undefined",
    SIMULATED: "Computer Simulation",
    "1.00000": "Test at an unaccredited lab",
    "1.00100": "Test at an unaccredited lab that has been lumen scaled",
    "1.01000": "Test at an unaccredited lab with interpolated angle set",
    "1.01100": "Test at an unaccredited lab with interpolated angle set that has been lumen scaled",
    "1.10000": "Test at an accredited lab",
    "1.10100": "Test at an accredited lab that has been lumen scaled",
    "1.11000": "Test at an accredited lab with interpolated angle set",
    "1.11100": "Test at an accredited lab with interpolated angle set that has been lumen scaled",
}


def edition(head: str) -> int:
    """Year of the edition that the first line names, however it is spelt."""
    first = head.lstrip().partition("\n")[0].upper()
    year = r"[\s:_/-]*(\d{4}|\d{2})(?!\d)"
    match = re.search(rf"LM[\s_-]?63{year}", first) or re.search(rf"IES(?:NA)?{year}", first)
    if match is None:
        return FIRST_EDITION
    number = int(match[1])
    return number if number > 99 else number + (1900 if number >= 80 else 2000)


@dataclasses.dataclass(frozen=True)
class SecondNumber:
    """Meaning of the number after the ballast factor.

    `factor` is on the intensities, `generation` a key of `GENERATIONS`. `remark` says which of
    several readings is taken; it is empty if there is only one.
    """

    factor: float = 1.0
    generation: str | None = None
    remark: str = ""


def second_number(text: str, value: float, year: int) -> SecondNumber:
    """Meaning of the number after the ballast factor.

    It is the ballast-lamp photometric factor until 1991; for future use, and 1, in 1995 and 2002;
    and the file generation type since 2019. The year is `FIRST_EDITION` for a file that names no
    edition. `text` is the number as the file has it, with a decimal point.
    """
    code = _generation(text, value)
    if year > 2002:
        unknown = f"{value:g} is no file generation type of LM-63-2019; it is not used"
        return SecondNumber(generation=code, remark="" if code or value in (0, 1) else unknown)
    if year > 1995:
        unused = f"{value:g} has no meaning in LM-63-2002; it is not used"
        return SecondNumber(remark="" if code or value in (0, 1) else unused)
    if value == 1:
        return SecondNumber(generation=code if year == FIRST_EDITION else None)
    if not value > 0:
        return SecondNumber(remark=f"{value:g} can be no factor; it is taken as 1")
    if year == FIRST_EDITION and code and re.fullmatch(r"1\.[01]{5}", text):
        remark = f"{text} is taken as a file generation type of LM-63-2019, not as a factor"
        return SecondNumber(generation=code, remark=remark)
    if year == 1995:
        remark = f"{value:g} is taken as a factor, as until 1991; LM-63-1995 gives it no meaning"
        return SecondNumber(factor=value, remark=remark)
    return SecondNumber(factor=value)


def _generation(text: str, value: float) -> str | None:
    """Key of `GENERATIONS`; "1" and "1.0" are what files without a type have."""
    code = f"{value:.5f}"
    stated = "." in text and (code != "1.00000" or text == code)
    return code if stated and code in GENERATIONS and float(code) == value else None
