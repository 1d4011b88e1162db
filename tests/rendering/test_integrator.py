"""`lumitree_path` against Mitsuba's `path` and `volpath`, and scenes with known answers."""

import gc

import numpy as np
import pytest

import lumitree
from lumitree.core.frames import rotation, similarity
from lumitree.rendering.emitter import lamp_of
from lumitree.rendering.scene import load_scene
from support.equal_means import assert_equal_means
from support.fields import make_asset, random_asset, uniform_asset
from support.lamps import sphere
from support.slow import slow, slow_but

SIDE, PASSES = 16, 16


@pytest.fixture
def lamp(tmp_path):
    """A function that places an asset: shape dictionary of a random lamp, or of the one given."""

    def place(centre, size=0.5, *, turn=30, asset=None, seed=11):
        path = tmp_path / f"lamp{seed}{'' if asset is None else id(asset)}.lumitree"
        lumitree.save(random_asset(seed, density_scale=3.0) if asset is None else asset, path)
        return lumitree.shape(path, similarity(rotation([0, 1, 1], turn), size, centre))

    return place


def view(**objects):
    """A floor and what is given, seen from above."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at([0, 2.5, 4], [0, 0.5, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}}
    scene = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 50, "to_world": look, "film": film},
        "floor": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(3),
            "bsdf": {"type": "roughplastic", "alpha": 0.3},
        },
    }
    return mi.load_dict(scene | objects)


def grey(value):
    return {"type": "rgb", "value": value}


def window(x=0.0):
    """An area light behind what stands in the middle, turned to the camera."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at([x, 2, -2], [0, 0.5, 0], [0, 1, 0]).scale(0.6)
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": [5, 4, 3]}}
    return {"type": "rectangle", "to_world": look, "emitter": emitter}


def sky():
    """An environment map that differs in every direction."""
    import mitsuba as mi

    pixels = np.random.default_rng(5).uniform(0.1, 1.5, (8, 16, 3)).astype(np.float32)
    return {"type": "envmap", "bitmap": mi.Bitmap(pixels)}


def leaf():
    """A disk of which half the light passes by an alpha mask."""
    import mitsuba as mi

    to_world = mi.ScalarTransform4f().translate([0.4, 1.2, 0.5]).rotate([1, 0, 0], -60).scale(0.4)
    bsdf = {"type": "mask", "opacity": 0.5, "b": {"type": "twosided", "b": {"type": "diffuse"}}}
    return {"type": "disk", "to_world": to_world, "bsdf": bsdf}


def ball(bsdf, centre=(-0.7, 0.5, 0.6), **properties):
    return {
        "type": "sphere",
        "center": centre,
        "radius": 0.45,
        "bsdf": {"type": bsdf, **properties},
    }


