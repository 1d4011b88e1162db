"""Emitter and BSDF inside Mitsuba: densities, estimators, and scenes with known answers."""

import numpy as np
import pytest

import lumitree
from lumitree.core.device import on_device
from lumitree.core.frames import rotation, similarity
from lumitree.errors import LumitreeError
from support.fields import make_asset, random_asset, uniform_asset
from support.slow import slow

TURNED = similarity(rotation([1, 2, 3], 40), 0.4, [0.1, 0.9, -0.2])


@pytest.fixture
def asset_file(tmp_path):
    def write(asset, name="lamp.lumitree"):
        lumitree.save(asset, tmp_path / name)
        return tmp_path / name

    return write


def room(lamp, **extra):
    """A floor seen from above the lamp's side, and what is in it."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at([0, 2.5, 4], [0, 0.5, 0], [0, 1, 0])
    floor = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(3)
    scene = {
        "type": "scene",
        "sensor": {
            "type": "perspective",
            "fov": 50,
            "to_world": look,
            "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "box"}},
        },
        "floor": {
            "type": "rectangle",
            "to_world": floor,
            "bsdf": {"type": "roughplastic", "alpha": 0.3},
        },
        **extra,
    }
    if lamp is not None:
        scene["lamp"] = lamp
    return mi.load_dict(scene)


def render(scene, spp, seed=0, **options):
    """Mean image and its variance, from independent passes."""
    import mitsuba as mi

    integrator = mi.load_dict({"type": "volpath", "max_depth": 4, "rr_depth": 100, **options})
    passes = [
        np.array(mi.render(scene, integrator=integrator, spp=spp // 16, seed=seed + i))
        for i in range(16)
    ]
    return np.mean(passes, 0), np.var(passes, 0, ddof=1) / 16


def agree(first, second, significance=4.5):
    """z-test of two noisy images, pixel blocks of 4 x 4 against each other."""
    (a, var_a), (b, var_b) = first, second
    block = lambda x: x.reshape(6, 4, 6, 4, 3).mean(axis=(1, 3))  # noqa: E731
    z = (block(a) - block(b)) / np.sqrt(block(var_a + var_b) / 16 + 1e-10)
    return np.abs(z).max() < significance


@pytest.mark.parametrize("origin", [(0.9, 1.1, 0.5), slow((0.05, 1.7, -0.15)), (0.6, 0.5, -0.7)])
def test_pdf_direction_matches_sample_direction(mi, asset_file, origin):
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    path = asset_file(random_asset(0, half_extents=np.array([1.0, 0.7, 0.4])))
    shape = mi.load_dict(lumitree.shape(path, TURNED))
    emitter = shape.emitter()
    it = mi.Interaction3f()
    it.p = mi.Point3f(*origin)
    it.t = mi.Float(0)

    def sample(sample2):
        ds, _weight = emitter.sample_direction(it, sample2)
        return ds.d, dr_select(ds.pdf > 0)

    def dr_select(mask):
        import drjit as dr

        return dr.select(mask, mi.Float(1), 0)

    def pdf(direction):
        si = shape_hit(mi, shape, it, direction)
        ds = mi.DirectionSample3f(si[0], si[1], it)
        ds.d = direction
        return mi.Float(emitter.pdf_direction(it, ds, si[1].is_valid()))

    test = ChiSquareTest(
        domain=SphericalDomain(),
        sample_func=sample,
        pdf_func=pdf,
        sample_dim=2,
        # The density jumps at the proxy's silhouette: integrate it finely there.
        res=41,
        ires=128,
        sample_count=200_000,
    )
    assert test.run(), test.messages


def shape_hit(mi, shape, it, direction):
    import drjit as dr

    scene = shape_hit.scenes.setdefault(id(shape), mi.load_dict({"type": "scene", "s": shape}))
    n = dr.width(direction)
    ray = mi.Ray3f(dr.gather(mi.Point3f, it.p, dr.zeros(mi.UInt32, n)), direction)
    return scene, scene.ray_intersect(ray)


shape_hit.scenes = {}


@pytest.mark.slow
def test_sample_direction_weight_is_emission_over_pdf(mi, asset_file):
    import drjit as dr

    path = asset_file(random_asset(2, half_extents=np.array([0.5, 1.0, 0.8])))
    shape = mi.load_dict(lumitree.shape(path, TURNED))
    scene = mi.load_dict({"type": "scene", "s": shape})
    it = dr.zeros(mi.Interaction3f, 4096)
    it.p = mi.Point3f(1.5, 2.0, 0.7)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 4096)
    ds, weight = shape.emitter().sample_direction(it, sampler.next_2d())
    si = scene.ray_intersect(mi.Ray3f(it.p, ds.d))
    seen = shape.emitter().eval(si)
    direct = shape.emitter().eval_direction(it, ds)
    pdf = shape.emitter().pdf_direction(it, ds)
    expected_pdf = np.broadcast_to(np.array(ds.pdf), 4096)
    valid = expected_pdf > 0
    # Some miss the proxy, and some are drawn from leaves that others hide.
    assert valid.mean() > 0.7
    # The sampled point is the one that a ray along the sampled direction meets.
    assert np.abs(np.array(si.t) - np.array(ds.dist))[valid].max() < 1e-4
    pdf = np.broadcast_to(np.array(pdf), 4096)
    assert pdf[valid] == pytest.approx(expected_pdf[valid], rel=1e-3)
    weighted = np.array(weight * ds.pdf)[:, valid]
    assert weighted == pytest.approx(np.array(seen)[:, valid], abs=5e-3, rel=5e-3)
    assert weighted == pytest.approx(np.array(direct)[:, valid], abs=5e-3, rel=5e-3)


@pytest.mark.slow
def test_emitter_bsdf_and_mis_sampling_agree(mi, asset_file):
    """The same direct light by next-event estimation alone, by BSDF sampling alone and by MIS."""
    path = asset_file(random_asset(11, density_scale=3.0))
    lamp = lumitree.shape(path, similarity(rotation([0, 0, 1], 30), 0.5, [0, 1.2, 0]))
    scene = room(lamp)
    volpath = render(scene, 512)
    emitter_only, bsdf_only = (render_direct(mi, scene, 512, use) for use in ("emitter", "bsdf"))
    assert agree(volpath_direct(scene), emitter_only)
    assert agree(volpath_direct(scene, 100), bsdf_only)
    assert agree(emitter_only, bsdf_only)
    assert volpath[0].mean() >= volpath_direct(scene)[0].mean() * 0.99


def volpath_direct(scene, seed=50):
    return render(scene, 512, seed, max_depth=2)


def render_direct(mi, scene, spp, use):
    """Camera rays through the proxy, then one technique for direct light (a plain estimator)."""
    import drjit as dr

    film = 24
    passes = []
    for index in range(16):
        sampler = mi.load_dict({"type": "independent"})
        per_pass = spp // 16
        sampler.seed(1000 + index, film * film * per_pass)
        pixel = dr.arange(mi.UInt32, film * film * per_pass) // per_pass
        position = mi.Point2f(pixel % film, pixel // film) + sampler.next_2d()
        ray, _ = scene.sensors()[0].sample_ray(0, 0, position / film, mi.Point2f(0.5))
        value = mi.Color3f(0)
        through = mi.Color3f(1)
        floor, lit = walk(mi, scene, ray)
        value += lit[0]
        through = lit[1]
        bsdf = floor.bsdf()
        active = floor.is_valid()
        context = mi.BSDFContext()
        if use == "emitter":
            ds, weight = scene.sample_emitter_direction(floor, sampler.next_2d(), False, active)
            wo = floor.to_local(ds.d)
            value += through * (bsdf.eval(context, floor, wo, active) * weight & active)
        else:
            bs, weight = bsdf.sample(context, floor, sampler.next_1d(), sampler.next_2d(), active)
            _, seen = walk(mi, scene, floor.spawn_ray(floor.to_world(bs.wo)))
            value += through * (weight * seen[0] & active)
        flat = np.array(value).T.reshape(film, film, per_pass, 3)
        passes.append(flat.mean(2))
    return np.mean(passes, 0), np.var(passes, 0, ddof=1) / 16


def walk(mi, scene, ray):
    """Follow a ray through null surfaces: the surface it ends on, and (emission, transmittance)."""
    import drjit as dr

    value, through = mi.Color3f(0), mi.Color3f(1)
    for _ in range(4):
        si = scene.ray_intersect(ray)
        emitter = si.emitter(scene)
        value += through * emitter.eval(si, si.is_valid() & (emitter != None))  # noqa: E711
        bsdf = si.bsdf()
        null = si.is_valid() & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        through = dr.select(null, through * bsdf.eval_null_transmission(si, null), through)
        ray = dr.select(null, si.spawn_ray(ray.d), ray)
    return scene.ray_intersect(ray), (value, through)


@pytest.mark.parametrize("law", [slow("linear"), "exponential"])
def test_uniform_opaque_field_is_an_area_light(mi, asset_file, law):
    asset = uniform_asset(1e4, [4.0, 2.0, 1.0], law=law)
    place = similarity(rotation([0, 1, 1], 25), 0.3, [0, 1.0, 0])
    baked = render(room(lumitree.shape(asset_file(asset), place)), 2048)
    plain = render(
        room(
            {
                "type": "cube",
                "to_world": mi.ScalarTransform4f(place),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [4.0, 2.0, 1.0]}},
            }
        ),
        2048,
        seed=77,
    )
    assert agree(baked, plain)
    assert baked[0].mean() == pytest.approx(plain[0].mean(), rel=0.02)


@pytest.mark.slow
def test_empty_field_is_not_there(mi, asset_file):
    """Behind it a window and a ball whose shadow falls through the empty proxy."""
    empty = make_asset(np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros((0, 3, 9)))
    extra = {
        "window": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f()
            .look_at([0, 2, -2], [0, 0.5, 0], [0, 1, 0])
            .scale(0.5),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 5}},
        },
        "ball": {"type": "sphere", "center": [0, 1.6, -1.2], "radius": 0.2},
    }
    lamp = lumitree.shape(asset_file(empty), similarity(np.eye(3), 0.6, [0, 1.0, 0]))
    assert agree(render(room(lamp, **extra), 512), render(room(None, **extra), 512, seed=99))


def test_half_transparent_field_lets_half_of_other_light_through(mi, asset_file):
    """A slab of opacity 1/2 that emits nothing halves the light seen through it."""
    asset = uniform_asset(0.25, [0.0, 0.0, 0.0])
    lamp = lumitree.shape(asset_file(asset), similarity(np.eye(3), 1.0, [0, 0, 0]))
    scene = mi.load_dict(
        {
            "type": "scene",
            "lamp": lamp,
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 2}},
        }
    )
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, -5), mi.Vector3f(0, 0, 1)))
    through = si.bsdf().eval_null_transmission(si)
    assert np.array(through).ravel() == pytest.approx(0.5, abs=1e-3)
    integrator = mi.load_dict({"type": "volpath", "max_depth": 3})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1)
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(0.1, 0.2, -5), mi.Vector3f(0, 0, 1)))
    seen, _, _ = integrator.sample(scene, sampler, ray)
    assert np.array(seen).ravel() == pytest.approx(1.0, abs=0.01)


def test_frames_rotate_the_emission(mi, asset_file):
    """A lamp turned by 90° shows on its side what it showed in front."""
    path = asset_file(random_asset(21))
    turn = similarity(rotation([0, 1, 0], 90))
    seen = []
    for matrix, direction in ((np.eye(4), [0, 0, -1.0]), (turn, [-1.0, 0, 0])):
        scene = mi.load_dict({"type": "scene", "lamp": lumitree.shape(path, matrix)})
        offsets = np.linspace(-0.83, 0.83, 8)  # off the planes between cells
        points = np.array([[a, b, 3.0] for a in offsets for b in offsets])
        points = points @ matrix[:3, :3].T
        ray = mi.Ray3f(on_device(mi.Point3f, points), mi.Vector3f(*direction))
        si = scene.ray_intersect(ray)
        seen.append(np.array(si.emitter(scene).eval(si)))
    assert seen[0] == pytest.approx(seen[1], abs=2e-3)
    assert seen[0].max() > 1


def test_scene_xml(mi, asset_file, tmp_path):
    asset_file(random_asset(4), "lamp.lumitree")
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="lumitree_proxy">'
        '<string name="filename" value="lamp.lumitree"/>'
        '<transform name="to_world"><scale value="2"/><translate y="1"/></transform>'
        "</shape></scene>"
    )
    scene = mi.load_file(str(tmp_path / "scene.xml"))
    box = scene.bbox()
    assert np.array(box.min).ravel() == pytest.approx([-2, -1, -2], abs=1e-5)
    assert np.array(box.max).ravel() == pytest.approx([2, 3, 2], abs=1e-5)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.0, 2, 1, 1]), "non-uniformly"),
        (np.array([[1, 0.3, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), "shears"),
        (np.diag([1.0, 1, -1, 1]), "mirrors"),
        (np.full((4, 4), np.nan), "finite"),
    ],
)
def test_bad_transforms_are_refused(mi, asset_file, matrix, message):
    with pytest.raises(LumitreeError, match=message):
        lumitree.shape(asset_file(random_asset(0)), matrix)


@pytest.mark.parametrize("option", ["sampling", "appearance"])
def test_plugins_refuse_unknown_words(mi, asset_file, option):
    shape = dict(lumitree.shape(asset_file(random_asset(0))))
    shape["emitter"] = {**shape["emitter"], option: "odd"}
    with pytest.raises(RuntimeError, match=f"{option} is 'odd'"):
        mi.load_dict(shape)


def test_unknown_sampling_and_missing_asset(mi, asset_file, tmp_path):
    with pytest.raises(LumitreeError, match="sampling is 'odd'"):
        lumitree.shape(asset_file(random_asset(0)), sampling="odd")
    with pytest.raises(LumitreeError, match="does not exist"):
        lumitree.shape(tmp_path / "nothing.lumitree")
