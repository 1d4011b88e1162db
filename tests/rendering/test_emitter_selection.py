"""Images with many lamps: which emitter is sampled, and code that lamps share."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import LocalFrame, rotation, similarity
from support.equal_means import assert_equal_means
from support.fields import random_asset
from support.light_fields import random_light_field
from support.slow import slow
from support.walls import irradiance

PARTS = ("light", *(slow(each) for each in ("field", "both")))


def make_asset(parts, seed=1):
    field = random_asset(seed, half_extents=np.array([1.0, 0.7, 0.5]))
    light = random_light_field(seed)
    return {
        "field": field,
        "both": dataclasses.replace(field, light_field=light),
        "light": light_field_asset(light, field.frame, "lamp"),
    }[parts]


def lamps(assets, count=9):
    """Lamps in a grid, of different sizes, rotations and gains."""
    random = np.random.default_rng(7)
    found = {}
    for index in range(count):
        size = random.uniform(0.15, 0.3)
        turn = rotation(random.normal(size=3), random.uniform(0, 360))
        at = [2.0 * (index % 3) - 2, random.uniform(0.5, 1), 2.0 * (index // 3) - 2]
        asset = assets[index % len(assets)]
        gain = tuple(random.uniform(0.5, 2, 3))
        found[f"lamp{index}"] = lumitree.shape(asset, similarity(turn, size, at), gain=gain)
    return found


def room(mi, **objects):
    """A glossy floor, a wall and a window."""
    from lumitree.rendering.objects import load_ordered

    look = mi.ScalarTransform4f().look_at([0, 3, 7], [0, -0.4, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
    to = mi.ScalarTransform4f
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 40, "to_world": look, "film": film},
        "floor": {
            "type": "rectangle",
            "to_world": to().translate([0, -0.5, 0]).rotate([1, 0, 0], -90).scale(4),
            "bsdf": {"type": "roughplastic", "alpha": 0.2},
        },
        "wall": {"type": "rectangle", "to_world": to().translate([0, 0, -3.2]).scale(4)},
    }
    return load_ordered(scene | objects)


def others(mi):
    """A window and a sky."""
    place = mi.ScalarTransform4f().translate([-3.5, 1, 0]).rotate([0, 1, 0], 90)
    radiance = {"type": "rgb", "value": [4, 5, 6]}
    return {
        "window": {
            "type": "rectangle",
            "to_world": place,
            "emitter": {"type": "area", "radiance": radiance},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.05}},
    }


def images(mi, scene, count=12, spp=64, **options):
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 3, **options})
    return np.array(
        [np.array(mi.render(scene, integrator=integrator, spp=spp, seed=s)) for s in range(count)]
    )


@pytest.fixture
def uniform(monkeypatch):
    """Call it to select emitters by their sampling weights from now on."""
    from lumitree.rendering import integrator as path_scene

    class Uniform(path_scene.EmitterSelection):
        def __init__(self, *args):
            super().__init__(*args)
            self.by_receiver = False

    return lambda: monkeypatch.setattr(path_scene, "EmitterSelection", Uniform)


@pytest.mark.parametrize(
    ("parts", "mixed"),
    [
        slow("light", False),
        ("light", True),
        slow("field", True),
        slow("both", False),
    ],
)
def test_the_mean_is_that_of_a_uniform_choice(mi, uniform, parts, mixed):
    """z-tests of pixels and of the mean; and less noise."""
    scene = room(mi, **lamps([make_asset(parts)]), **(others(mi) if mixed else {}))
    found = [images(mi, scene)]
    uniform()
    found.append(images(mi, scene))
    assert_equal_means(found[0], found[1])
    means = [each.mean(axis=(1, 2)) for each in found]
    assert_equal_means(means[0], means[1])
    assert means[0].mean() == pytest.approx(means[1].mean(), rel=0.02)
    floor = np.s_[:, 7:]
    noise = [np.median(each[floor].std(axis=0)) for each in found]
    assert noise[0] < noise[1]


def test_a_lamp_that_is_never_sampled_lights_a_wall(mi):
    """The rays of BSDFs then find all of its light."""
    asset = light_field_asset(random_light_field(1), LocalFrame(np.ones(3), np.eye(4)), "lamp")
    far = lumitree.shape(asset, similarity(np.eye(3), 0.3, [0, 50, 0]))
    found = []
    for weight in (1.0, 0.0):
        near = lumitree.shape(asset, similarity(rotation([0, 1, 1], 30), 0.3, [0, 1, 0]))
        near["emitter"]["sampling_weight"] = weight
        found.append(irradiance(mi, {"near": near, "far": far}, [0, -0.5, 0], [0, 1, 0]))
    (first, first_error), (second, second_error) = found
    assert (np.abs(first - second) < 4 * np.hypot(first_error, second_error)).all()
    assert second == pytest.approx(first, rel=0.05)


@pytest.mark.slow
def test_media_and_surfaces_that_let_light_through_get_light_from_all_sides(mi, uniform):
    fog = {"type": "homogeneous", "albedo": 0.8, "sigma_t": 0.5}
    cloud = {
        "type": "sphere",
        "center": [0, 0.6, 1],
        "radius": 0.5,
        "bsdf": {"type": "null"},
        "interior": fog,
    }
    glass = {
        "type": "sphere",
        "center": [1.2, 0, 1.5],
        "radius": 0.4,
        "bsdf": {"type": "roughdielectric", "alpha": 0.4},
    }
    scene = room(mi, cloud=cloud, glass=glass, **lamps([make_asset("light")]))
    found = [images(mi, scene)]
    uniform()
    found.append(images(mi, scene))
    assert_equal_means(found[0], found[1])
    means = [each.mean(axis=(1, 2, 3)) for each in found]
    assert_equal_means(means[0], means[1])


def test_one_lamp_is_selected_as_before(mi):
    """By Mitsuba, and with its random numbers."""
    from lumitree.rendering.integrator import EmitterSelection, LampChoices

    one = lamps([make_asset("light")], 1)
    assert not EmitterSelection(room(mi, **one, **others(mi)), LampChoices()).by_receiver
    two = lamps([make_asset("light")], 2)
    assert EmitterSelection(room(mi, **two), LampChoices()).by_receiver


@pytest.mark.slow
def test_emitters_of_a_mixed_scene(mi):
    """χ² of those that are no lamps; and p is what rays of the BSDF get for the same receiver."""
    import drjit as dr

    from lumitree.rendering.emitter import lamp_of
    from lumitree.rendering.integrator import EmitterSelection, LampChoices

    scene = room(mi, **lamps([make_asset("light")]), **others(mi))
    selection = EmitterSelection(scene, LampChoices())
    count = 1 << 16
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(4, count)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.p = mi.Point3f(0.3, -0.5, 0.4)
    none, active = mi.UInt32(0xFFFFFFFF), dr.full(mi.Bool, True, count)
    found = selection.sample(si, mi.Vector3f(0, 1, 0), none, sampler, active)
    index, weight, pmf = (np.array(each) for each in (found.index, found.weight, found.emitter_pmf))
    emitters = scene.emitters()
    lamp = np.array([lamp_of(emitter) is not None for emitter in emitters])
    it = dr.zeros(mi.Interaction3f, len(emitters))
    it.p = mi.Point3f(0.3, -0.5, 0.4)
    expected = np.array(selection.pmf(scene.emitters_dr(), it))
    assert expected.sum() == pytest.approx(1, rel=1e-5)
    assert expected[~lamp] == pytest.approx(0.25)
    assert pmf == pytest.approx(expected[index], rel=1e-4)
    assert weight[~lamp[index]] == pytest.approx(4, rel=1e-4)
    counts = np.bincount(index, minlength=len(emitters))
    groups = [*counts[~lamp], counts[lamp].sum()]
    assert stats.chisquare(groups, [count / 4, count / 4, count / 2]).pvalue > 1e-3


@pytest.mark.slow
def test_a_gain_of_zero_and_a_change_of_gain_are_followed(mi):
    scene = room(mi, **lamps([make_asset("light")], 4))
    before = images(mi, scene, 1, 16)[0]
    parameters = mi.traverse(scene)
    for name in parameters.properties:
        if name.endswith("gain"):
            parameters[name] = 3 * parameters[name]
    parameters.update()
    assert images(mi, scene, 1, 16)[0] == pytest.approx(3 * before, rel=1e-3, abs=1e-5)
    for name in parameters.properties:
        if name.endswith("gain"):
            parameters[name] = mi.Color3f(0)
    parameters.update()
    assert not images(mi, scene, 1, 16).any()


@pytest.mark.slow
@pytest.mark.parametrize("parts", PARTS)
def test_lamps_of_one_kind_share_their_code(mi, monkeypatch, parts):
    """Equal images, with code for each lamp and for each kind; equal seeds."""
    from lumitree.rendering.lamps import LampKinds

    assets = [make_asset(parts, seed) for seed in (1, 2)]
    scene = room(mi, **lamps(assets), **others(mi))
    kinds = LampKinds(scene.emitters(), scene.emitters_dr())
    assert len(kinds._lamps) == 2
    shared = images(mi, scene, 1, 32)[0]
    create = LampKinds.__init__

    def separate(self, *args):
        create(self, *args)
        self._has_instances = False

    monkeypatch.setattr(LampKinds, "__init__", separate)
    apart = images(mi, scene, 1, 32)[0]
    # Rounding may send a few paths elsewhere.
    assert np.median(np.abs(shared - apart)) < 1e-4 * apart.mean()
    assert shared.mean() == pytest.approx(apart.mean(), rel=0.01)


def test_gains_of_many_lamps_are_joined_with_their_derivatives(mi):
    """In groups: one kernel of 1,000 arrays takes minutes to compile."""
    import drjit as dr

    from lumitree.rendering.emitter import joined

    colours = [mi.Color3f(index, 2 * index, 3 * index) for index in range(300)]
    dr.enable_grad(colours[170])
    found = mi.Color3f(*joined([list(each) for each in colours]))
    expected = np.arange(300) * np.array([[1], [2], [3]])
    assert np.array_equal(np.array(found), expected)
    dr.forward(colours[170].y)
    assert np.flatnonzero(np.array(dr.grad(found.y))).tolist() == [170]
    assert not np.array(dr.grad(found.x)).any()
