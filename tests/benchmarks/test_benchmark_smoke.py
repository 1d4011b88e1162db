"""`python -m benchmarks`: its list, its errors, and each benchmark from end to end, tiny."""

import json
from importlib.util import find_spec
from pathlib import Path

import pytest

import lumitree
from benchmarks import design, finished, light_field, near_field, radiance
from benchmarks.__main__ import main, names
from benchmarks.common.lamps import file_name
from benchmarks.common.setting import command_line
from benchmarks.inside_box import baked
from lumitree.errors import LumitreeError
from lumitree.lamp.source import LuminaireSource
from lumitree.trace.light_field_config import LightFieldConfig
from support import tiny_bakes
from support.exported_lamps import lamp
from support.lamps import AREA, GLASS, scene, sphere

BULB = (sphere("bulb", 0.3, inside=GLASS), sphere("wire", 0.1, inside=AREA))
# A disc from whose lower side no light comes.
DISC = (
    '<shape type="disk" id="disc"><transform name="to_world"><rotate x="1" angle="-90"/>'
    '<scale value="0.15"/><translate y="-0.8"/></transform>'
    '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>'
)


def test_without_a_name_it_lists_all(capsys):
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()[2:]
    assert [line.split()[0] for line in lines] == names()
    assert all(len(line.split()) > 5 for line in lines)


