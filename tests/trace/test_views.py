"""Captured views of scenes whose radiance and opacity are known."""

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.dataset import Dataset
from support.slow import slow

SPHERE = (
    '<shape type="sphere"><float name="radius" value="2"/>'
    '<point name="center" value="5,1,0"/>{}</shape>'
)
AREA = '<emitter type="area"><rgb name="radiance" value="3,2,1"/></emitter>'


@pytest.fixture
def luminaire(mi, tmp_path):
    from lumitree.lamp.luminaire import load_luminaire

    def load(body, name="lamp.xml"):
        (tmp_path / name).write_text(f'<scene version="3.0.0">{body}</scene>')
        return load_luminaire(tmp_path / name)

    return load


def take(luminaire, folder, **settings):
    from lumitree.trace.cameras import capture

    settings = {"views": 2, "resolution": 32, "spp": 16, **settings}
    return list(capture(luminaire, folder, **settings).views())


def test_emissive_sphere(luminaire, tmp_path):
    lamp = luminaire(SPHERE.format(AREA))
    assert lamp.frame.half_extents == pytest.approx(1)
    assert lamp.frame.world_from_local[:3, 3] == pytest.approx([5, 1, 0])
    for view in take(lamp, tmp_path / "d"):
        # The sphere fills the circle of radius 1 in a view of half width sqrt(3).
        centre = np.s_[12:20, 12:20]
        assert view.radiance[centre] == pytest.approx(np.broadcast_to([3, 2, 1], (8, 8, 3)))
        assert (view.geometric[centre] == 1).all()
        assert (view.straight_through[centre] == 1).all()
        assert view.geometric.mean() == pytest.approx(np.pi / 12, rel=0.02)
        assert view.straight_through == pytest.approx(view.geometric, abs=1e-6)


def panes(bsdf, medium=""):
    """A large slab of the given material across z, and a small emitter far to the side."""
    slab = (
        '<shape type="cube"><transform name="to_world"><scale x="4" y="4" z="0.5"/></transform>'
        f"{bsdf}{medium}</shape>"
    )
    emitter = SPHERE.replace('"2"', '"0.1"').replace("5,1,0", "3.8,0,0.7")
    return slab + emitter.format(AREA)


def face_on_opacity(lamp, mi, samples=20000):
    """Straight-through opacity of a ray along -z through the slab's middle."""
    import drjit as dr

    from lumitree.trace.cameras import straight_through

    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, samples)
    ray = mi.Ray3f(dr.zeros(mi.Point3f, samples) + mi.Point3f(0, 0, 5), mi.Vector3f(0, 0, -1))
    return 1 - float(np.mean(np.array(straight_through(lamp.scene, sampler, ray, 32)[0])))


FRESNEL = 0.04  # ((1.5 - 1) / (1.5 + 1))²


def test_glass_slab_transmits_as_fresnel_says(luminaire, mi):
    lamp = luminaire(
        panes(
            '<bsdf type="dielectric"><float name="int_ior" value="1.5"/>'
            '<float name="ext_ior" value="1"/></bsdf>'
        )
    )
    assert face_on_opacity(lamp, mi) == pytest.approx(1 - (1 - FRESNEL) ** 2, abs=1e-4)


def test_thin_glass_transmits_as_fresnel_says(luminaire, mi):
    lamp = luminaire(
        panes(
            '<bsdf type="thindielectric"><float name="int_ior" value="1.5"/>'
            '<float name="ext_ior" value="1"/></bsdf>'
        )
    )
    # Each of the two faces is a pane: reflections inside a pane add up to 2F / (1 + F).
    pane = 1 - 2 * FRESNEL / (1 + FRESNEL)
    assert face_on_opacity(lamp, mi) == pytest.approx(1 - pane**2, abs=1e-4)


def test_absorbing_medium_attenuates(luminaire, mi):
    lamp = luminaire(
        panes(
            '<bsdf type="dielectric"><float name="int_ior" value="1.5"/>'
            '<float name="ext_ior" value="1"/></bsdf>',
            '<medium type="homogeneous" name="interior"><rgb name="sigma_t" value="0.25,0.5,1"/>'
            '<float name="scale" value="2"/><rgb name="albedo" value="0"/></medium>',
        )
    )
    assert lamp.has_media
    beer = np.exp(-np.array([0.5, 1, 2])).mean()
    assert face_on_opacity(lamp, mi) == pytest.approx(1 - (1 - FRESNEL) ** 2 * beer, abs=1e-4)


def test_alpha_mask_lets_light_through(luminaire, mi):
    lamp = luminaire(
        panes('<bsdf type="mask"><float name="opacity" value="0.3"/><bsdf type="diffuse"/></bsdf>')
    )
    # Mitsuba's mask chooses at random: 20000 samples, four standard deviations.
    assert face_on_opacity(lamp, mi) == pytest.approx(1 - 0.7**2, abs=0.014)


def test_mirror_and_diffuse_are_opaque(luminaire, mi):
    for bsdf in ('<bsdf type="conductor"/>', '<bsdf type="diffuse"/>'):
        assert face_on_opacity(luminaire(panes(bsdf)), mi) == 1


def test_glass_ball_that_bends_light_is_opaque(luminaire, mi):
    """A solid glass ball deflects all but the most central light by more than 15°."""
    import drjit as dr

    from lumitree.trace.cameras import straight_through

    lamp = luminaire(SPHERE.format('<bsdf type="dielectric"/>') + panes("").replace("4", "0.01"))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, 1000)
    for offset, passes in ((0.1, True), (1.4, False)):
        origin = dr.zeros(mi.Point3f, 1000) + mi.Point3f(5 + offset, 1, 9)
        ray = mi.Ray3f(origin, mi.Vector3f(0, 0, -1))
        through = np.array(straight_through(lamp.scene, sampler, ray, 32)[0])
        assert (through.max() > 0.5) == passes


