"""IES and EULUMDAT files: round trips, other readers, symmetries, damage."""

import contextlib
import dataclasses

import numpy as np
import pytest

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats.ies import read_ies, write_ies
from lumitree.formats.ldt import read_ldt, write_ldt
from lumitree.formats.opening import Opening
from lumitree.formats.photometric_text import date_of_writing
from lumitree.formats.type_c import Grid, IntensityDistribution, direction_of
from support.damage import damaged, refused

ROUNDS = 150


def distribution(scale=100.0, step=15, emitted=500.0, name="a lamp"):
    """Random intensities of up to `scale`, one number at each pole."""
    grid, random = Grid(step), np.random.default_rng(0)
    values = scale * random.random((len(grid.c), len(grid.gamma)))
    values[:, [0, -1]] = scale * np.array([0.5, 0.25])
    return IntensityDistribution(
        name, grid.c, grid.gamma, values, Opening((0.3, 0.2, 0.1)), emitted
    )


def reference_ldt(path):
    """Reference reader of an EULUMDAT file with one set of lamps, by the numbers of its lines."""
    lines = path.read_text("latin-1").splitlines()
    planes, rows = int(lines[3]), int(lines[5])
    numbers = np.array([float(line) for line in lines[42:]])
    c, gamma, values = np.split(numbers, [planes, planes + rows])
    candela = values.reshape(planes, rows) * float(lines[28]) / 1000
    return c, gamma, candela, {index: lines[index] for index in range(42)}


@pytest.mark.parametrize("scale", [1e-5, 0.02, 1.0, 123.0, 5e6])
@pytest.mark.parametrize(("write", "read", "suffix"), [(write_ies, read_ies, "ies"),
                                                       (write_ldt, read_ldt, "ldt")])  # fmt: skip
def test_round_trip(tmp_path, write, read, suffix, scale):
    written = distribution(scale, emitted=5 * scale)
    path = tmp_path / f"lamp.{suffix}"
    write(path, written)
    again = read(path)
    assert again.c == pytest.approx(written.c)
    assert again.gamma == pytest.approx(written.gamma)
    # Six digits of the largest intensity.
    assert again.intensity == pytest.approx(written.intensity, abs=2e-6 * scale)
    assert again.opening.sides == pytest.approx(written.opening.sides)
    # At least four decimals of a lumen.
    assert again.emitted_lumens == pytest.approx(written.emitted_lumens, abs=1e-4)
    assert again.name == written.name


@pytest.mark.parametrize(("write", "read", "suffix"), [(write_ies, read_ies, "ies"),
                                                       (write_ldt, read_ldt, "ldt")])  # fmt: skip
def test_absolute_photometry_and_names(tmp_path, write, read, suffix):
    """The flux of the emitters of an asset is not known. A name stays one line of Latin-1."""
    path = tmp_path / f"lamp.{suffix}"
    written = distribution(emitted=None, name="a\nb é 灯 [TILT=NONE] $x" + 200 * "y")
    write(path, written)
    again = read(path)
    assert again.emitted_lumens is None
    assert again.lumens == pytest.approx(written.lumens, rel=1e-5)
    assert again.name.startswith("a?b é ?")


@pytest.mark.parametrize("write", [write_ies, write_ldt])
def test_the_date_can_be_given(tmp_path, monkeypatch, write):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1767225600")
    write(tmp_path / "lamp", distribution())
    assert b"2026-01-01" in (tmp_path / "lamp").read_bytes()


@pytest.mark.parametrize("seconds", ["", "today", "1" * 30, "nan"])
def test_a_date_that_is_none_is_refused(monkeypatch, seconds):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", seconds)
    with pytest.raises(LumitreeError, match=r"SOURCE_DATE_EPOCH is .*expected seconds since 1970"):
        date_of_writing()


