"""Elements of surfaces that emit: against Mitsuba's own shapes, normals, areas and radiance."""

import dataclasses

import numpy as np
import pytest

from lumitree.lamp.stored_geometry import stored_geometry
from support.lamps import lamp_of

COUNT, OFFSET = 1 << 15, 2e-3
LIGHT = '<emitter type="area"><rgb name="radiance" value="{0},{1},{2}"/></emitter>'
IMAGE = (
    '<emitter type="area"><texture type="bitmap" name="radiance">'
    '<string name="filename" value="image.exr"/><boolean name="raw" value="true"/>'
    '<string name="filter_type" value="{0}"/></texture></emitter>'
)
FLIP = '<boolean name="flip_normals" value="true"/>'
PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
{0}element face 4
property list uchar int vertex_indices
end_header
{1}
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""
# A tetrahedron: vertices, normals that are not the faces', texture coordinates.
VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 0.8, 0.1], [0.1, 0.2, 0.7]]) - 0.25
NORMALS = VERTICES + np.array([0.1, 0.05, 0])
TEXCOORDS = np.array([[0.1, 0.2], [1.3, 0.4], [0.3, 0.9], [-0.4, 0.7]])


def write_mesh(folder, name, **columns):
    """A PLY file of the tetrahedron."""
    names = {"normals": "nx ny nz", "texcoords": "u v"}
    header = "".join(
        f"property float {each}\n" for column in columns for each in names[column].split()
    )
    rows = np.concatenate([VERTICES, *columns.values()], axis=1)
    text = "\n".join(" ".join(map(str, row)) for row in rows)
    (folder / f"{name}.ply").write_text(PLY.format(header, text))


def described(flips):
    """Kind of a shape, what it holds besides its place and light, and whether it is mirrored."""
    mesh = '<string name="filename" value="{0}.ply"/>'
    plain = '<boolean name="face_normals" value="true"/>'
    ball = "<float name='radius' value='0.4'/>"
    ends = '<point name="p0" x="0.1" y="-0.3" z="0"/><point name="p1" x="0.2" y="0.4" z="0.5"/>'
    yield from (
        (name, kind, inside + flip, mirror)
        for mirror in (False, True)
        for flip in flips
        for name, kind, inside in (
            ("rectangle", "rectangle", ""),
            ("disk", "disk", ""),
            ("cylinder", "cylinder", ends + "<float name='radius' value='0.2'/>"),
            ("sphere", "sphere", ball),
            ("flat", "ply", mesh.format("plain") + plain),
            ("smooth", "ply", mesh.format("smooth")),
        )
    )
    yield "mapped", "ply", mesh.format("mapped"), False


def lamp_with(folder, mi, light, flips):
    """A lamp of one of each kind, far enough apart that none is in the way of another."""
    write_mesh(folder, "plain")
    write_mesh(folder, "smooth", normals=NORMALS)
    write_mesh(folder, "mapped", texcoords=TEXCOORDS)
    image = np.random.default_rng(1).uniform(0.1, 5, (5, 7, 3)).astype(np.float32)
    mi.Bitmap(image).write(str(folder / "image.exr"))
    shapes = []
    for i, (name, kind, inside, mirror) in enumerate(described(flips)):
        # Rectangles and disks may be stretched.
        size = (0.7, 0.4, 0.6) if kind in ("rectangle", "disk") else (0.6, 0.6, 0.6)
        turn = f'<rotate x="0.36" y="0.48" z="0.8" angle="{20 + 25 * i}"/>'
        x, y, z = np.array([-1, 1, 1]) * size if mirror else size
        shapes.append(
            f'<shape type="{kind}" id="{name}{i}"><transform name="to_world">'
            f'<scale x="{x}" y="{y}" z="{z}"/>{turn}<translate x="{3 * (i % 5)}" y="{3 * (i // 5)}"'
            f' z="{i % 3}"/></transform>{inside}{light(i)}</shape>'
        )
    return lamp_of(folder, *shapes)


@dataclasses.dataclass
class Sampled:
    """The elements of a lamp, and points of them."""

    lamp: object
    elements: object
    surface: np.ndarray
    point: object
    p: object
    found: object


def sampled(mi, lamp):
    """Points of all surfaces of a lamp, and what Mitsuba's rays meet there."""
    import drjit as dr

    from lumitree.rendering.geometry import Surfaces
    from lumitree.rendering.straight_light import Elements

    surfaces = Surfaces(stored_geometry(lamp)).emitting(lamp.frame)
    elements = Elements(surfaces)
    random = np.random.default_rng(0)
    entries = []
    for i in range(len(surfaces)):
        of = np.flatnonzero(elements.surface == i)
        area = elements.area[of]
        entries.append(random.choice(of, COUNT, p=area / area.sum()))
    entry = mi.UInt32(np.concatenate(entries).astype(np.uint32))
    place = mi.Point2f(random.random((2, dr.width(entry))).astype(np.float32))
    point = elements.point(entry, place, mi.Bool(True))
    back = lamp.frame.world_from_local
    world, offset = mi.Matrix3f(back[:3, :3].tolist()), mi.Vector3f(*back[:3, 3].tolist())
    p = mi.Point3f(world @ mi.Vector3f(point.p) + offset)
    n = dr.normalize(world @ point.n)
    ray = mi.Ray3f(p + OFFSET * n, -n)
    si = lamp.scene.ray_intersect(ray)
    surface = np.repeat(np.arange(len(surfaces)), COUNT)
    return Sampled(lamp, elements, surface, point, np.array(p).T, (si, np.array(n).T, world))