def passes(scene, integrator, spp, seed=0, **options):
    """[PASSES, H, W, 3] independent pictures."""
    import mitsuba as mi

    integrator = mi.load_dict({"type": integrator, **options})
    return np.array(
        [
            np.array(mi.render(scene, integrator=integrator, spp=spp // PASSES, seed=seed + i))
            for i in range(PASSES)
        ]
    )


def assert_same_expectation(first, second):
    """Welch's t-test in every pixel and of the whole picture."""
    noisy = (first.std(0) + second.std(0)) > 1e-5 * first.mean(0) + 1e-6
    assert noisy.any()
    exact = first[:, ~noisy].mean(0), second[:, ~noisy].mean(0)
    assert exact[0] == pytest.approx(exact[1], abs=1e-5, rel=1e-4)
    assert_equal_means(first[:, noisy], second[:, noisy])
    # A bias too small to show in one pixel shows here.
    assert_equal_means(first.mean(axis=(1, 2)), second.mean(axis=(1, 2)), p=3e-4)


POINT = {"type": "point", "position": [1, 2, 1], "intensity": grey(4)}
SUN = {"type": "directional", "direction": [0.3, -1, -0.4], "irradiance": grey(2)}
PLAIN = {
    "area light": lambda: {"window": window(), "ball": ball("dielectric")},
    "environment map": lambda: {"sky": sky(), "ball": ball("roughconductor", alpha=0.2)},
    "several lights": lambda: {"sky": sky(), "window": window(1), "point": POINT, "sun": SUN},
    "alpha mask": lambda: {"window": window(), "leaf": leaf(), "sky": sky()},
    "thin glass": lambda: {"window": window(), "ball": ball("thindielectric")},
    "mirror": lambda: {"window": window(), "ball": ball("conductor"), "point": POINT},
}


@pytest.mark.parametrize("options", [{"max_depth": -1}, {"max_depth": 24, "rr_depth": 24}])
@pytest.mark.parametrize("name", slow_but(["alpha mask", "mirror"], PLAIN))
def test_without_luminaires_it_is_path(mi, name, options):
    # Early roulette gives `path` rare bright samples behind thin glass, where it plays at every
    # sheet; that roulette is the same is the next test's part.
    scene = view(**PLAIN[name]())
    ours = passes(scene, "lumitree_path", 1024, **options)
    theirs = passes(scene, "path", 1024, seed=500, **options)
    assert_same_expectation(ours, theirs)


@pytest.mark.parametrize(
    "options",
    [
        *(slow({"max_depth": depth}) for depth in (0, 1, 2)),
        {"max_depth": 3},
        {"max_depth": 6, "rr_depth": 1},
        slow({"max_depth": 3, "hide_emitters": True}),
    ],
)
def test_without_null_surfaces_it_follows_path_number_by_number(mi, monkeypatch, options):
    """The same random numbers in the same places: depth, roulette and hiding cannot differ."""
    # Rays leave flat surfaces as far away as Mitsuba's, else a few pass an edge on the other side.
    monkeypatch.setattr("lumitree.trace.spawning._FLAT_OFFSET", np.inf)
    scene = view(window=window(), ball=ball("dielectric"), sky=sky(), point=POINT)
    ours = passes(scene, "lumitree_path", 256, **options)
    assert ours == pytest.approx(passes(scene, "path", 256, **options), rel=1e-3, abs=1e-4)
    assert (ours.max() > 0) == (options["max_depth"] > 0)


LIT = {
    "light and its shadow behind": lambda lamp: {
        "lamp": lamp([0, 1.0, 0]),
        "window": window(),
        "point": {**POINT, "position": [0.5, 3, -1]},
    },
    "two lamps through each other": lambda lamp: {
        "front": lamp([0.2, 1.1, 1.0], 0.4),
        "back": lamp([0, 1.0, -0.6], 0.6, seed=12),
    },
    "environment map behind": lambda lamp: {"lamp": lamp([0, 1.2, 0], 0.7), "sky": sky()},
    "mirror": lambda lamp: {
        "lamp": lamp([0.3, 1.3, 0]),
        "ball": ball("conductor"),
        "window": window(-1),
    },
    "alpha mask before": lambda lamp: {"lamp": lamp([0, 1, -0.5]), "leaf": leaf(), "sun": SUN},
    # Not on it: `volpath` gives points that touch a box no light.
    "proxy near the floor": lambda lamp: {
        "lamp": lamp([0, 0.51, 0], turn=0),
        "glass": ball("dielectric", (1.1, 0.5, 0.6)),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [slow({"max_depth": 3}), {"max_depth": 8, "rr_depth": 2}],
)
@pytest.mark.parametrize("name", slow_but(["two lamps through each other"], LIT))
def test_with_luminaires_it_is_volpath(mi, lamp, name, options):
    scene = view(**LIT[name](lamp))
    ours = passes(scene, "lumitree_path", 512, **options)
    theirs = passes(scene, "volpath", 512, seed=500, **options)
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
def test_path_differs_where_the_proxy_casts_a_shadow(mi, lamp):
    """So the tests above can tell the difference."""
    scene = view(**LIT["light and its shadow behind"](lamp))
    ours = passes(scene, "lumitree_path", 512, max_depth=3)
    with pytest.raises(AssertionError):
        assert_same_expectation(ours, passes(scene, "path", 512, seed=500, max_depth=3))


def slabs(lamp, count, density=0.25):
    """Parallel slabs one above the other, each of which takes half of what crosses it."""
    dark = uniform_asset(density, [0.0, 0.0, 0.0], half_extents=np.array([1.0, 1.0, 1.0]))
    return {f"slab{i}": lamp([0, 3 * i, 0], 1, turn=0, asset=dark) for i in range(count)}


def along(scene, origin, direction, **options):
    """Radiance [3, 1024] of one ray, and whether it is valid."""
    import drjit as dr
    import mitsuba as mi

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1024)
    start = dr.zeros(mi.Point3f, 1024) + mi.Point3f(*origin)
    ray = mi.RayDifferential3f(mi.Ray3f(start, mi.Vector3f(*direction)))
    integrator = mi.load_dict({"type": "lumitree_path", **options})
    radiance, valid, _ = integrator.sample(scene, sampler, ray)
    return np.array(radiance), np.array(valid)


@pytest.mark.parametrize("count", [slow(1), 2, slow(5)])
def test_a_chain_of_null_surfaces_neither_bounces_nor_plays_roulette(mi, lamp, count):
    sky_light = {"type": "constant", "radiance": grey(2)}
    scene = mi.load_dict({"type": "scene", "sky": sky_light, **slabs(lamp, count)})
    seen, _ = along(scene, [0.1, -5, 0.2], [0, 1, 0], max_depth=1, rr_depth=1)
    # The dark slab's emission is 1e-4 of L_max, not 0.
    assert seen == pytest.approx(2 * 0.5**count, abs=3e-3)
    assert np.ptp(seen) < 1e-5


@pytest.mark.parametrize(
    ("count", "density"), [(0, 0.25), slow(1, 0.25), slow(3, 0.25), slow(2, 10.0)]
)
def test_shadow_rays_cross_a_chain_of_null_surfaces(mi, lamp, count, density):
    """A matte floor under a sun above the slabs: reflectance 0.5 / π times T."""
    floor = mi.ScalarTransform4f().translate([0, -3, 0]).rotate([1, 0, 0], -90).scale(9)
    sun = {"type": "directional", "direction": [0, -1, 0], "irradiance": grey(np.pi)}
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle", "to_world": floor},
            "sun": sun,
            **slabs(lamp, count, density),
        }
    )
    # From beside the slabs, down onto the point below them; light bounced once only.
    direction = (np.array([-4.0, -1.0, 0]) / np.sqrt(17)).tolist()
    seen, valid = along(scene, [4, -2, 0], direction, max_depth=2)
    through = 0.5**count if density < 1 else 0.0
    error = seen.std() / np.sqrt(seen.shape[1])  # the sun is one of several emitters to choose from
    assert seen.mean() == pytest.approx(0.5 * through, abs=5 * error + 1e-3)
    assert valid.all()