def test_ies_by_another_reader(tmp_path):
    eulumdat_ies = pytest.importorskip("eulumdat_ies")
    written, path = distribution(), tmp_path / "lamp.ies"
    write_ies(path, written)
    other = eulumdat_ies.ies_to_ldt(path)
    candela = np.array(other.intensities) * other.header.lamp_flux[0] / 1000
    assert candela == pytest.approx(written.intensity, abs=1e-4)
    assert other.header.c_angles == written.c.tolist()
    assert other.header.g_angles == written.gamma.tolist()
    # It has no unit conversion but from metres to millimetres.
    assert (other.header.length, other.header.width) == pytest.approx((300, 100))


def test_ldt_by_a_reference_reader(tmp_path):
    written, path = distribution(), tmp_path / "lamp.ldt"
    write_ldt(path, written)
    c, gamma, candela, lines = reference_ldt(path)
    assert c.tolist() == written.c.tolist()
    assert gamma.tolist() == written.gamma.tolist()
    assert candela == pytest.approx(written.intensity, abs=1e-5)
    # Length (along C90), width and height, mm.
    assert [float(lines[i]) for i in (12, 13, 14)] == [100, 300, 200]
    # Downward share and light output ratio, %.
    assert 0 < float(lines[21]) < 100
    assert float(lines[22]) == pytest.approx(written.lumens / 5, abs=1e-4)
    assert (lines[25], lines[26], float(lines[28])) == ("1", "1", 500)
    assert max(len(line) for line in lines.values()) <= 78


def test_ies_is_marked_as_simulated_and_of_type_c(tmp_path):
    path = tmp_path / "lamp.ies"
    write_ies(path, dataclasses.replace(distribution(), generation="1.00010"))
    lines = path.read_text().splitlines()
    assert lines[0] == "IES:LM-63-2019"
    keys = [line[1 : line.index("]")] for line in lines if line.startswith("[")]
    assert {"TEST", "TESTLAB", "ISSUEDATE", "MANUFAC"} <= set(keys)
    start = lines.index("TILT=NONE") + 1
    assert lines[start].split() == ["1", "500.0", "1.0", "13", "25", "1", "2", "0.1", "0.3", "0.2"]
    assert lines[start + 1].split() == ["1.0", "1.00010", "0.0"]
    assert max(map(len, lines)) <= 132


def ies(head="IESNA:LM-63-2002", tilt="NONE", c="0 90", gamma="0 45 90", values="9 8 7 6 5 4",
        numbers="1 1000 2", kind=1, units=2, factors="1 1 50", size="0.1 -0.2 0"):  # fmt: skip
    counts = f"{len(gamma.split())} {len(c.split())}"
    return (
        f"{head}\n[LUMINAIRE] Old lamp\n[MORE] more\nTILT={tilt}\n"
        f"{numbers} {counts} {kind} {units} {size}\n{factors}\n{gamma}\n{c}\n{values}\n"
    )


