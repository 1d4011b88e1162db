"""The light field as an emitter: against sums over all cells, and as a part of an asset."""

import dataclasses

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field, unpack
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame, rotation, similarity
from support.fields import make_asset, uniform_asset
from support.receivers import HALF, POINTS, device_point, uniform_samples
from support.slow import slow, slow_but
from support.walls import agree, irradiance

DEPTH, RESOLUTION = 3, 8
TURNED = similarity(rotation([0, 1, 1], 25), 0.3, [0, 1.0, 0])


def some_light(seed=1, count=24):
    """Cells anywhere in the box, each bright in some of its bins."""
    random = np.random.default_rng(seed)
    inside = np.argwhere(np.ones((8, 8, 8)))
    inside = inside[(np.abs((inside + 0.5) / 4 - 1) < HALF).all(axis=1)]
    cells = inside[random.choice(len(inside), count, replace=False)]
    intensity = random.exponential(1, (count, RESOLUTION**2, 3))
    intensity *= random.random((count, RESOLUTION**2, 1)) < 0.4
    return make_light_field(cells, intensity, DEPTH)


def even_light():
    """Cells whose sums have their light in the same places: eight equal ones in each sum."""
    random = np.random.default_rng(2)
    sums = np.array([[0, 1, 1], [1, 1, 2], [2, 2, 1], [3, 1, 1], [3, 2, 2]])
    cells = (2 * sums[:, None] + np.argwhere(np.ones((2, 2, 2)))).reshape(-1, 3)
    intensity = random.exponential(1, (len(sums), RESOLUTION**2, 3))
    return make_light_field(cells, np.repeat(intensity, 8, axis=0), DEPTH)


@pytest.fixture(scope="module")
def light(mi):
    from lumitree.rendering.device_light import DeviceLight

    return DeviceLight(some_light(), HALF, levels=True)


@pytest.fixture(scope="module")
def levels(mi):
    """A light field by level of its receivers: of a few cells, and of sums."""
    from lumitree.rendering.device_light import DeviceLight
    from lumitree.rendering.light_table import LevelChoice

    near, far = (DeviceLight(each(), HALF, levels=True) for each in (some_light, even_light))
    near.choice = LevelChoice(HALF, np.array([np.inf]))
    far.choice = LevelChoice(HALF, np.array([-1.0]))
    return near, far


def seen_from(mi, light, x, direction):
    """Radiance and density [N] of directions from a point outside the box."""
    from lumitree.rendering.sampling import BoxProxy

    distance, _, enters = BoxProxy(HALF).enter(x, direction)
    return light.eval(x, x + distance * direction, direction, enters)


def boxes(field):
    """Lower and upper corners [C, 3] of the cells inside the box."""
    side = 2 / (1 << field.depth)
    lower = field.cells * side - 1
    return np.maximum(lower, -HALF), np.minimum(lower + side, HALF)


def chances(mi, light, x):
    """Probability [C] of each cell for a receiver."""
    import drjit as dr

    cells = dr.arange(mi.UInt32, len(some_light().cells))
    return np.array(light.table.probability(light._tables.around[0].index(x), cells), np.float64)


