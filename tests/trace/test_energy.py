"""Glass and media under capture's own integrator: no light is lost or made."""

import numpy as np
import pytest

from lumitree.rendering.scene import place_shapes
from support.lamps import AREA, GLASS, cube, lamp_of, sphere

FRESNEL = 0.04  # ((1.5 - 1) / (1.5 + 1))²
# Under radiance 1 from everywhere, a black surface that emits 1 is invisible.
WHITE_LAMP = sphere(
    "lamp", 0.1, (3, 0, 0), '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
    '<emitter type="area"><rgb name="radiance" value="1"/></emitter>',
)  # fmt: skip


def medium(sigma_t, albedo):
    return (
        f'<medium type="homogeneous" name="interior"><rgb name="sigma_t" value="{sigma_t}"/>'
        f'<rgb name="albedo" value="{albedo}"/></medium>'
    )


def load(tmp_path, *shapes):
    return lamp_of(tmp_path, *shapes)


def rays(mi, count, direction, origin=(0, 0, 0), spread=0.0, distance=5.0):
    """Parallel rays through a square about `origin`, from `distance` before it."""
    import drjit as dr

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(7, count)
    direction = dr.normalize(mi.Vector3f(np.array(direction, float)))
    offset = (sampler.next_2d() - 0.5) * 2 * spread
    frame = mi.Frame3f(direction)
    start = mi.Point3f(origin) + frame.to_world(mi.Vector3f(offset.x, offset.y, -distance))
    return sampler, mi.Ray3f(start, direction + dr.zeros(mi.Vector3f, count))


@pytest.mark.parametrize(
    ("shapes", "has_media"),
    [
        ([sphere("ball", 1, inside=GLASS)], False),
        ([sphere("outer", 1, inside=GLASS), sphere("inner", 0.9, inside=GLASS, flip=True)], False),
        ([sphere("milk", 1, inside=GLASS + medium("0.7", "1"))], True),
    ],
    ids=["ball", "shell", "scattering ball"],
)
def test_clear_glass_disappears_in_a_furnace(mi, tmp_path, shapes, has_media):
    from lumitree.trace.cameras import path_integrator

    luminaire = load(tmp_path, *shapes, WHITE_LAMP)
    assert luminaire.has_media == has_media
    furnace = mi.load_dict(
        {"type": "scene", "light": {"type": "constant", "radiance": 1.0}}
        | place_shapes(tmp_path / "lamp.xml", np.eye(4))
    )
    sampler, ray = rays(mi, 1 << 16, [0.3, -0.5, -1], spread=1.2)
    radiance, _, _ = path_integrator(luminaire, 256).sample(
        furnace, sampler, mi.RayDifferential3f(ray)
    )
    radiance = np.array(radiance)
    noise = radiance.std() / np.sqrt(radiance.shape[1])
    assert abs(radiance.mean() - 1) < 4 * noise + 1e-4


def mean_straight_through(mi, luminaire, count, direction):
    from lumitree.trace.cameras import straight_through

    sampler, ray = rays(mi, count, direction)
    return float(np.mean(np.array(straight_through(luminaire.scene, sampler, ray, 32)[0])))


def fresnel(cosine, ior):
    """Unpolarised Fresnel reflectance from air into glass, and the cosine inside."""
    inside = np.sqrt(1 - (1 - cosine**2) / ior**2)
    across = (cosine - ior * inside) / (cosine + ior * inside)
    along = (ior * cosine - inside) / (ior * cosine + inside)
    return (across**2 + along**2) / 2, inside


@pytest.mark.parametrize("degrees", [0, 40])
def test_slab_that_absorbs_and_scatters_follows_beer_and_fresnel(mi, tmp_path, degrees):
    """Scattered light has left the straight path, so scattering counts like absorption."""
    sigma_t = np.array([0.25, 0.5, 1.0])
    slab = cube("slab", (8, 8, 0.5), inside=GLASS + medium("0.25, 0.5, 1", "0.9, 0.5, 0.2"))
    luminaire = load(tmp_path, slab, WHITE_LAMP)
    angle = np.radians(degrees)
    through = mean_straight_through(mi, luminaire, 1000, [np.sin(angle), 0, -np.cos(angle)])
    reflected, inside = fresnel(np.cos(angle), 1.5)
    expected = (1 - reflected) ** 2 * np.exp(-sigma_t / inside).mean()
    assert through == pytest.approx(expected, rel=1e-4)


def test_transmitted_and_reflected_light_of_a_slab_add_up(mi, tmp_path):
    """A lamp in front of the slab shows R; straight-through is T but for inner reflections."""
    from lumitree.trace.cameras import path_integrator

    front = (
        '<shape type="rectangle"><transform name="to_world"><scale value="9"/>'
        '<rotate y="1" angle="180"/><translate z="6"/></transform>'
        '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
        '<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>'
    )
    luminaire = load(tmp_path, cube("slab", (8, 8, 0.5), inside=GLASS), front)
    count = 1 << 17
    sampler, ray = rays(mi, count, [0, 0, -1])
    radiance, _, _ = path_integrator(luminaire, 64).sample(
        luminaire.scene, sampler, mi.RayDifferential3f(ray)
    )
    reflected = float(np.array(radiance).mean())
    once = mean_straight_through(mi, luminaire, 1000, [0, 0, -1])
    transmitted = once / (1 - FRESNEL**2)
    assert once == pytest.approx((1 - FRESNEL) ** 2, rel=1e-4)
    # Each path is reflected or is not: four standard deviations.
    spread = np.sqrt(transmitted * (1 - transmitted) / count)
    assert reflected + transmitted == pytest.approx(1, abs=4 * spread)


def test_rectangles_and_spheres_are_luminaires(mi, tmp_path):
    flat = f'<shape type="rectangle">{AREA}</shape>'
    luminaire = load(tmp_path, flat, cube("box", 1))
    assert luminaire.bounding_radius == pytest.approx(np.sqrt(3))
    assert (luminaire.num_triangles, luminaire.num_emitters) == (14, 1)
    assert luminaire.size == pytest.approx([2, 2, 2])