def read_text(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "lamp.ies"
    path.write_bytes(text.encode(encoding))
    return read_ies(path)


def test_an_ies_file_of_a_manufacturer(tmp_path):
    lamp = read_text(tmp_path, ies())
    assert lamp.name == "Old lamp more"
    assert lamp.opening == Opening((0.2, 0, 0.1), "cylinder")
    assert lamp.emitted_lumens == 1000
    # The multiplier is 2, and the planes between are mirrored.
    found = lamp.at(direction_of([0, 90, 180, 270], [0, 45, 45, 45]))
    assert found.tolist() == [18, 10, 16, 10]
    assert lamp.at([0.0, 1, 0]) == 0


@pytest.mark.parametrize(
    "text",
    [
        ies("IESNA91"),
        ies("IESNA:LM-63-1995"),
        ies("IES:LM-63-2019"),
        ies("a line of 1986"),
        "﻿" + ies(),
        ies().replace("\n", "\r\n"),
        ies(values="9,8,7,\n6, 5, 4"),
    ],
)
def test_versions_and_styles_of_ies_files(tmp_path, text):
    lamp = read_text(tmp_path, text)
    assert lamp.at(direction_of(90, 45)) == 10
    assert read_text(tmp_path, text, "utf-8").lumens == lamp.lumens


def test_feet_factors_and_old_encodings(tmp_path):
    text = ies(units=1, factors="0.9 1 50").replace("Old", "Läuchte")
    lamp = read_text(tmp_path, text, "latin-1")
    assert lamp.opening.sides == pytest.approx((0.2 * 0.3048, 0, 0.1 * 0.3048))
    assert lamp.at(direction_of(90, 45)) == pytest.approx(9)
    assert lamp.name == "Läuchte lamp more"
    # A second factor was abolished in 1995 and 2002.
    for head, value, said in (
        ("IESNA91", 4.5, no_warning()),
        ("IESNA:LM-63-1995", 4.5, warned("taken as a factor")),
        ("IESNA:LM-63-2002", 9, warned("has no meaning")),
    ):
        with said:
            lamp = read_text(tmp_path, ies(head, factors="0.9 0.5 50"))
        assert lamp.at(direction_of(90, 45)) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ies(kind=9), "9 as type of photometry"),
        (ies(units=3), "3 as unit"),
        (ies(tilt="INCLUDE\n1\n2\n0 90\n1"), "expected"),
        (ies(tilt="lamp.tlt"), "'lamp.tlt', which is not beside it"),
        (ies(c="0 100"), "angles are 0 to 100"),
        (ies(c="90 180"), "angles are 90 to 180"),
        (ies(values="1 2 3"), "21 numbers, expected 24 for 3 x 2 intensities"),
        (ies(values="1 2 3 4 5 -6"), "negative"),
        (ies(values="1 2 3 4 5 nan"), "NaN"),
        (ies(gamma="0 90 45"), "ascending"),
        (ies(gamma="0 5e-324 90"), "ascending by 1e-10 degrees"),
        (ies(values="1e13 1 1 1 1 1"), "above 1e12 cd"),
        ("", "IES"),
        ("IESNA:LM-63-2002\n", "TILT"),
    ],
)
def test_bad_ies_files_are_refused_in_a_line(tmp_path, text, message):
    with pytest.raises(LumitreeError, match=message) as error:
        read_text(tmp_path, text)
    assert str(error.value).isprintable()


def ldt_text(tmp_path):
    path = tmp_path / "good.ldt"
    write_ldt(path, distribution(step=30))
    return path.read_bytes()


@pytest.mark.parametrize(
    ("line", "value", "message"),
    [
        (3, "999999999", "C planes"),
        (3, "nan", "C planes"),
        (5, "1e300", "gamma angles"),
        (5, "1", "gamma angles"),
        (25, "100000000", "sets of lamps"),
        (28, "nan", "line 29, luminous flux of the lamps, is 'nan'"),
        (28, "x", "EULUMDAT"),
        (2, "7", "symmetry"),
        (45, "12", "angles"),
        (70, "-5", "negative"),
    ],
)
def test_bad_ldt_files_are_refused_in_a_line(tmp_path, line, value, message):
    lines = ldt_text(tmp_path).decode("latin-1").split("\n")
    lines[line] = value
    path = tmp_path / "bad.ldt"
    path.write_text("\n".join(lines), "latin-1")
    with pytest.raises(LumitreeError, match=message) as error:
        read_ldt(path)
    assert str(error.value).isprintable()


def test_symmetries_of_ldt_files(tmp_path):
    """By the planes that are in the file: all, C0, C0 to C180, C270 to C90, C0 to C90."""
    pyldt = pytest.importorskip("pyldt")
    grid = Grid(30)
    for symmetry, same in (
        (0, lambda c: c),
        (1, lambda c: 0 * c),
        (2, lambda c: np.minimum(c, 360 - c)),
        (3, lambda c: (180 - c) % 360),
        (4, lambda c: np.minimum(c % 180, 180 - c % 180)),
    ):
        c = grid.c if symmetry != 3 else np.minimum(grid.c, same(grid.c))
        first = same(grid.c) if symmetry != 3 else c
        values = 10 + np.outer(first, np.ones(7)) + grid.gamma
        path = tmp_path / "lamp.ldt"
        written = IntensityDistribution("s", grid.c, grid.gamma, values, emitted_lumens=800.0)
        write_ldt(path, written)
        file = pyldt.LdtReader.read(path)
        file.header.isym = symmetry
        pyldt.LdtWriter.write(file, path, overwrite=True)
        found = read_ldt(path).at(direction_of(grid.c[:, None], grid.gamma))
        assert found[:, 1:-1] == pytest.approx(values[:, 1:-1], abs=1e-4)


