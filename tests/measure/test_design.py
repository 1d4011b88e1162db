"""Designs: against closed forms and searches, and the derivatives of direct light."""

import dataclasses
import functools
import itertools
import json

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError
from lumitree.measure import design
from support.slow import slow

# A scene without lamps; something black and far away makes it one.
SPECK = {"type": "sphere", "radius": 0.01, "center": [0, -50, 0]}
SPECK["bsdf"] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}}
ROOM = {"type": "scene", "speck": SPECK}


@functools.cache
def even_asset(folder):
    """A file of a lamp of one cell, even in all directions."""
    field = make_light_field(np.zeros((1, 3), int), np.ones((1, 64, 3)), 2)
    path = folder / "even.lumitree"
    lumitree.save(light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "even"), path)
    return str(path)


@pytest.fixture(scope="module")
def even(tmp_path_factory):
    return even_asset(tmp_path_factory.mktemp("design"))


def lamp(source, x, z, lumens=4000.0, label=None):
    return lumitree.Placement(source, (x, 2, z), 0.02, lumens=lumens, label=label)


def lux(points, lumens, x, z):
    """Illuminance of points [N, 3] that face up, by an even point source at a height of 2."""
    offset = np.array([x, 2, z]) - points
    return lumens / (4 * np.pi) * offset[:, 1] / np.linalg.norm(offset, axis=1) ** 3


def test_two_lamps_are_dimmed_as_a_search_finds_it(mi, even, tmp_path):
    plane = lumitree.TaskPlane(
        (0, 0, 0), extent=(3, 2), spacing=0.5, target=60, uniformity=0.5, name="floor"
    )
    lamps = [lamp(even, -1, 0), lamp(even, 1.5, 0.5, lumens=3000)]
    result = lumitree.design(ROOM, lamps, planes=[plane], margin=0)
    assert [each.label for each in result.lamps] == ["even", "even_2"]
    points, _ = plane.points()
    each = np.stack([lux(points, 4000, -1, 0), lux(points, 3000, 1.5, 0.5)])

    def enough(levels):
        found = levels @ each
        return found.mean() >= 60 and found.min() >= 0.5 * found.mean()

    grid = np.array(list(itertools.product(np.linspace(0, 1, 201), repeat=2)))
    cheapest = min(levels @ [4000, 3000] for levels in grid if enough(levels))
    assert result.cost == pytest.approx(cheapest, rel=0.01)
    assert result.cost_before == pytest.approx(7000, rel=1e-4)
    (area,) = result.areas
    for found in (area.predicted, area.simulated):
        assert found.mean == pytest.approx(60, rel=2e-3)
        assert found.uniformity >= 0.5 - 2e-3
    _check_files(result, tmp_path)


def _check_files(result, folder):
    for suffix in (".toml", ".json", ".png", ".pdf"):
        result.save(folder / f"design{suffix}")
    placements = lumitree.read_placements(folder / "design.toml")
    assert [each.gain for each in placements] == [each.level for each in result.lamps]
    assert [each.at for each in placements] == [each.placement.at for each in result.lamps]
    report = json.loads((folder / "design.json").read_text())
    assert report["cost"] == result.cost
    assert report["areas"][0]["simulated"]["count"] == result.areas[0].simulated.count
    with pytest.raises(LumitreeError, match="does not end in"):
        result.save(folder / "design.txt")


def test_a_lamp_moves_to_the_middle_of_its_plane(mi, even):
    plane = lumitree.TaskPlane((0.2, 0, -0.3), extent=(1, 1), spacing=0.25, minimum=50)
    result = lumitree.design(
        ROOM, [lamp(even, 0.9, 0.5, label="one"), lamp(even, 5, 5, 1e-3, label="the other")],
        planes=[plane], move={"one": "xz"}, region=(-3, 1, -3, 3, 3, 3),
    )  # fmt: skip
    (x, y, z), other = result.lamps[0].placement.at, result.lamps[1].placement
    assert [each.label for each in result.lamps] == ["one", "the other"]
    assert (x, z) == pytest.approx((0.2, -0.3), abs=0.04)
    assert (y, other.at) == (2, (5, 2, 5))
    assert result.areas[0].simulated.smallest == pytest.approx(50, rel=0.02)
    assert result.cost < 0.8 * result.cost_before