@pytest.mark.slow
def test_a_shining_lamp_before_nothing_is_opaque_in_the_films_alpha(mi, lamp):
    bright = uniform_asset(10.0, [4.0, 2.0, 1.0])
    scene = mi.load_dict({"type": "scene", "lamp": lamp([0, 0, 0], 1, turn=0, asset=bright)})
    seen, valid = along(scene, [0.1, -5, 0.2], [0, 1, 0])
    assert seen.mean(1) == pytest.approx([4, 2, 1], rel=2e-3)
    assert valid.all()
    assert not along(scene, [4, -5, 0.2], [0, 1, 0])[1].any()


@pytest.mark.slow
def test_hidden_emitters_hide_the_lamp_but_not_its_light(mi, lamp):
    bright = uniform_asset(10.0, [4.0, 2.0, 1.0])
    scene = view(lamp=lamp([0, 1, 0], asset=bright))
    hidden = passes(scene, "lumitree_path", 256, max_depth=2, hide_emitters=True)
    theirs = passes(scene, "volpath", 256, seed=500, max_depth=2, hide_emitters=True)
    assert_same_expectation(hidden, theirs)
    shown = passes(scene, "lumitree_path", 256, max_depth=2)
    assert shown.max() > 3.9 > hidden.max() > 0


@pytest.mark.slow
def test_what_is_behind_a_hidden_lamp_is_seen_where_it_is(mi, lamp):
    """A ball behind a lamp that is not there, lit from the side, as if there were no lamp."""
    empty = make_asset(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 3, 9)))
    objects = {"ball": ball("diffuse", (0, 0.6, 0)), "point": POINT}
    options = {"max_depth": 2, "hide_emitters": True}
    scene = view(**objects, lamp=lamp([0, 1.4, 1.6], 0.5, asset=empty))
    ours = passes(scene, "lumitree_path", 1024, **options)
    assert_same_expectation(ours, passes(view(**objects), "path", 1024, seed=500, **options))


def test_a_proxy_is_recognised(mi, lamp):
    """Its emission and transmittance come from one traversal, and only asked for where lit."""
    scene = view(lamp=lamp([0, 1, 0]))
    gc.collect()
    (emitter,) = scene.emitters()
    assert lamp_of(emitter) is not None


def test_a_scene_without_lights_is_black(mi):
    assert passes(view(), "lumitree_path", 16, max_depth=3).max() == 0


@pytest.mark.parametrize("options", [{"max_depth": -2}, {"rr_depth": 0}])
def test_bad_depths_are_refused(mi, options):
    with pytest.raises(RuntimeError, match="expected max_depth of -1"):
        mi.load_dict({"type": "lumitree_path", **options})


ROOM = (
    '<scene version="3.0.0"><integrator type="{}"><integer name="max_depth" value="7"/>'
    '<integer name="rr_depth" value="3"/></integrator><sensor type="perspective"/>{}</scene>'
)
FOG = (
    '<bsdf type="null"/><medium name="interior" type="{}">'
    '<float name="albedo" value="0.5"/></medium>'
)


@pytest.mark.parametrize("kind", ["path", "lumitree_path"])
def test_load_scene_takes_lumitree_path_but_for_heterogeneous_media(mi, tmp_path, kind):
    (tmp_path / "room.xml").write_text(ROOM.format(kind, sphere("a", 1)))
    _, integrator = load_scene(str(tmp_path / "room.xml"))
    assert str(integrator) == "LumitreePath[max_depth=7, rr_depth=3]"
    fog = ROOM.format(kind, sphere("a", 1, inside=FOG.format("homogeneous")))
    (tmp_path / "foggy.xml").write_text(fog)
    _, integrator = load_scene(str(tmp_path / "foggy.xml"))
    assert str(integrator) == "LumitreePath[max_depth=7, rr_depth=3]"
    cloud = '<sensor type="perspective"><medium type="heterogeneous" name="medium"/></sensor>'
    around = ROOM.format(kind, sphere("a", 1)).replace('<sensor type="perspective"/>', cloud)
    for text in (fog.replace("homogeneous", "heterogeneous"), around):
        (tmp_path / "cloudy.xml").write_text(text)
        _, integrator = load_scene(str(tmp_path / "cloudy.xml"))
        assert "Volumetric" in str(integrator)
        assert "max_depth = 7" in str(integrator)