LAMBERTIAN = np.cos(np.deg2rad(np.arange(0, 91, 5)))


def lambertian(head="IESNA:LM-63-2002", tilt="TILT=NONE", values=1000 * LAMBERTIAN, second=1,
               size="0.1 0.1 0", c="0"):  # fmt: skip
    """1000 cos γ cd: 1000 π lm."""
    numbers = " ".join(f"{value:.6g}" for value in values)
    gamma = " ".join(str(angle) for angle in range(0, 91, 5))
    return (
        f"{head}\n[TEST] own\n{tilt}\n1 1000 1 19 {len(c.split())} 1 2 {size}\n1 {second} 10\n"
        f"{gamma}\n{c}\n" + len(c.split()) * f"{numbers}\n"
    )


LUMENS = 1000 * np.pi


@pytest.mark.parametrize(
    ("head", "kept"),
    [
        ("IES:LM-63-2019", True),
        ("IESNA:LM-63-2019", True),
        ("ies:lm-63-2019", True),
        ("ANSI/IES LM-63-19", True),
        ("IES LM-63-19", True),
        ("IESNA: LM-63-2002", True),
        ("  IESNA:LM-63-02 ", True),
        ("made by a program", True),
        ("IESNA:LM-63-1995", False),
        ("IESNA:LM-63-95", False),
        ("IESNA91", False),
    ],
)
def test_the_code_of_2019_is_no_factor(tmp_path, head, kept):
    """1.10000: by an accredited laboratory. Until 1995 the number is a factor."""
    says = "made" in head or "95" in head
    with warned("is taken as") if says else no_warning():
        lamp = read_text(tmp_path, lambertian(head, second="1.10000"))
    assert lamp.lumens == pytest.approx(LUMENS * (1 if kept else 1.1), rel=2e-3)


@pytest.mark.parametrize(
    ("spelling", "factor"),
    [
        ("TILT=none", 1),
        ("TILT= NONE", 1),
        ("TILT = NONE", 1),
        ("Tilt=None", 1),
        ("TILT=INCLUDE\n1\n2\n0 90\n1 1", 1),
        ("TILT=INCLUDE\n1\n5\n0 15 30\n45 90\n1 0.95 0.9\n.9 .9", 1),
        ("TILT=include\n2\n3\n-90 0 90\n0.5 0.8 1", 0.8),
        ("TILT=INCLUDE\n3\n2\n-30 90\n0.6 1", 0.7),
        ("TILT=lamp.tlt", 0.9),
        ("TILT=<lamp.tlt>", 0.9),
    ],
)
def test_tilt_of_a_luminaire_at_rest(tmp_path, spelling, factor):
    (tmp_path / "lamp.tlt").write_text("1\n2\n0 90\n0.9 1\n")
    changes = "1 1" not in spelling and "one" not in spelling.lower()
    with warned("factors from") if changes else no_warning():
        lamp = read_text(tmp_path, lambertian(tilt=spelling))
    assert lamp.lumens == pytest.approx(factor * LUMENS, rel=2e-3)


def warned(text):
    return pytest.warns(LumitreeWarning, match=text)


def no_warning():
    return contextlib.nullcontext()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r", "\r\r\n"])