@pytest.mark.parametrize("name", POINTS)
def test_radiance_and_density_are_sums_over_all_cells(mi, light, name):
    from lumitree.rendering.device_light import smooth_bin
    from lumitree.rendering.sampling import cone_pdf, sample_cone

    field = some_light()
    count = 4096
    origin = device_point(mi, name)
    radius = float(np.linalg.norm(HALF))
    direction = sample_cone(origin, mi.Float(radius), uniform_samples(mi, count).next_2d())
    radiance, density = seen_from(mi, light, origin, direction)
    meets = np.array(density) > 0
    d, x = np.array(direction, np.float64).T, np.array(POINTS[name])
    lower, upper = boxes(field)
    near, far = (lower - x) / d[:, None], (upper - x) / d[:, None]
    first = np.maximum(np.minimum(near, far).max(axis=2), 0)
    last = np.maximum(np.maximum(near, far).min(axis=2), first)
    volume = (upper - lower).prod(axis=1)
    intensity = unpack(field.dense(field.intensity)) * field.scale
    bins = np.array(smooth_bin(-direction, RESOLUTION))
    expected = np.einsum("nc,cnk->nk", (last - first) / volume, intensity[:, bins])
    assert meets.mean() > 0.3
    found = np.array(radiance, np.float64).T
    scale = expected[meets].mean()
    assert np.abs(found[meets] - expected[meets]).max() < 2e-3 * max(scale, expected.max())
    assert not found[~meets].any()
    # The table's row of the receiver, from its own definition.
    third = chances(mi, light, origin) / (3 * volume)
    assert (third * 3 * volume).sum() == pytest.approx(1, abs=1e-4)
    assert third.min() > 0
    uniform = float(np.array(cone_pdf(origin, radius))[0])
    expected = 0.9 * ((last**3 - first**3) @ third) + 0.1 * uniform
    assert np.array(density)[meets] == pytest.approx(expected[meets], rel=5e-3)


@pytest.mark.parametrize("name", POINTS)
def test_samples_follow_their_density_and_weigh_the_same_light(mi, light, name):
    import drjit as dr

    from lumitree.core.octahedral import bin_of
    from lumitree.rendering.sampling import cone_pdf, sample_cone

    count, coarse = 1 << 19, 16
    origin = device_point(mi, name)
    direction = light.sample(origin, uniform_samples(mi, count).next_2d())
    radiance, density = seen_from(mi, light, origin, direction)
    hit = np.array(density) > 0
    weight = np.where(hit, np.array(dr.mean(radiance)) / np.maximum(density, 1e-30), 0)
    # The same from directions that are uniform over the bounding sphere.
    radius = float(np.linalg.norm(HALF))
    plain = sample_cone(origin, mi.Float(radius), uniform_samples(mi, count, 1).next_2d())
    other, pdf = seen_from(mi, light, origin, plain)
    uniform = np.array(cone_pdf(origin, radius))[0]
    plain_weight = np.array(dr.mean(other), np.float64) / uniform
    error = np.hypot(weight.std(), plain_weight.std()) / np.sqrt(count)
    assert error < 0.02 * weight.mean()
    assert weight.mean() == pytest.approx(plain_weight.mean(), abs=4 * error)
    # χ² by bins of direction; the expected counts have noise of their own.
    parts = coarse**2
    drawn = np.bincount(np.array(bin_of(direction, coarse))[hit], minlength=parts) / count
    where = np.array(bin_of(plain, coarse))
    share = np.array(pdf, np.float64) / uniform
    mean = np.bincount(where, share, parts) / count
    variance = np.bincount(where, share**2, parts) / count**2 + mean / count
    used = mean * count > 20
    chi = ((drawn - mean)[used] ** 2 / variance[used]).sum()
    assert chi < used.sum() + 5 * np.sqrt(2 * used.sum())
    # A tenth of the samples is uniform, which bounds every weight.
    assert weight.max() <= np.array(dr.mean(radiance)).max() / (0.099 * uniform)


