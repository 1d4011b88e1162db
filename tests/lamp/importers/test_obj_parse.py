"""OBJ and MTL text: what is read, and one line for everything that is wrong."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.importers.model_files import MAX_MODEL_BYTES
from lumitree.lamp.importers.mtl import parse_mtl
from lumitree.lamp.importers.obj_text import parse_obj

LINES = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "vt 0 1", "vn 0 1 0", "f 1 2 3", "f -1 -2 -3", "f"]
LINES += ["f 1/1 2/1 3/1", "f 1//1 2 3", "usemtl", "s", "s 1", "mtllib", "v", "#", "\\", "vt"]
LINES += ["f 1/ 2/ 3/", "f f f f"]
FACE = "f 1 2 3"
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


@pytest.fixture
def parsed(tmp_path):
    def parse(text):
        path = tmp_path / "lamp.obj"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return parse_obj(path)

    return parse


@pytest.fixture
def mtl(tmp_path):
    def parse(text):
        path = tmp_path / "lamp.mtl"
        path.write_text(text)
        return parse_mtl(path)

    return parse


def test_every_form_of_a_corner(parsed):
    head = TRIANGLE + "vt 0 0\nvt 1 0\nvt 0 1\nvn 0 0 1\n"
    file = parsed(head + "f 1 2 3\nf 1/3 2/2 3/1\nf 1//1 2//1 3//1\nf 1/1/1 2/2/1 3/3/1\n")
    np.testing.assert_array_equal(
        file.corners.reshape(4, 3, 3),
        [
            [[0, -1, -1], [1, -1, -1], [2, -1, -1]],
            [[0, 2, -1], [1, 1, -1], [2, 0, -1]],
            [[0, -1, 0], [1, -1, 0], [2, -1, 0]],
            [[0, 0, 0], [1, 1, 0], [2, 2, 0]],
        ],
    )
    assert file.sizes.tolist() == [3] * 4
    np.testing.assert_array_equal(file.positions, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_negative_indices_count_from_the_line_they_are_in(parsed):
    second = TRIANGLE.replace("v 0 0 0", "v 5 5 5")
    file = parsed(TRIANGLE + "f -3 -2 -1\n" + second + "f -3 -2 -1\nf 1 -1 -3\n")
    assert file.corners[:, 0].tolist() == [0, 1, 2, 3, 4, 5, 0, 5, 3]
    head = TRIANGLE + "vt 0 0\nvt 1 0\nvn 0 0 1\n"
    assert parsed(head + "f -3/-2/-1 2/-1/1 -1/1/-1").corners.tolist() == [
        [0, 0, 0], [1, 1, 0], [2, 0, 0],
    ]  # fmt: skip


def test_decimal_commas(parsed):
    text = "v 1,5 2,0 -3,25e-1\nv 0 0 0\nv 1,0 0 0\nvn 0 0,6 0,8\nf 1//1 2//1 3//1"
    with pytest.warns(LumitreeWarning, match="decimal commas"):
        file = parsed(text)
    np.testing.assert_array_equal(file.positions, [[1.5, 2, -0.325], [0, 0, 0], [1, 0, 0]])
    np.testing.assert_array_equal(file.normals, [[0, 0.6, 0.8]])


def test_normals_and_texture_coordinates_that_are_not_there(parsed):
    text = TRIANGLE + "vt 0 0\nvn 0 0 1\nf 1/1/1 2/2/0 3/0/2\nf 1/-9/-9 2/1/1 3//"
    with pytest.warns(LumitreeWarning) as caught:
        file = parsed(text)
    assert [str(item.message).partition("obj: ")[2] for item in caught] == [
        "3 corners of faces name texture coordinates that are not there (the file has 1); they are "
        "not used",
        "3 corners of faces name normals that are not there (the file has 1); they are computed",
    ]
    assert file.corners.tolist() == [
        [0, 0, 0], [1, -1, -1], [2, -1, -1], [0, -1, -1], [1, 0, 0], [2, -1, -1],
    ]  # fmt: skip


def coloured(*rows):
    return "".join(f"v {at} {at % 2} 0 {row}\n" for at, row in enumerate(rows)) + "f 1 2 3\n"


def test_vertex_colours(parsed):
    assert parsed(TRIANGLE + "f 1 2 3").colours is None
    linear = [[1, 0, 0], [0.5, 0.5, 0.5], [1, 1, 1]]
    grey = 0.735356983
    for rows in (
        ("1 0 0", f"{grey} {grey} {grey}", ""),
        ("1 1 0 0", f"1 {grey} {grey} {grey}", "1"),
        ("1 0 0 1 # red", f"{grey} {grey} {grey} 1", ""),
    ):
        np.testing.assert_allclose(parsed(coloured(*rows)).colours, linear, atol=1e-6)
    bytes_ = parsed(coloured("255 0 0", "188 188 188", "255 255 255")).colours
    np.testing.assert_allclose(bytes_, linear, atol=3e-3)
    painted = parsed(TRIANGLE + "#MRGB ffff0000ffbcbcbcffffffff\nf 1 2 3").colours
    np.testing.assert_array_equal(painted, bytes_)


@pytest.mark.parametrize(
    ("rows", "match"),
    [
        (("0.5", "", ""), "not used: weights of vertices"),
        (("0.2 0 0 0.5", "", ""), "not used: opacities of vertices"),
        (("1 0", "", ""), "numbers after"),
        (("-1 0 0", "", ""), "not used: vertex colours beyond"),
        (("300 0 0", "", ""), "not used: vertex colours beyond"),
    ],
)
def test_what_vertices_have_besides(parsed, rows, match):
    with pytest.warns(LumitreeWarning, match=match):
        parsed(coloured(*rows))
    with pytest.warns(LumitreeWarning, match="not used: #MRGB"):
        parsed(TRIANGLE + "#MRGB ffff0000\nf 1 2 3")


def test_keys_that_are_not_used_are_said_once(parsed):
    text = TRIANGLE + "vt 0 0 0.5\nusemap x\nusemap y\ncurv 1 2\nsurf 1\nl 1 2\nf 1 2 3"
    with pytest.warns(LumitreeWarning) as caught:
        parsed(text)
    assert [str(item.message).partition("obj: ")[2] for item in caught] == [
        "not used: lines of 'usemap', free-form curves and surfaces (export polygons), lines, "
        "third texture coordinates"
    ]
    with pytest.raises(LumitreeError, match="no faces, but points; expected"):
        parsed(TRIANGLE + "p 1 2 3")


def test_materials_groups_and_odd_text(parsed):
    text = (
        "\ufeffmtllib a b.mtl\r\n# note\r\n  v 0 0 0 # first\r\nv\t1 0 0\r\nv 0 1 0 0.5 0.5 0.5\r\n"
        "f 1 2 3\r\nusemtl old brass\r\ns 2\r\nf 1 2 \\\r\n3 # tail\r\no x\r\ng y\r\ns off\r\n"
        "usemtl b\r\n f 3 2 1\r\nusemtl old brass\r\nf 2 3 1\r\nl 1 2\r\np 1"
    )
    with pytest.warns(LumitreeWarning, match="not used: lines, points$"):
        file = parsed(text)
    assert file.materials == ("old brass", "b", "")
    assert [file.materials[number] for number in file.material] == [
        "", "old brass", "b", "old brass",
    ]  # fmt: skip
    assert file.smoothing.tolist() == [0, 2, 0, 0]
    assert file.libraries == ("a b.mtl",)
    assert len(file.positions) == 3


def test_names_that_are_not_utf8_or_not_printable(parsed):
    file = parsed(TRIANGLE.encode() + b"usemtl Gl\xfchbirne\x07\nf 1 2 3\n")
    assert file.materials == ("Glühbirne?",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no faces"),
        (b"\x00\xff\xfe\x89PNG\r\n", "no faces"),
        (TRIANGLE + "f 1 2", "line 4: a face with 2 corners"),
        (TRIANGLE + "f 1 2 3\nf", "no faces|line 5: a face with 0 corners"),
        (TRIANGLE + "f 1 2 4", "line 4: corner '4' names a position .* the file has 3"),
        (TRIANGLE + "\n\nf 1 2 3\nf 0 1 2", "line 7: corner '0'"),
        (TRIANGLE + "f -4 -2 -1", "line 4: corner '-4'"),
        (TRIANGLE + "f -9223372036854775808 1 2", "line 4: corner '-9223372036854775808'"),
        (TRIANGLE + "f \x1b[31m 1 2", r"corner '\?\[31m'"),
        (TRIANGLE.replace("1 0 0", "1,5 0.0 0") + FACE, "line 2: '1,5' is not a number; write"),
        (TRIANGLE.replace("1 0 0", "1,0,0") + FACE, "line 2: 1 numbers after 'v'; .* by spaces"),
        (TRIANGLE + "f 1/1/1/1 2 3", "line 4: corner"),
        (TRIANGLE + "f /1 2 3", "line 4: corner '/1'"),
        (TRIANGLE + "f a b c", "line 4: corner 'a' is not of the form"),
        ("v 0 0 zero\nf 1 1 1", "line 1: 'zero' is not a number"),
        (TRIANGLE + "v nan 0 0\nf 1 2 3", "line 4: a value is not finite"),
        (TRIANGLE + "v 0 1e30 0\nf 1 2 3", "line 4: a value is not finite or beyond 1e"),
        (TRIANGLE + "vtx 0 0\nf 1 2 3", "begins with 'vtx'"),
        (TRIANGLE + "s many\nf 1 2 3", "smoothing group 'many'"),
        (TRIANGLE + "f " + "1 2 3 " * 700, "a face with 2100 corners; expected 3 to 2000"),
    ],
)  # fmt: skip
def test_wrong_files(parsed, text, message):
    with pytest.raises(LumitreeError, match=message) as caught:
        parsed(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@settings(max_examples=150)
@given(st.lists(st.sampled_from(LINES), max_size=12))
@pytest.mark.filterwarnings("ignore::lumitree.errors.LumitreeWarning")
def test_any_lines_are_read_or_refused(tmp_path_factory, lines):
    path = tmp_path_factory.getbasetemp() / "any.obj"
    path.write_text("\n".join(lines))
    try:
        file = parse_obj(path)
    except LumitreeError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert len(file.corners) == file.sizes.sum()
        assert len(file.sizes) == len(file.material) == len(file.smoothing)
        assert file.corners[:, 0].max() < len(file.positions)


def test_large_files_and_folders_are_refused(tmp_path):
    with open(tmp_path / "big.obj", "wb") as file:
        file.truncate(MAX_MODEL_BYTES + 1)
    with pytest.raises(LumitreeError, match="larger than 512 MiB, the limit for an OBJ file"):
        parse_obj(tmp_path / "big.obj")
    with pytest.raises(LumitreeError, match="is a folder; expected an OBJ file"):
        parse_obj(tmp_path)


def test_mtl_values_maps_and_options(mtl):
    found = mtl(
        "newmtl a\nKd 0.1 0.2 0.3\nKe 5\nTr 0.25 # glassy\nMAP_KD -s 2 3 1 -o 0.5 wood grain.png\n"
        "map_Bump -bm 0.5 -clamp on n.png\nmap_d -imfchan m x.png\nbump -mm 0 1 y.png\n"
        "newmtl b\nillum 2\nnewmtl a\nKd 1 1 1\n"
    )
    assert set(found) == {"a", "b"}
    values, maps = found["a"].values, found["a"].maps
    assert values["Kd"] == (0.1, 0.2, 0.3)
    assert values["Ke"] == (5, 5, 5)
    assert values["Tr"] == (0.25,)
    assert (maps["map_Kd"].file, maps["map_Kd"].scale) == ("wood grain.png", (2, 3))
    assert maps["map_Kd"].offset == (0.5, 0.0)
    assert maps["map_d"].ignored == ("-imfchan m",)
    assert maps["bump"].file == "y.png"
    assert maps["bump"].ignored == ()


def test_spectral_colours_are_reported(mtl):
    with pytest.warns(LumitreeWarning, match="line 2: Kd spectral is not supported"):
        assert mtl("newmtl a\nKd spectral x.rfl")["a"].values == {}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("Kd 1 1", "Kd has 2 numbers"),
        ("Kd red", "Kd has 'red'"),
        ("Ke nan nan nan", "Ke has 'nan'"),
        ("Ke inf", "finite"),
        ("d", "d has 0 numbers"),
        ("map_Kd", "without the name of an image"),
        ("map_Kd -s 1 1 1", "without the name of an image"),
        ("map_Kd -s nan 1 1 a.png", "-s has 'nan'"),
    ],
)
def test_wrong_mtl_lines(mtl, line, message):
    with pytest.raises(LumitreeError, match=f"lamp.mtl, line 2: .*{message}|line 2: {message}"):
        mtl("newmtl a\n" + line)