def uneven():
    """A lamp whose cells have different light, so that a turn counts."""
    cells = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1]])
    field = make_light_field(cells, np.array([1.0, 3, 6])[:, None, None] * np.ones((3, 64, 3)), 1)
    return light_field_asset(field, LocalFrame(np.array([1.0, 0.5, 0.8]), np.eye(4)), "uneven")


@pytest.mark.parametrize("axis", range(6))
def test_slopes_are_central_differences(mi, axis):
    from scipy.spatial.transform import Rotation

    from lumitree.measure.aiming import unplaced_lamp
    from lumitree.measure.direct_light import direct_lux, moved, slope
    from lumitree.rendering.scene import open_placements

    place = lumitree.Placement(uneven(), at=(0.3, 1.5, 0.1), size=0.8, rotate=(1, 2, 0, 25))
    light = unplaced_lamp(*open_placements([place]))
    points = np.array([[0, 0, 0], [1, 0, 0.5], [-0.6, 0.2, 0.9]])
    normals = np.array([[0, 1, 0], [0, 1, 0], [0.3, 1, -0.2]])
    start = np.array(place.at), np.eye(3)

    def at(step):
        every = np.zeros(6)
        every[axis] = step
        centre, turn = start[0] + every[:3], Rotation.from_rotvec(every[3:]).as_matrix()
        return np.array(direct_lux(moved(light, centre, turn), points, normals, 16, 5), np.float64)

    expected = (at(0.01) - at(-0.01)) / 0.02
    found = slope(light, *start, axis, points, normals, 16, 5)
    assert np.abs(expected).max() > 1e-3 * at(0).max()
    assert found == pytest.approx(expected, rel=0.01, abs=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"planes": [lumitree.Plane((0, 0, 0))]}, "planes has .*expected a list"),
        ({"planes": [lumitree.TaskPlane((0, 0, 0))]}, "no plane has a target"),
        ({"steps": 0}, "steps is 0"),
        ({"margin": -1}, "margin is -1"),
        ({"group": ["desk*"]}, "group 'desk.' matches no lamp"),
        ({"move": {"even": "up"}}, "move has 'up'"),
        ({"watts": {"other": 3}}, "watts 'other' matches no lamp"),
        ({"placements": []}, "there are no lamps"),
        (
            {"placements": [lumitree.Placement("arc", (0, 2, 0))]},
            "arc cannot be dimmed as explicit geometry; bake it",
        ),
        ({"region": (90, 0, 90, 99, 3, 99)}, "region is .*, outside of the scene"),
    ],
)
def test_wrong_arguments_are_refused(mi, even, options, message):
    plane = lumitree.TaskPlane((0, 0, 0), target=100)
    given = {"placements": [lamp(even, 0, 0)], "planes": [plane]} | options
    with pytest.raises(LumitreeError, match=message):
        lumitree.design(ROOM, given.pop("placements"), **given)