@pytest.mark.parametrize("name", POINTS)
@pytest.mark.parametrize("other", [0.0, 0.02, 50.0])
@pytest.mark.parametrize("level", [0, 1])
def test_points_and_rays_share_the_light(mi, levels, level, name, other):
    """By direction and distance: both parts add up to the radiance, for each bin of direction.

    `other` is b at the lamp's centre; it depends on the direction, as a BSDF's density does.
    """
    import drjit as dr

    from lumitree.core.octahedral import bin_of
    from lumitree.rendering.sampling import BoxProxy, cone_pdf, sample_cone

    count, coarse = 1 << 20, 4
    light, field = levels[level], [some_light, even_light][level]()
    origin = device_point(mi, name)
    axis = dr.normalize(mi.Vector3f(origin))

    def density(direction):
        return other * (0.01 + dr.square(dr.dot(axis, direction)))

    samples = uniform_samples(mi, count).next_2d()
    direction, target = light.sample_point(origin, mi.Vector3f(0), samples)
    arrives = BoxProxy(HALF).enter(origin, direction)[2]
    weight = light.contribution(target, mi.Float(density(direction)), arrives)
    radius = float(np.linalg.norm(HALF))
    plain = sample_cone(origin, mi.Float(radius), uniform_samples(mi, count, 1).next_2d())
    near, _, enters = BoxProxy(HALF).enter(origin, plain)
    entry = origin + near * plain
    # The bins of both depend on all bits of the ray.
    dr.eval(entry, plain)
    whole, _ = light.eval(origin, entry, plain, enters, parallel=True)
    rest = mi.Color3f(0)
    if other:
        inverse, end = dr.rcp(density(plain)), mi.Float(dr.inf)
        rest = light.received(origin, entry, plain, inverse, end, enters)
        # Only the balance heuristic with a positive b bounds the weights of near points.
        volume = np.array(light.cells.volume)
        brightest = unpack(field.intensity).max() * field.scale * 8**level
        # A point is chosen as for a diffuse surface, with a b of 1 / πR.
        least = min(np.array(density(direction)).min(), 1 / (np.pi * radius))
        assert np.array(weight).max() <= brightest / (volume.min() * least) * 1.001
    solid_angle = 1 / np.array(cone_pdf(origin, radius))[0]
    missing = np.array(whole - rest, np.float64)[1] * solid_angle
    found = np.array(weight, np.float64)[1]
    assert (missing >= -1e-3 * missing.max()).all()
    parts = [
        (np.bincount(np.array(bin_of(d, coarse)), v**k, coarse**2) / count)
        for d, v in ((direction, found), (plain, missing))
        for k in (1, 2)
    ]
    error = np.sqrt((parts[1] + parts[3]) / count)
    assert error.max() < 0.05 * parts[2].max()
    assert (np.abs(parts[0] - parts[2]) < 4.5 * error + 1e-6 * parts[2].max()).all()


def test_rays_carry_the_flux_of_every_bin(mi, light):
    from lumitree.core.octahedral import bin_of, direction_in_bin, solid_angles
    from lumitree.rendering.device_light import smooth_bin

    field, count = some_light(), 1 << 20
    sampler = uniform_samples(mi, count)
    point, direction, flux = light.sample_ray(
        sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
    )
    flux = np.array(flux, np.float64).T
    intensity = unpack(field.dense(field.intensity)) * field.scale
    total = (intensity * solid_angles(RESOLUTION)[:, None]).sum((0, 1))
    error = flux.std(axis=0) / np.sqrt(count)
    assert (error < 2e-3 * total).all()
    assert (np.abs(flux.mean(axis=0) - total) < 4 * error + 1e-4 * total).all()
    # By cell and bin.
    p = np.array(point, np.float64).T
    lower, upper = boxes(field)
    inside = ((p[:, None] >= lower - 1e-6) & (p[:, None] <= upper + 1e-6)).all(axis=2)
    assert (inside.sum(axis=1) >= 1).all()
    index = inside.argmax(axis=1) * RESOLUTION**2 + np.array(bin_of(direction, RESOLUTION))
    parts = len(field.cells) * RESOLUTION**2
    green = flux[:, 1]
    found = np.bincount(index, green, parts) / count
    variance = np.bincount(index, green**2, parts) / count**2
    # The radiance that receivers get is linear between the middles of bins.
    many = 1 << 14
    bins = np.repeat(np.arange(RESOLUTION**2), many)
    within = uniform_samples(mi, len(bins), 1).next_2d()
    ways, density = direction_in_bin(on_device(mi.UInt32, bins), within, RESOLUTION)
    seen = intensity[:, np.array(smooth_bin(ways, RESOLUTION)), 1] / np.array(density)
    expected = seen.reshape(len(field.cells), -1, many).mean(axis=2).ravel()
    bright = (np.bincount(index, minlength=parts) > 30) & (variance > 0)
    assert bright.sum() > 300
    z = (found - expected)[bright] / np.sqrt(variance[bright])
    # Rounding moves a few samples over a bin's border.
    assert (np.abs(z) < 6).all()
    assert np.square(z).mean() == pytest.approx(1, abs=0.25)


