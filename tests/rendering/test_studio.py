"""Lamps in soft light, before a grey backdrop."""

import dataclasses

import numpy as np
import pytest

from lumitree.core.frames import pose_towards
from lumitree.core.images import tonemap
from lumitree.lamp.stored_geometry import stored_geometry
from support.fields import uniform_asset
from support.geometry_assets import with_geometry
from support.lamps import AREA, cube, lamp_of, sphere

BACKDROP = tonemap(np.array(0.125))
POSE = pose_towards((0, 0, 1), (0, 1, 0), 4.0)
GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>'


@pytest.fixture
def lamp(mi, tmp_path):
    """A lit sphere on the left, and a grey cube on the right that it does not reach."""
    return lamp_of(
        tmp_path,
        sphere("lit", 0.3, (-0.7, 0, 0), AREA),
        cube("body", (0.3, 0.3, 0.3), (0.7, 0, 0), GREY),
        # The sphere's light to the right ends here.
        cube("wall", (0.01, 0.4, 0.4), (0, 0, 0), '<bsdf type="diffuse"/>'),
    )


def test_an_asset_and_its_luminaire_have_one_picture(lamp):
    from lumitree.rendering.studio import asset_photographs, luminaire_photographs

    asset = with_geometry(stored_geometry(lamp), lamp.frame)
    ours = asset_photographs(asset, [POSE], lamp.bounding_radius, 32, 256, 0.2)[0].astype(int)
    theirs = luminaire_photographs(lamp, [POSE], 32, 256, 0.2)[0].astype(int)
    assert np.abs(ours - theirs).mean() < 3


def test_own_light_and_soft_light_are_both_seen(lamp):
    from lumitree.rendering.studio import luminaire_photographs

    picture = luminaire_photographs(lamp, [POSE], 48, 64, 0.2)[0]
    assert (picture[0] == BACKDROP).all()
    middle = picture[23]
    # The radiance is 3, 2 and 1, at twice the exposure.
    assert (middle == tonemap(np.array([3, 2, 1]), 0.4)).all(axis=-1).sum() >= 5
    # The side of the cube that faces the camera has two softboxes before it.
    body = middle[30:36].mean()
    assert BACKDROP / 2 < body < 250
    assert np.ptp(middle[30:36].mean(axis=0)) < 3


def test_every_side_is_lit(lamp):
    """From the back and from above too."""
    from lumitree.rendering.studio import luminaire_photographs

    back, above = pose_towards((0, 0, -1), (0, 1, 0), 4.0), pose_towards((0, 1, 0), (0, 0, -1), 4.0)
    for picture in luminaire_photographs(lamp, [back, above], 48, 64, 0.2):
        lit = np.abs(picture.astype(int) - BACKDROP).max(axis=-1) > 2
        assert picture[lit].max(axis=-1).min() > 20


def test_a_field_is_seen_before_the_backdrop(mi):
    from lumitree.rendering.studio import asset_photographs, portrait

    field = uniform_asset(50.0, (5, 5, 5), law="exponential")
    picture = portrait(field, 16, 4).pixels
    assert (picture[0, 0] == BACKDROP).all()
    # The exposure brings the field's radiance to 0.9 of white, and the lamp is shown brighter.
    assert (picture[8, 8] == 255).all()
    dim = dataclasses.replace(field, light_factors=(0.1, 0.1, 0.1))
    assert (asset_photographs(dim, [POSE], 2.0, 16, 4, 0.1)[0][8, 8] < 255).all()


@pytest.mark.slow
def test_portraits_of_a_lamp_and_its_asset_are_exposed_alike(lamp):
    from lumitree.rendering.photograph import white_radiance
    from lumitree.rendering.studio import portrait

    shown = []
    taken = portrait(lamp, 32, 256, so_far=shown.append)
    baked = portrait(with_geometry(stored_geometry(lamp), lamp.frame), 32, 256)
    # The emitter's radiance of 3 becomes 0.9 of white.
    for each in (taken, baked):
        assert white_radiance(each.ev) == pytest.approx(3 / 0.9, rel=0.05)
    assert np.abs(taken.pixels.astype(int) - baked.pixels).mean() < 3
    assert all(each.ev == taken.ev for each in shown)
    darker = portrait(lamp, 32, 4, exposure=-1)
    assert darker.ev == pytest.approx(taken.ev + 1, abs=0.1)