@pytest.fixture(scope="module")
def plain(mi, tmp_path_factory):
    light = lambda i: LIGHT.format(1 + i, 2, 30 - i)  # noqa: E731
    return sampled(mi, lamp_with(tmp_path_factory.mktemp("plain"), mi, light, ("", FLIP)))


@pytest.fixture(scope="module")
def textured(mi, tmp_path_factory):
    light = lambda i: IMAGE.format(["bilinear", "nearest"][i % 2])  # noqa: E731
    folder = tmp_path_factory.mktemp("textured")
    return sampled(mi, lamp_with(folder, mi, light, ("",)))


@pytest.mark.parametrize("which", ["plain", "textured"])
def test_points_are_where_mitsuba_has_the_surface(mi, request, which):
    """A ray towards each hits it there, on the same side, and gets the same radiance."""
    import drjit as dr

    drawn = request.getfixturevalue(which)
    si, n, world = drawn.found
    hit = np.array(si.is_valid()) & (np.abs(np.array(si.t) - OFFSET) < 1e-4)
    # Mitsuba's true normal of a mirrored rectangle is on the other side than its frame's.
    along = np.abs((np.array(si.n).T * n).sum(axis=1)) > 1 - 1e-4
    facing = np.array(dr.normalize(world @ drawn.point.facing)).T
    along &= np.linalg.norm(np.array(si.sh_frame.n).T - facing, axis=1) < 3e-3
    si.wi = si.to_local(si.sh_frame.n)
    radiance = np.array(si.emitter(drawn.lamp.scene).eval(si)).T
    given = np.broadcast_to(np.array(drawn.point.radiance).T, radiance.shape)
    near = np.abs(radiance - given).max(axis=1) < 0.01 * radiance.max(axis=1)
    for i in range(drawn.surface.max() + 1):
        # Rays near an edge of a mesh may hit another face, or be in another texel.
        assert (hit & along & near)[drawn.surface == i].mean() > 0.985, i


def test_points_are_uniform_by_area(mi, plain):
    """Moments as of Mitsuba's `sample_position`; areas as of `surface_area`."""
    import drjit as dr

    numbers = np.array(dr.reinterpret_array(mi.UInt32, plain.found[0].shape))
    random = mi.load_dict({"type": "independent"})
    shapes = {
        int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(each))[0]): each
        for each in plain.lamp.scene.shapes()
    }
    seen = set()
    area = np.bincount(plain.elements.surface, plain.elements.area)
    for i in range(plain.surface.max() + 1):
        of = plain.surface == i
        number = np.bincount(numbers[of]).argmax()
        seen.add(number)
        shape = shapes[number]
        assert area[i] * plain.lamp.frame.scale**2 == pytest.approx(
            np.array(shape.surface_area()).item(), rel=1e-4
        )
        random.seed(3, COUNT)
        other = np.array(shape.sample_position(0, random.next_2d()).p).T
        centre = other.mean(axis=0)
        means, errors = [], []
        for each in (plain.p[of], other):
            x, y, z = (each - centre).T
            moments = np.stack(
                [x, y, z, x * x, y * y, z * z, x * y, x * z, y * z, x**3, y**3, z**3]
            )
            means.append(moments.mean(axis=1))
            errors.append(moments.std(axis=1) / COUNT**0.5)
        assert (np.abs(means[0] - means[1]) < 4.5 * np.hypot(*errors) + 1e-6).all(), i
    assert len(seen) == len(shapes)


@pytest.mark.parametrize("which", ["plain", "textured"])
def test_densities_integrate_to_one(request, which):
    """They are what each surface emits over its area; and mean radiance is the points' mean."""
    drawn = request.getfixturevalue(which)
    elements = drawn.elements
    area = np.bincount(elements.surface, elements.area)
    assert (elements.densities * area).sum() == pytest.approx(1)
    radiance = np.array(drawn.point.radiance).T
    mean = [
        np.broadcast_to(radiance, (len(drawn.surface), 3))[drawn.surface == i].mean()
        for i in range(len(area))
    ]
    share = area * mean / (area * mean).sum()
    assert elements.densities * area == pytest.approx(share, rel=0.03)
    density = np.array(drawn.point.density) / elements.densities[drawn.surface]
    assert np.abs(density - 1).max() < 1e-5