def test_nothing_is_sampled_in_vain_far_away_or_along_axes(mi, light):
    import drjit as dr

    x = mi.Point3f([1e6, 0, 1e-7, 5.0], [0, -1e4, 2.0, 0], [0, 0, 0, 0])
    direction = light.sample(x, mi.Point2f([0.3, 0.5, 0.7, 0.9], [0.1, 0.9, 0.5, 0.2]))
    radiance, density = seen_from(mi, light, x, direction)
    assert np.isfinite(np.array(radiance)).all()
    assert np.isfinite(np.array(density)).all()
    along = mi.Vector3f(dr.zeros(mi.Float, 4), [0, -1, 1, 0], [1, 0, 0, -1])
    radiance, density = seen_from(mi, light, mi.Point3f(0.1, 3.0, -3.0), along)
    assert np.isfinite(np.array(radiance)).all()


def test_a_field_is_copied_to_the_device_once(mi):
    asset = light_field_asset(some_light(), LocalFrame(HALF, np.eye(4)), "test")
    first, second = (
        mi.load_dict(lumitree.shape(asset, place)).emitter() for place in (np.eye(4), TURNED)
    )
    assert first.lamp.stored is second.lamp.stored


def sphere_like(radiance):
    """A small cell that emits as a point light does: the same intensity in all directions."""
    cells = np.array([[3, 3, 3], [4, 3, 3], [3, 4, 3], [4, 4, 3]])
    cells = np.concatenate([cells, cells + np.array([0, 0, 1])])
    intensity = np.tile(np.asarray(radiance, np.float64), (8, 16, 1))
    return make_light_field(cells, intensity, DEPTH)


@pytest.mark.parametrize("kind", ["lumitree_path", "path"])
@pytest.mark.parametrize(
    ("point", "normal"),
    [([0.1, -9.0, 0.2], [0, 1, 0]), ([2.0, 1.2, 0.1], [-1, 0, 0]), ([0.2, 0.4, 0.1], [0, 1, 0])],
)
def test_a_wall_gets_the_light_of_all_points_of_the_cells(mi, kind, point, normal):
    """An asset of this part alone, turned and scaled, with either integrator."""
    field = sphere_like([4.0, 2.0, 1.0])
    asset = light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "test")
    shape = lumitree.shape(asset, TURNED)
    found, error = irradiance(mi, {"lamp": shape}, point, normal, kind=kind, samples=1 << 18)
    random = np.random.default_rng(0)
    at = (
        TURNED
        @ np.concatenate([(random.random((1 << 18, 3)) - 0.5) / 2, np.ones((1 << 18, 1))], 1).T
    )
    way = np.array(point) - at[:3].T
    distance = np.linalg.norm(way, axis=1)
    cosine = -(way @ normal) / distance
    # Intensities of the local frame are per area of the scene's unit squared.
    part = 0.3**2 * 8 * np.maximum(cosine, 0) / distance**2
    expected = part.mean() * np.array([4.0, 2.0, 1.0])
    noise = part.std() / np.sqrt(len(part)) * 4
    agree((found, error), (expected, noise))


SURFACES = {
    "diffuse": {"type": "diffuse"},
    "sharp": {"type": "roughconductor", "alpha": 0.05},
    "glossy": {"type": "roughconductor", "alpha": 0.15},
    "rough": {"type": "roughconductor", "alpha": 0.5},
    "both": {"type": "roughplastic", "alpha": 0.1},
    "coated": {"type": "plastic"},
}


