"""IES and EULUMDAT files: round trips, other readers, symmetries, damage."""

import contextlib

import numpy as np
import pytest

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats.ies import read_ies, write_ies
from lumitree.formats.ldt import read_ldt, write_ldt
from lumitree.formats.opening import Opening
from lumitree.formats.reading import date_of_writing
from lumitree.formats.type_c import Grid, IntensityDistribution, direction_of


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
        (ies(tilt="lamp.tlt"), "'lamp.tlt', which is not beside it"),
        (ies(c="0 100"), "angles are 0 to 100"),
        (ies(values="1 2 3"), "21 numbers, expected 24 for 3 x 2 intensities"),
        (ies(values="1 2 3 4 5 -6"), "negative"),
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
        (5, "1", "gamma angles"),
        (25, "100000000", "sets of lamps"),
        (28, "x", "EULUMDAT"),
        (2, "7", "symmetry"),
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


def test_an_opening_by_its_edition(tmp_path):
    for head, opening in (
        ("IESNA:LM-63-1995", Opening((0.4, 0.4, 0.4), "ellipsoid")),
        ("IESNA:LM-63-2002", Opening((0, 0.4, 0.4), "cylinder", 0)),
    ):
        assert read_text(tmp_path, lambertian(head, size="-0.4 0 -0.4")).opening == opening
    with warned("have no meaning with these signs"):
        lamp = read_text(tmp_path, lambertian(size="0.4 0.3 -0.2"))
    assert lamp.opening == Opening((0.3, 0.2, 0.4))