@slow
def test_the_command_writes_placements_that_have_what_it_prints(mi, even, tmp_path, capsys):
    from lumitree.cli import main

    text = f"[lamps.row]\nasset = '{even}'\nat = [0, 2.3, 0]\nsize = 0.1\nlumens = 3000\n"
    (tmp_path / "lights.toml").write_text(f"{text}grid = [3, 2]\npitch = [1.2, 1.4]\n")
    out = tmp_path / "dimmed.toml"
    command = (
        f"design examples/office.xml --placements {tmp_path / 'lights.toml'} --plane 0,0.75,0 "
        f"--extent 3,2 --target 250 --uniformity 0.5 --steps 20 --group row_[25] -o {out}"
    ).split()
    assert main([*command, "--json", str(tmp_path / "found.json")]) == 0
    assert "predicted" in capsys.readouterr().out
    lamps = lumitree.read_placements(out)
    assert lamps[1].gain == lamps[4].gain
    assert all(20 * each.gain == pytest.approx(round(20 * each.gain)) for each in lamps)
    report = json.loads((tmp_path / "found.json").read_text())
    assert report["areas"][0]["simulated"]["mean"] >= 245
    plane = lumitree.Plane((0, 0.75, 0), extent=(3, 2))
    again = lumitree.illuminance("examples/office.xml", lamps, planes=[plane], seed=7)
    predicted = report["areas"][0]["predicted"]
    assert again.areas[0].mean == pytest.approx(predicted["mean"], rel=0.02)
    assert dataclasses.asdict(again.areas[0])["uniformity"] >= 0.47


def test_the_smallest_grid_that_is_enough_is_found(mi, even, monkeypatch):
    plane = lumitree.TaskPlane((1, 0, 0), extent=(4, 2), spacing=0.5, target=90)
    result = lumitree.design(ROOM, [lamp(even, 0, 0, label="spot")], planes=[plane], count=True)
    points, _ = plane.points()

    def mean(columns, rows):
        places = itertools.product(range(columns), range(rows))
        pitch = 3.5 / columns, 1.5 / rows
        at = [(pitch[0] * (i + 0.5) - 0.75, pitch[1] * (j + 0.5) - 0.75) for i, j in places]
        return sum(lux(points, 4000, x, z) for x, z in at).mean()

    assert len(result.lamps) == 2
    assert mean(1, 1) < 90 <= mean(2, 1)
    assert [each.label for each in result.lamps] == ["spot", "spot_2"]
    assert result.areas[0].simulated.mean == pytest.approx(90, rel=2e-3)
    monkeypatch.setattr(design, "_MAX_COUNT", 4)
    weak = dataclasses.replace(lamp(even, 0, 0), lumens=1.0)
    with pytest.raises(LumitreeError, match=r"4 lamps reach .*% of the targets"):
        lumitree.design(ROOM, [weak], planes=[plane], count=True)


def test_lamps_do_not_move_into_each_other(mi, even):
    """The best place of both lamps is one."""
    plane = lumitree.TaskPlane((0, 0, 0), extent=(0.2, 0.2), spacing=0.1, minimum=75)
    lamps = [
        dataclasses.replace(lamp(even, x, 0, 2000), size=0.3, label=f"lamp{x}") for x in (-0.5, 0.4)
    ]
    result = lumitree.design(
        ROOM, lamps, planes=[plane], move={"*": "x"}, region=(-1, 1, -1, 1, 3, 1)
    )
    (first, *_), (second, *_) = (each.placement.at for each in result.lamps)
    assert second - first == pytest.approx(0.3, abs=0.03)


def test_direct_illuminance_is_of_illuminance_and_has_derivatives(mi, even):
    import drjit as dr

    points = np.array([[0, 0, 0], [1, 0, 0.5], [-0.6, 0.2, 0.9]])
    given = {"points": points, "normals": (0.1, 1, 0)}
    scene = mi.load_dict(
        ROOM
        | {
            "uneven": lumitree.shape(
                uneven(), mi.ScalarTransform4f().translate([0.3, 1.5, 0.1]).scale(0.2)
            ),
            "even": lumitree.shape(even, mi.ScalarTransform4f().translate([1, 2, 1]).scale(0.01)),
        }
    )
    found = lumitree.direct_illuminance(scene, **given)
    places = [
        lumitree.Placement(uneven(), at=(0.3, 1.5, 0.1), size=0.4),
        lumitree.Placement(even, at=(1, 2, 1), size=0.02),
    ]
    expected = lumitree.illuminance(ROOM, places, **given, direct=True, error=0.005)
    exact = lumitree.direct_illuminance(scene, **given, samples=1024)
    assert np.array(exact) == pytest.approx(expected.direct, rel=0.01)
    params = mi.traverse(scene)
    key = next(key for key in params.keys() if key.startswith("uneven") and key.endswith("gain"))  # noqa: SIM118
    params[key] = mi.Color3f(2.0)
    params.update()
    twice = np.array(lumitree.direct_illuminance(scene, **given)) - np.array(found)
    dr.enable_grad(params[key])
    params.update()
    total = lumitree.direct_illuminance(scene, **given)
    dr.backward(dr.sum(total))
    assert sum(np.ravel(dr.grad(params[key]))) == pytest.approx(twice.sum(), rel=1e-3)