@pytest.mark.slow
@pytest.mark.parametrize("bsdf", slow_but(["coated"], SURFACES))
@pytest.mark.parametrize("height", [0.01, slow(3.0)])
def test_each_surface_gets_the_light_once(mi, bsdf, height):
    """Against uniform sampling of the proxy, whose weights are by direction alone; two lamps."""
    asset = light_field_asset(some_light(), LocalFrame(HALF, np.eye(4)), "test")
    to = mi.ScalarTransform4f
    # The lowest point of the first lamp's box is at 0.
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1) * HALF[:, None]
    turn = rotation([0, 1, 1], 25)
    lift = -0.3 * (turn @ corners)[1].min()
    places = [similarity(turn, 0.3, [0, lift, 0]), similarity(turn, 0.2, [1.2, lift, 0.3])]
    sensor = {
        "type": "perspective",
        "fov": 30,
        "to_world": to().look_at([1.5, 1.5, 2.5], [0.2, -height, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
    }
    floor = {
        "type": "rectangle",
        "to_world": to().translate([0, -height, 0]).rotate([1, 0, 0], -90).scale(4),
        "bsdf": SURFACES[bsdf],
    }
    # Directly seen lamps would add noise and hide errors.
    integrator = {"type": "lumitree_path", "max_depth": 2, "hide_emitters": True}
    found = {}
    for index, kind in enumerate(("emission", "uniform")):
        lamps = {f"lamp{i}": lumitree.shape(asset, p, sampling=kind) for i, p in enumerate(places)}
        scene = mi.load_dict({"type": "scene", "sensor": sensor, "floor": floor, **lamps})
        images = [
            np.array(
                mi.render(
                    scene,
                    integrator=mi.load_dict(integrator),
                    spp=1024,
                    seed=100 * index + seed,
                )
            )[..., :3]
            for seed in range(12)
        ]
        found[kind] = np.array(images, np.float64)
    mean = {kind: v.mean(0) for kind, v in found.items()}
    error = np.sqrt(sum(v.var(0, ddof=1) / len(v) for v in found.values()))
    z = (mean["emission"] - mean["uniform"]) / np.maximum(error, 1e-9)
    assert (np.abs(z) < 6).all()
    total = [v.mean(axis=(1, 2, 3)) for v in found.values()]
    noise = np.sqrt(sum(v.var(ddof=1) / len(v) for v in total))
    assert noise < 0.02 * total[1].mean()
    assert total[0].mean() == pytest.approx(total[1].mean(), abs=4 * noise)


@pytest.mark.slow
def test_light_by_way_of_a_mirror_counts_in_full(mi):
    """A wall that gets the lamp's light by a mirror alone: next-event estimation finds none."""
    asset = light_field_asset(
        sphere_like([4.0, 2.0, 1.0]), LocalFrame(np.ones(3), np.eye(4)), "test"
    )
    to = mi.ScalarTransform4f
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    mirror = {
        "type": "rectangle",
        "to_world": to().look_at([0, 0, -2], [0, 0, 0], [0, 1, 0]).scale(3),
        "bsdf": {"type": "conductor", "material": "none"},
    }
    # Between the lamp and the wall.
    screen = {
        "type": "rectangle",
        "to_world": to().look_at([0, 0.5, 0], [0, 2, 0], [0, 0, 1]).scale([0.8, 0.8, 1]),
        "bsdf": {"type": "twosided", "bsdf": grey},
    }
    lamp = similarity(rotation([0, 1, 1], 25), 0.3, [0, 1, 0])
    wall = [0.0, 0.0, 0.1], [0, 0.3, -1]
    found = irradiance(
        mi,
        {"lamp": lumitree.shape(asset, lamp), "mirror": mirror, "screen": screen},
        *wall,
        samples=1 << 24,
        path_depth=3,
    )
    # The mirror image of the lamp, seen directly. Its orientation does not matter.
    image = similarity(np.eye(3), 0.3, [0, 1, -4])
    direct = irradiance(mi, {"lamp": lumitree.shape(asset, image)}, *wall)
    (a, error_a), (b, error_b) = found, direct
    error = np.hypot(error_a, error_b)
    assert (error < 0.03 * b).all()
    assert (np.abs(a - b) < 4 * error).all()


@pytest.mark.slow
def test_a_camera_sees_the_field_and_a_wall_gets_the_light_field_light(mi):
    """Directly and by a mirror; nothing counts twice."""
    opaque = uniform_asset(1e4, [1.0, 1.0, 1.0])
    field = sphere_like([4.0, 2.0, 1.0])
    divided = dataclasses.replace(opaque, light_field=field)
    alone = light_field_asset(field, divided.frame, "test")
    place = similarity(np.eye(3), 0.3, [0, 1, 0])
    lamp = {"lamp": lumitree.shape(divided, place)}
    to = mi.ScalarTransform4f
    mirror = {
        "type": "rectangle",
        "to_world": to().look_at([0, 1, 3], [0, 1, 0], [0, 1, 0]).scale(2),
        "bsdf": {"type": "conductor", "material": "none"},
    }
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    for target, origin in (([0, 1, 0], [0.1, 1, 2]), ([0, 1, 3], [0.1, 1.0, 2])):
        sensor = {
            "type": "radiancemeter",
            "to_world": to().look_at(origin, target, [0, 1, 0]),
            "film": film,
        }
        things = {"mirror": mirror} if target[2] else {}
        scene = mi.load_dict({"type": "scene", "sensor": sensor, **lamp, **things})
        image = mi.render(scene, integrator=mi.load_dict({"type": "lumitree_path"}), spp=256)
        assert np.array(image).ravel()[:3] == pytest.approx([1, 1, 1], rel=2e-3)
    # In the plane of a face, which is visible or not by rounding.
    wall = [1.5, 0.8, 0.3], [-1, 0, 0]
    both = irradiance(mi, lamp, *wall)
    agree(both, irradiance(mi, {"lamp": lumitree.shape(alone, place)}, *wall))
    uniform = {"lamp": lumitree.shape(divided, place, sampling="uniform")}
    agree(irradiance(mi, uniform, *wall, samples=1 << 22), both)
    # Stock integrators take both from the field, and sample it by the light field.
    stock = irradiance(mi, lamp, *wall, kind="path")
    agree(stock, irradiance(mi, {"lamp": lumitree.shape(opaque, place)}, *wall))
    assert abs(stock[0][2] / both[0][2] - 1) > 0.1


@pytest.mark.slow
def test_light_of_others_passes_the_lamp_as_its_field_lets_it(mi):
    """A dark, half transparent field in front of a lit window, with and without exitant light."""
    glass = make_asset(
        np.zeros((1, 3)), [1], [0.7], np.full((1, 3, 1), -60.0), law="exponential", tree_depth=1
    )
    weak = make_light_field(np.array([[1, 1, 1]]), np.full((1, 16, 3), 1e-9), 2)
    divided = dataclasses.replace(glass, light_field=weak)
    window = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().look_at([0, 0, -3], [0, 0, 0], [0, 1, 0]),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 3.0}},
    }
    wall = [-0.4, -0.4, 2.5], [0, 0, -1]
    plain = irradiance(mi, {"window": window, "lamp": lumitree.shape(glass)}, *wall)
    both = irradiance(mi, {"window": window, "lamp": lumitree.shape(divided)}, *wall)
    empty, _ = irradiance(mi, {"window": window}, *wall)
    agree(both, plain)
    assert (plain[0] < 0.95 * empty).all()