def test_resumes_view_by_view(luminaire, tmp_path):
    lamp = luminaire(SPHERE.format(AREA))
    first = take(lamp, tmp_path / "d", views=3)
    path = tmp_path / "d" / "view_000002.exr"
    before = {p: p.stat().st_mtime_ns for p in path.parent.iterdir()}
    content = path.read_bytes()
    path.unlink()
    with pytest.raises(LumitreeError, match="1 of 3 views are missing"):
        list(Dataset.open(tmp_path / "d").views())
    second = take(lamp, tmp_path / "d", views=3)
    assert path.read_bytes() == content
    assert all(p.stat().st_mtime_ns == t for p, t in before.items() if p != path)
    assert np.array_equal(first[1].radiance, second[1].radiance)


def test_another_capture_in_the_way_is_refused(luminaire, tmp_path):
    lamp = luminaire(SPHERE.format(AREA))
    take(lamp, tmp_path / "d")
    with pytest.raises(LumitreeError, match="other settings or of another luminaire"):
        take(lamp, tmp_path / "d", resolution=16)
    with pytest.raises(LumitreeError, match="spp is 0"):
        take(lamp, tmp_path / "e", spp=0)


def test_test_views_are_not_train_views(luminaire, tmp_path):
    lamp = luminaire(SPHERE.format(AREA))
    train = take(lamp, tmp_path / "a")
    test = take(lamp, tmp_path / "b", split="test")
    assert {v.frame.halton_index for v in train} == {1, 2}
    assert {v.frame.halton_index for v in test} == {100001, 100002}


def test_rays_of_the_camera_are_those_of_the_dataset(luminaire, tmp_path):
    """The network trains on the rays that Mitsuba traced: a lit corner shows it."""
    from lumitree.core.frames import orthographic_rays

    spot = SPHERE.replace('"2"', '"0.05"').replace("5,1,0", "0.9,0.5,-0.3")
    box = '<shape type="cube"><bsdf type="null"/></shape>'
    lamp = luminaire(spot.format(AREA) + box)
    for view in take(lamp, tmp_path / "d", views=5, resolution=64):
        origins, direction = orthographic_rays(view.frame.pose, lamp.bounding_radius, 64)
        to_spot = np.array([0.9, 0.5, -0.3]) - origins
        distance = np.linalg.norm(np.cross(to_spot, direction), axis=-1)
        lit = view.radiance[..., 0] > 1.5
        assert lit.any()
        assert distance[lit].max() < 0.09
        assert not lit[distance > 0.09].any()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("", "no shapes"),
        ('<shape type="sphere"/>', "no emitter"),
        (SPHERE.format(AREA) + '<emitter type="constant"/>', "constant"),
        (SPHERE.format(AREA) + '<emitter type="point"/>', "without a surface"),
        (
            '<shape type="ply"><string name="filename" value="no.ply"/>' + AREA + "</shape>",
            "no.ply.*not found",
        ),
        ('<shape type="ball">' + AREA + "</shape>", 'Plugin "ball" not found'),
        (SPHERE.format(AREA) + AREA, "without a surface"),
        ("<unknown/>", "unsupported XML element"),
        (SPHERE.format(AREA) + '<medium type="heterogeneous" name="m"/>', "heterogeneous"),
    ],
)
def test_bad_luminaires_are_refused(luminaire, body, message):
    with pytest.raises(LumitreeError, match=message) as caught:
        luminaire(body)
    assert "\n" not in str(caught.value)
    assert ".cpp" not in str(caught.value)


def test_missing_files_and_wrong_formats(mi, tmp_path):
    from lumitree.lamp.luminaire import load_luminaire

    with pytest.raises(LumitreeError, match="neither a file nor built in"):
        load_luminaire("no_such_lamp")
    (tmp_path / "lamp.fbx").write_bytes(b"Kaydara\x00")
    with pytest.raises(LumitreeError, match=r"is an FBX model; expected \.xml"):
        load_luminaire(tmp_path / "lamp.fbx")
    (tmp_path / "lamp.skp").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(LumitreeError, match=r"has an unsupported format; expected \.xml"):
        load_luminaire(tmp_path / "lamp.skp")
    (tmp_path / "half.xml").write_text('<scene version="3.0.0"><shape')
    with pytest.raises(LumitreeError, match=r"half\.xml cannot be loaded"):
        load_luminaire(tmp_path / "half.xml")


@pytest.mark.parametrize(("resolution", "samples"), [slow(1500, 128), (64, 1 << 12)])
def test_every_batch_of_a_view_has_random_numbers_of_its_own(
    luminaire, monkeypatch, resolution, samples
):
    """Above 1024² a batch has fewer than eight samples a pixel; seeds used to repeat."""
    from lumitree.core.seeds import Purpose, SeedStream
    from lumitree.trace.cameras import Camera

    batches = []

    def trace(self, pose, samples, seed):
        batches.append((samples, seed))
        return 0.0

    monkeypatch.setattr(Camera, "_trace", trace)
    camera = Camera(luminaire(SPHERE.format(AREA)), resolution, samples)
    for index in (1, 2):
        camera.take(np.eye(4), SeedStream(Purpose.CAPTURE, index))
    assert sum(count for count, _ in batches) == 2 * samples
    assert len({seed for _, seed in batches}) == len(batches)
    first = batches[: len(batches) // 2]
    camera.take(np.eye(4), SeedStream(Purpose.CAPTURE, 1))
    assert batches[-len(first) :] == first