def test_direct_illuminance_has_derivatives_by_the_pose(mi):
    import drjit as dr

    scene = mi.load_dict(ROOM | {"lamp": lumitree.shape(uneven())})
    params = mi.traverse(scene)

    def total(step, attached=False):
        x = mi.Float(step)
        if attached:
            dr.enable_grad(x)
        pose = mi.Transform4f().translate([0.3, 1.5, 0.1]).rotate([0.6, 0.8, 0], 30 * x).scale(0.5)
        params["lamp.emitter.to_world"] = mi.Transform4f().translate([0, x, 0]) @ pose
        params.update()
        points = [[0, 0, 0], [1, 0, 0.5], [-0.6, 0.2, 0.9]]
        return x, dr.sum(lumitree.direct_illuminance(scene, points, (0.1, 1, 0)))

    (_, high), (_, low) = total(0.21), total(0.19)
    x, found = total(0.2, attached=True)
    dr.backward(found)
    expected = (float(high[0]) - float(low[0])) / 0.02
    assert float(dr.grad(x)[0]) == pytest.approx(expected, rel=0.01)


def test_moved_lamps_light_as_lamps_of_another_scene_do(mi, even):
    from lumitree.measure.illuminance import LitScene
    from lumitree.measure.receivers import collect

    planes = [lumitree.TaskPlane((0.2, 0, 0.1), extent=(2, 1), spacing=0.5)]
    first = [lumitree.Placement(uneven(), (x, 2, 0.2), 0.3, lumens=2000) for x in (-1, 1)]
    there = [
        dataclasses.replace(first[0], at=(0.4, 1.5, 0), rotate=(1, 1, 0, 40)),
        dataclasses.replace(first[1], lumens=500, at=(-0.5, 2, 0.5)),
    ]
    areas = collect(planes, (), (), None, None, 0)
    lit = LitScene(mi.load_dict(ROOM), "room", first, areas, "m", by_lamp=True)
    lit.move(there)
    found = lit.estimate(0.01, None, 5)
    expected = lumitree.illuminance(ROOM, there, planes=planes, by_lamp=True, error=0.01, seed=5)
    assert found.by_lamp.direct == pytest.approx(expected.by_lamp.direct, rel=0.02, abs=1e-3)
    some = np.array([1, 4])
    again = lit.again(found, some, 0.005, None, 6)
    same = np.setdiff1d(np.arange(len(found.total)), some)
    assert (again.total == found.total).tolist() == [each in same for each in range(8)]
    assert again.total == pytest.approx(found.total, rel=0.02)


def test_a_lamp_that_is_off_does_not_move(mi, even):
    plane = lumitree.TaskPlane((0, 0, 0), spacing=0.5, minimum=50)
    lamps = [lamp(even, 0.2, 0.1, label="near"), lamp(even, 8, 8, label="far")]
    region = (-9, 1, -9, 9, 3, 9)
    result = lumitree.design(ROOM, lamps, planes=[plane], move={"*": "xz"}, region=region)
    near, far = result.lamps
    assert far.level == 0
    assert far.placement.at == pytest.approx((8, 2, 8))
    assert near.placement.at != (0.2, 2, 0.1)