@pytest.mark.parametrize("kind", ["point", "ball"])
def test_what_is_behind_a_light_in_the_box_does_not_dim_it(mi, kind):
    """The back half of the box is opaque; the light is before it, and so is the wall."""
    cells = np.array([[x, y, 0] for x in range(2) for y in range(2)])
    opaque = make_asset(cells, np.ones(4), np.full(4, 1e4), np.full((4, 3, 1), -60.0), tree_depth=1)
    weak = make_light_field(np.array([[1, 1, 1]]), np.full((1, 16, 3), 1e-9), 2)
    divided = dataclasses.replace(opaque, light_field=weak)
    light = {
        "point": {"type": "point", "position": [0.4, 0.3, 0.5], "intensity": 2.0},
        "ball": {
            "type": "sphere",
            "center": [0.4, 0.3, 0.5],
            "radius": 0.1,
            "emitter": {"type": "area", "radiance": 2.0 / (np.pi * 0.1**2)},
        },
    }[kind]
    wall = [0.2, 0, 3], [0, 0, -1]
    lamp = {"lamp": lumitree.shape(divided)}
    offset = np.array([0.2, 0, 3]) - [0.4, 0.3, 0.5]
    expected = np.full(3, 2.0 * offset[2] / np.linalg.norm(offset) ** 3)
    # Next-event estimation alone.
    agree(irradiance(mi, {"light": light, **lamp}, *wall), (expected, 0))