@pytest.mark.parametrize("name", names())
def test_every_benchmark_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "--output" in text
    assert "--variant" in text


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["nonsense"], "nonsense"),
        (["large_rooms"], "ASSET"),
        (["large_rooms", "a.lumitree", "--variant", "scalar_rgb"], "scalar_rgb"),
        (["appearance", "none.xml"], "none.xml"),
        (["paper", "--scale", "test", "--list", "--cell", "none"], "no cells of none"),
        (["gpu", "--dry-run", "--part", "none"], "no parts none"),
    ],
)
def test_bad_input_is_explained_in_one_line(mi, argv, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not list(tmp_path.iterdir())


def test_commands_name_no_folders_of_the_machine():
    argv = ["paper", "star", "--rooms", "/home/me/rooms", "--assets=../mine", "-o", "out/a"]
    assert command_line(argv) == (
        "python -m benchmarks paper star --rooms rooms --assets=mine -o out/a"
    )


@pytest.fixture
def ran(mi, tmp_path, monkeypatch):
    """Runs a benchmark in a folder with a lamp; returns its records and its page."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.xml").write_text(scene(*BULB, DISC))

    def run(name, *arguments):
        assert main([name, *arguments, "-o", "out"]) == 0
        found = json.loads(Path(f"out/{name}.json").read_text())
        facts = found["setting"]
        for key in ("commit", "device", "variant", "lumitree", "mitsuba", "drjit"):
            assert facts[key]
        assert facts["command"].startswith(f"python -m benchmarks {name}")
        assert facts["seconds"] > 0
        return found, Path(f"out/{name}.md").read_text()

    return run


@pytest.fixture
def assets(ran):
    """Options of a folder with a small bake of the lamp."""
    name = file_name(LuminaireSource("lamp.xml"))
    lumitree.bake("lamp.xml", f"{name}.lumitree", tiny_bakes.bake_config(), progress=None)
    return ["--assets", "."]


@pytest.mark.slow
def test_illumination(ran, assets):
    found, page = ran("illumination", "lamp.xml", *assets, "--width", "16", "--spp", "1")
    (row,) = found["luminaires"]
    assert row["product_over_sphere"]["sphere"] == 1
    assert row["time_over_explicit"]["light"] > 0
    assert "product / sphere: geometry" in page


@pytest.mark.slow
def test_appearance(ran, assets):
    arguments = ["--seconds", "0.1", "--reference", "0.5", "--width", "32", "--spp", "1"]
    found, page = ran("appearance", "lamp.xml", *assets, *arguments)
    (row,) = found["luminaires"]
    assert {"explicit", "field", "geometry"} == set(row["methods"])
    assert "rmse_display" in page


@pytest.mark.slow
def test_large_rooms(ran):
    lumitree.save(lamp(), "small.lumitree")
    options = ["--counts", "2", "--rooms", "hall", "--appearances", "field", "--width", "16"]
    found, page = ran("large_rooms", "small.lumitree", *options, "--spp", "1")
    assert [row["count"] for row in found["cases"]] == [1, 2]
    assert found["cases"][0]["product"] == 1
    assert "| small | field | hall |" in page


@pytest.mark.slow
def test_light_field(ran, monkeypatch):
    monkeypatch.setattr(light_field, "GRIDS", ((1, 8), (3, 8)))
    monkeypatch.setattr(light_field, "REFERENCE_PATHS", 1 << 14)
    found, page = ran("light_field", "lamp.xml", "--paths", "16384")
    assert [row["depth"] for row in found["rows"]] == [1, 3]
    assert "mean RMS / baseline" in page


@pytest.mark.slow
def test_near_field(ran, monkeypatch):
    tiny_bakes.set_qualities(monkeypatch.setattr, light=LightFieldConfig(1 << 18, batch=1 << 18))
    monkeypatch.setattr(baked, "_RECEIVERS", 1 << 10)
    monkeypatch.setattr(baked, "_SAMPLES", 64)
    Path("lamp.xml").write_text(scene(sphere("bulb", 0.3, inside=AREA), DISC))
    found, page = ran("near_field", "lamp.xml", "--paths", str(1 << 20))
    (row,) = found["luminaires"]
    assert [plane["lit_from"] for plane in row["planes"]][:5] == ["+y", "+y", "+y", "-y", "+y"]
    for way in near_field.WAYS:
        far = row[way]["horizontal"]["far"]
        assert far["ratio"] == pytest.approx(1, abs=0.06)
        assert far["rms"] < 0.1
        assert row[way]["noise"]["inside"]["product"] > 0
    # The disc's shadow has a sharp border only where the disc is in the scene.
    assert row["geometry"]["shadow"]["reference"] < 0.01
    assert row["geometry"]["shadow"]["baked"] < row["light"]["shadow"]["baked"]
    assert "time * variance / outside" in page


@pytest.mark.slow
def test_other_programs(ran):
    """A light for each cell gives the illuminance of the lamp in each program that there is."""
    lumitree.save(lamp(), "small.lumitree")
    options = ["--assets", ".", "--lights", "20", "--error", "0.005"]
    found, page = ran("other_programs", "small", *options)
    packages = {"Radiance, .rad": "pyradiance", "IES files, by ies2rad": "pyradiance"}
    packages["OpenUSD, .usda"] = "pxr"
    for row in found["rows"]:
        package = packages.get(row["target"])
        if "left_out" in row:
            assert package is None or find_spec(package) is None
            assert f"{row['target']} is left out" in page
            continue
        assert row["ratio"] == pytest.approx(1, abs=0.02)
        # pbrt takes the nearest texel, a quarter of a bin, of intensities that are random by bin.
        assert row["rms"] < 0.05


@pytest.mark.slow
@pytest.mark.skipif(find_spec("pyradiance") is None, reason="pyradiance is not installed")
def test_radiance(ran, monkeypatch):
    monkeypatch.setattr(radiance, "SPACING", 1.3)
    monkeypatch.setattr(radiance, "EXTENT", (2.6, 2.6))
    options = ["--repeats", "4", "--error", "0.02"]
    found, page = ran("radiance", "spot, black room", "panel, furnished room", *options)
    assert [row["quantity"] for row in found["rows"]] == ["direct", "direct", "total"]
    assert all(abs(row["ratio"] - 1) < 0.1 for row in found["rows"])
    assert Path("out/radiance.png").stat().st_size > 10_000
    assert "spot, black room" in page
    with pytest.raises(LumitreeError, match="there is no case 'none'; expected one of"):
        radiance.chosen(["none"])


@pytest.mark.slow
def test_rivals(ran):
    names = ["baked", "light", "lumitree-path", "ptracer", "sphere"]
    options = ["--work", "work", "--width", "16", "--seconds", "0.01"]
    found, page = ran("rivals", "lamp.xml", *options, "--only", *names)
    methods = found["luminaires"][0]["methods"]
    assert list(methods) == names
    assert methods["baked"]["over"]["baked"] == methods["light"]["over"]["light"] == 1
    assert methods["lumitree-path"]["mean"]["value"] == 1
    assert len(methods["baked"]["display"]) == 3
    assert methods["ptracer"]["display"] == []
    if find_spec("mitsuba_oidn"):
        assert methods["baked"]["denoised"]["error"] < methods["baked"]["variance"] ** 0.5
    assert "| Mitsuba `ptracer` |" in page
    # Once more without rendering: the same images.
    again, _ = ran("rivals", "lamp.xml", *options[:4], "--seconds", "0")
    seconds = again["luminaires"][0]["methods"]["ptracer"]["seconds"]
    assert seconds == methods["ptracer"]["seconds"]


def test_an_image_is_finished_when_its_error_stays_below_the_goal():
    points = [
        {"samples": 1, "seconds": 4.0, "hdr_flip": 0.4},
        {"samples": 2, "seconds": 8.0, "hdr_flip": 0.1},
        {"samples": 4, "seconds": 16.0, "hdr_flip": 0.025},
    ]
    assert finished.finished(points) == {"seconds": pytest.approx(8 * 2**0.5), "reached": True}
    short = finished.finished(points[:2])
    assert short == {"seconds": 8.0, "reached": False}
    row = {"scene": "s", "lamp": "l", "bake_seconds": 9.0, "methods": {"baked": {"points": points}}}
    for each in finished.METHODS:
        row["methods"][each] = {**finished.finished(points), "points": points}
    row["methods"]["path"] = {**short, "points": points[:2]}
    line = finished.times_table([row]).rows[0]
    assert line[3:] == ["11.3", "11.3", "> 8.0", "11.3", "1.0", "> 0.7", "1.0"]


@pytest.mark.slow
def test_finished(ran, monkeypatch):
    pytest.importorskip("mitsuba_oidn")
    Path("veach_bidir").mkdir()
    floor = '<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/>'
    camera = '<sensor type="perspective"><film type="hdrfilm"/></sensor><integrator type="path"/>'
    wall = f'{floor}<scale value="4"/></transform></shape>'
    Path("veach_bidir/room_night.xml").write_text(f'<scene version="3.0.0">{camera}{wall}</scene>')
    monkeypatch.setattr(finished, "METHODS", ("baked", "light"))
    scenes = {"small": finished.Scene("./lamp.xml", "veach_bidir", "standing")}
    monkeypatch.setattr(finished, "SCENES", scenes)
    options = ["--rooms", ".", "--data", ".", "--work", "work", "--width", "32", "--seconds", "0"]
    found, page = ran("finished", *options, "--reference", "16")
    (row,) = found["scenes"]
    assert all(each["points"][0]["seconds"] > 0.1 for each in row["methods"].values())
    assert Path("out/finished-small.png").stat().st_size > 1000
    assert "| small | ./lamp.xml |" in page


@pytest.mark.slow
def test_design(ran, monkeypatch):
    lumitree.save(lamp(), "small.lumitree")
    coarse = ((0, 0.9, 0), (1, 1), 0.5, 1e-3), ((0, 1, 0), (3, 3), 1.5, 1e-3)
    monkeypatch.setitem(design.ROOMS, "demo", (*coarse, ((0, 2, 0), (2, 1), (1, 1), 0.2)))
    found, page = ran("design", "small.lumitree", "demo", "--error", "0.1")
    dimmed, moved = found["rooms"]["demo"]
    assert dimmed["lamps"] == moved["lamps"] == 2
    assert dimmed["mean_difference"] < 0.3
    assert "| demo | moved | 2 |" in page