def test_encodings(tmp_path, encoding, newline):
    text = lambertian().replace("own", "Leuchte für München").replace("[TEST]", "[LUMINAIRE]")
    lamp = read_text(tmp_path, text.replace("\n", newline), encoding)
    assert lamp.lumens == pytest.approx(LUMENS, rel=2e-3)
    assert lamp.name == "Leuchte für München"


def test_decimal_commas_of_ies_files(tmp_path):
    text = lambertian(size="0.5 0.5 0.5").replace(".", ",")
    lamp = read_text(tmp_path, text)
    assert lamp.lumens == pytest.approx(LUMENS, rel=2e-3)
    assert lamp.opening == Opening((0.5, 0.5, 0.5))
    # A comma that must be one, since the number of intensities is then right.
    mixed = read_text(tmp_path, lambertian().replace("996.195", "996,195"))
    assert mixed.lumens == pytest.approx(LUMENS, rel=2e-3)
    with pytest.raises(LumitreeError, match="commas may separate"):
        read_text(tmp_path, ies(values="9,8 7,6 5,4 3 2 1 0"))


def test_small_negative_intensities(tmp_path):
    noisy = np.append(1000 * LAMBERTIAN[:-1], -0.05)
    with warned("small negative intensities"):
        lamp = read_text(tmp_path, lambertian(values=noisy))
    assert lamp.lumens == pytest.approx(LUMENS, rel=2e-3)


def test_symmetry_about_the_plane_of_90_degrees(tmp_path):
    lamp = read_text(tmp_path, ies(c="90 180 270", values="9 8 7  9 5 4  9 2 1"))
    found = lamp.at(direction_of([90, 180, 270, 0, 45], [45, 45, 45, 45, 45]))
    assert found.tolist() == pytest.approx([16, 10, 4, 10, 13])


def test_types_a_and_b_of_ies_files(tmp_path):
    """A constant 100 cd over the half space; B holds half of it."""
    angles = "-90 -45 0 45 90"
    for kind, c, planes in ((3, angles, 5), (2, "0 45 90", 3)):
        text = ies(kind=kind, gamma=angles, c=c, values="50 " * 5 * planes)
        assert read_text(tmp_path, text).lumens == pytest.approx(200 * np.pi, rel=1e-3)
    with warned("symmetric"):
        lamp = read_text(tmp_path, ies(kind=3, gamma="0 45 90", c="0 45 90", values="50 " * 9))
    assert lamp.lumens == pytest.approx(200 * np.pi, rel=1e-3)


def test_an_opening_by_its_edition(tmp_path):
    for head, opening in (
        ("IESNA:LM-63-1995", Opening((0.4, 0.4, 0.4), "ellipsoid")),
        ("IESNA:LM-63-2002", Opening((0, 0.4, 0.4), "cylinder", 0)),
    ):
        assert read_text(tmp_path, lambertian(head, size="-0.4 0 -0.4")).opening == opening
    with warned("have no meaning with these signs"):
        lamp = read_text(tmp_path, lambertian(size="0.4 0.3 -0.2"))
    assert lamp.opening == Opening((0.3, 0.2, 0.4))


def ldt(symmetry=1, planes=24, named=None, stored=None, fields=None):
    """1000 cos γ cd of lamps of 500 lm, times a factor of the plane that is stored."""
    stored = [0] if stored is None else stored
    named = 15 * np.arange(planes) if named is None else named
    lines = ["own", "1", symmetry, planes, 15, 19, 5, "rep", "case", "no", "file", "date"]
    lines += [100, 50, 80, 100, 50, 0, 0, 0, 0, 100, 0, 1, 0, 1, 1, "LED", 500, 3000, 80, 10]
    lines += [0.5] * 10 + list(named) + list(range(0, 91, 5))
    for plane in stored:
        # Brighter towards C = 90 than towards C = 270.
        lines += list(2000 * LAMBERTIAN * (1 + 0.5 * np.sin(np.deg2rad(plane))))
    for line, value in (fields or {}).items():
        lines[line - 1] = value
    return "\n".join(map(str, lines)) + "\n"