@pytest.mark.parametrize("sampling", ["emission", "uniform"])
def test_a_camera_in_a_field_sees_what_is_before_it(mi, sampling):
    """The back half of the box is opaque, and shines; the camera is before it, and so is a ball."""
    cells = np.array([[x, y, 0] for x in range(2) for y in range(2)])
    field = make_asset(
        cells, np.ones(4), np.full(4, 1e4), np.zeros((4, 3, 1)), tree_depth=1, max_radiance=4.0
    )
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 0.5}}
    ball = {
        "type": "sphere",
        "center": [0.5, 0, 0.3],
        "radius": 0.05,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}},
    }
    film = {"type": "hdrfilm", "width": 1, "height": 1, "rfilter": {"type": "box"}}
    for target, expected in (((0, 0, 9), 0.5), ((0, 0, -9), 2.0), ((0.5, 0, 0.3), 0.0)):
        place = mi.ScalarTransform4f().look_at([0, 0, 0.6], target, [0, 1, 0])
        sensor = {"type": "radiancemeter", "to_world": place, "film": film}
        lamp = lumitree.shape(field, sampling=sampling)
        scene = mi.load_dict(
            {"type": "scene", "sensor": sensor, "sky": sky, "ball": ball, "lamp": lamp}
        )
        integrator = mi.load_dict({"type": "lumitree_path"})
        image = np.array(mi.render(scene, integrator=integrator, spp=4)).ravel()
        assert image[:3] == pytest.approx(expected, abs=1e-3)


def test_parallel_rays_see_the_mean_over_bins(mi):
    """The rays of an orthographic camera are parallel."""
    from lumitree.rendering.device_light import DeviceLight, bins_around

    random = np.random.default_rng(6)
    intensity = random.exponential(1, (1, RESOLUTION**2, 3))
    field = make_light_field(np.array([[3, 4, 3]]), intensity, DEPTH)
    light = DeviceLight(field, HALF)
    lower, upper = boxes(field)
    direction = np.array([-0.05, 0.02, -1.0])
    direction /= np.linalg.norm(direction)
    point = lower + (upper - lower) * random.random((1 << 14, 3))
    faces = (np.stack([lower, upper]) - point) / direction
    length = (faces.max(axis=0).min(axis=1) - faces.min(axis=0).max(axis=1)).mean()
    entry = on_device(mi.Point3f, point - 4 * direction)
    way = mi.Vector3f(*direction.tolist())
    radiance, _ = light.eval(entry, entry, way, mi.Bool(True), parallel=True)
    bright = sum(
        np.array(weight)[0] * unpack(field.dense(field.intensity))[0, np.array(index)[0]]
        for index, weight in bins_around(-way, RESOLUTION)
    )
    expected = field.scale * bright * length / (upper - lower).prod()
    assert np.array(radiance).mean(axis=1) == pytest.approx(expected, rel=0.02)


