"""IES and EULUMDAT files: round trips, other readers, symmetries, damage."""

import numpy as np
import pytest

from damage import damaged, refused
from lumitree.errors import LumitreeError
from lumitree.goniophotometry.files import read_ies, read_ldt, write_ies, write_ldt
from lumitree.goniophotometry.type_c import Grid, IntensityDistribution, direction_of

ROUNDS = 150


def distribution(scale=100.0, step=15, emitted=500.0, name="a lamp"):
    """Random intensities of up to `scale`, one number at each pole."""
    grid, random = Grid(step), np.random.default_rng(0)
    values = scale * random.random((len(grid.c), len(grid.gamma)))
    values[:, [0, -1]] = scale * np.array([0.5, 0.25])
    return IntensityDistribution(name, grid.c, grid.gamma, values, (0.3, 0.2, 0.1), emitted)


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
    assert again.opening == pytest.approx(written.opening)
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
    write_ies(path, distribution())
    lines = path.read_text().splitlines()
    assert lines[0] == "IES:LM-63-2019"
    keys = [line[1 : line.index("]")] for line in lines if line.startswith("[")]
    assert {"TEST", "TESTLAB", "ISSUEDATE", "MANUFAC"} <= set(keys)
    start = lines.index("TILT=NONE") + 1
    assert lines[start].split() == ["1", "500.0", "1.0", "13", "25", "1", "2", "0.1", "0.3", "0.2"]
    assert lines[start + 1].split() == ["1.0", "1.01", "0.0"]
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
    assert lamp.opening == pytest.approx((0.2, 0, 0.1))
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
    assert lamp.opening == pytest.approx((0.2 * 0.3048, 0, 0.1 * 0.3048))
    assert lamp.at(direction_of(90, 45)) == pytest.approx(9)
    assert lamp.name == "Läuchte lamp more"
    # A second factor was abolished in 2002.
    for head, value in (("IESNA:LM-63-1995", 4.5), ("IESNA:LM-63-2002", 9)):
        lamp = read_text(tmp_path, ies(head, factors="0.9 0.5 50"))
        assert lamp.at(direction_of(90, 45)) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ies(kind=2), "Type B"),
        (ies(kind=9), "file"),
        (ies(tilt="INCLUDE\n1\n2\n0 90\n1 0.5"), "TILT"),
        (ies(tilt="lamp.tlt"), "TILT"),
        (ies(c="0 100"), "angles end at 100"),
        (ies(c="90 180"), "IES"),
        (ies(values="1 2 3"), "21 numbers, expected 24 for 3 x 2 intensities"),
        (ies(values="1 2 3 4 5 -6"), "negative"),
        (ies(values="1 2 3 4 5 nan"), "NaN"),
        (ies(gamma="0 90 45"), "ascending"),
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
        (28, "nan", "NaN"),
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
        assert read_ldt(path).intensity == pytest.approx(values, abs=1e-4)


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