def read_ldt_text(tmp_path, text, encoding="latin-1"):
    path = tmp_path / "lamp.ldt"
    path.write_bytes(text.encode(encoding))
    return read_ldt(path)


@pytest.mark.parametrize("line", [14, 18, 19, 20, 21, 22, 23, 24, 25, 32])
def test_blank_fields_of_ldt_files(tmp_path, line):
    lamp = read_ldt_text(tmp_path, ldt(fields={line: ""}))
    assert lamp.lumens == pytest.approx(LUMENS, rel=2e-3)
    assert lamp.opening == Opening((0.05, 0, 0.1))


def test_round_areas_and_factors_of_ldt_files(tmp_path):
    lamp = read_ldt_text(tmp_path, ldt(fields={17: "", 18: "20", 24: "0,5"}))
    assert lamp.opening.sides == (0.1, 0.02, 0.1)
    assert lamp.opening.is_round
    assert lamp.lumens == pytest.approx(LUMENS / 2, rel=2e-3)
    with warned("tilted by 15 degrees"):
        read_ldt_text(tmp_path, ldt(fields={25: "15"}))


@pytest.mark.parametrize(
    ("line", "value", "message"),
    [
        (16, "LED", "line 16, length of the luminous area, is 'LED'"),
        (24, "1.0 1.0", "line 24, conversion factor of the intensities"),
        (26, "", "0 in line 26, as number of sets of lamps"),
        (29, "", "line 29, luminous flux of the lamps, is ''"),
        (4, "23", "23 C planes, which its symmetry"),
        (70, "x", "since line 70 is 'x'"),
    ],
)
def test_bad_fields_are_named(tmp_path, line, value, message):
    with pytest.raises(LumitreeError, match=message):
        read_ldt_text(tmp_path, ldt(symmetry=2, stored=15 * np.arange(13), fields={line: value}))


STORED = {
    0: 15 * np.arange(24),
    2: 15 * np.arange(13),
    3: (270 + 15 * np.arange(13)) % 360,
    4: 15 * np.arange(7),
}


@pytest.mark.parametrize("symmetry", STORED)
@pytest.mark.parametrize("named", ["all", "stored"])
@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_stored_planes_of_ldt_files(tmp_path, symmetry, named, encoding):
    stored = STORED[symmetry]
    text = ldt(symmetry, stored=stored, named=stored if named == "stored" else None)
    lamp = read_ldt_text(tmp_path, text, encoding)
    found = lamp.at(direction_of([0, 90, 270], [30, 30, 30]))
    factors = {0: (1, 1.5, 0.5), 2: (1, 1.5, 1.5), 3: (1, 1.5, 0.5), 4: (1, 1.5, 1.5)}[symmetry]
    assert found == pytest.approx(1000 * np.cos(np.pi / 6) * np.array(factors), rel=1e-6)


def test_one_plane_and_all_planes_of_ldt_files(tmp_path):
    """A rotationally symmetric file that names one plane, and one that holds all."""
    for text in (ldt(named=[0]), ldt(stored=np.zeros(24)), ldt()):
        assert read_ldt_text(tmp_path, text).lumens == pytest.approx(LUMENS, rel=2e-3)


@pytest.mark.parametrize("part", range(3))
def test_damaged_files_are_refused_or_read(tmp_path, part):
    good = {"ies": ies().encode(), "ldt": ldt_text(tmp_path)}
    rng = np.random.default_rng(part)
    outcomes = set()
    for suffix, read in (("ies", read_ies), ("ldt", read_ldt)):
        for _ in range(ROUNDS):
            path = tmp_path / f"damaged.{suffix}"
            path.write_bytes(damaged(good[suffix], rng))

            def check(read=read, path=path):
                # What is read is sound.
                lamp = read(path)
                assert np.isfinite(lamp.lumens)
                assert (lamp.at([[0, -1, 0], [1, 0, 0]]) >= 0).all()

            outcomes.add(refused(check))
    assert outcomes == {True, False}