def test_the_mean_over_bins_is_linear_between_their_middles(mi):
    """Bins of one direction, against the bilinear weights of four bins; across the map's sides."""
    from lumitree.core.octahedral import bin_of, octahedral
    from lumitree.rendering.device_light import smooth_bin

    count, resolution = 1 << 16, 8
    values = np.random.default_rng(0).random(resolution**2)
    for way in ([0.3, 0.5, 0.7], [0.6, -0.2, -0.5], [0.99, 0.02, 0.03], [0.02, 0.01, -1]):
        # So near to one direction that the place on the map hardly changes.
        tilt = 1e-4 * (uniform_samples(mi, count).next_2d() - 0.5)
        direction = mi.Vector3f(way[0] + tilt.x, way[1] + tilt.y, way[2])
        bins = np.array(smooth_bin(direction, resolution))
        found = values[bins]
        uv = np.array(octahedral(mi.Vector3f(*way), resolution)).ravel()
        place = (uv + 1) * resolution / 2 - 0.5
        part = place - np.floor(place)
        expected = 0.0
        for x in (0, 1):
            for y in (0, 1):
                weight = abs(1 - x - part[0]) * abs(1 - y - part[1])
                offset = mi.Vector2f(*(np.floor(place) - place + (x, y)).tolist())
                neighbour = bin_of(mi.Vector3f(*way), resolution, offset)
                expected += weight * values[int(np.array(neighbour)[0])]
        error = found.std() / count**0.5
        assert abs(found.mean() - expected) < 4.5 * error + 1e-3


def test_beyond_a_side_of_the_map_are_the_next_directions(mi):
    """Bins at an offset of a bin are near, wherever the direction is."""
    from lumitree.core.octahedral import bin_of, middle_directions

    resolution = 16
    middles = middle_directions(resolution)
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            ways = on_device(mi.Vector3f, middles)
            found = np.array(bin_of(ways, resolution, mi.Vector2f(0.99 * x, 0.99 * y)))
            assert (middles * middles[found]).sum(axis=1).min() > np.cos(9 / resolution)
            if x or y:
                assert (found != np.arange(resolution**2)).mean() > 0.95


def test_bins_around_a_direction_are_those_of_the_slow_interpolation(mi):
    from lumitree.core.octahedral import bilinear_bins
    from lumitree.rendering.device_light import bins_around

    random = np.random.default_rng(0)
    directions = random.normal(size=(500, 3))
    found = bins_around(on_device(mi.Vector3f, directions), RESOLUTION)
    fast, slow = np.zeros((2, 500, RESOLUTION**2))
    everyone = np.arange(500)
    for index, weight in found:
        np.add.at(fast, (everyone, np.array(index)), np.array(weight))
    index, weight = bilinear_bins(directions, RESOLUTION)
    np.add.at(slow, (everyone[:, None], index), weight)
    assert fast == pytest.approx(slow, abs=1e-4)


def test_irradiance_is_the_sum_over_all_cells(mi, light):
    """Against many points of each cell, in NumPy."""
    from lumitree.core.octahedral import bilinear_bins

    field, samples = some_light(), 4000
    x, n = np.array([[1.7, 0.4, -0.9]]), np.array([[-1.0, 0.2, 0.3]])
    n /= np.linalg.norm(n)
    lower, upper = boxes(field)
    random = np.random.default_rng(0)
    within = random.random((len(lower), samples, 3))
    offset = lower[:, None] + within * (upper - lower)[:, None] - x
    bins, weights = bilinear_bins(-offset.reshape(-1, 3), RESOLUTION)
    intensity = field.dense(unpack(field.intensity)) * field.scale
    cells = np.repeat(np.arange(len(lower)), samples)
    value = (intensity[cells[:, None], bins] * weights[..., None]).sum(axis=1)
    squared = (offset.reshape(-1, 3) ** 2).sum(axis=1)
    cosine = np.maximum(offset.reshape(-1, 3) @ n[0], 0) / np.sqrt(squared)
    expected = (value * (cosine / squared)[:, None]).sum(axis=0) / samples
    count = 4000
    place = [np.repeat(each, count, axis=0) for each in (x, n)]
    random = mi.PCG32(count, 1)
    found = light.irradiance(
        on_device(mi.Point3f, place[0]), on_device(mi.Vector3f, place[1]), random, mi.Bool(True)
    )
    assert np.array(found).mean(axis=1) == pytest.approx(expected, rel=5e-3)
