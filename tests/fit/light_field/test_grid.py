"""The grid of a light field: as fine as the light needs, whatever the box of the lamp."""

import dataclasses

import numpy as np
import pytest

import lumitree
from lumitree.errors import LumitreeError
from lumitree.fit.light_field.bake import bake_light_field, grid_depth
from lumitree.lamp.luminaire import load_luminaire
from lumitree.trace.light_field_config import LEAST_DEPTH, LightFieldConfig
from support.chandelier import chandelier, irradiance_errors, references
from support.lamps import AREA, cube, lamp_of, sphere
from support.light_fields import assert_equal_fields

CONFIG = LightFieldConfig(paths=1 << 15, batch=1 << 15, resolution=8)


@pytest.mark.parametrize(
    ("chain", "depth"), [(0.0, LEAST_DEPTH), (1.0, 6), (2.5, 7), pytest.param(20.0, 7, id="limit")]
)
def test_cells_are_as_small_as_without_the_chain(mi, chain, depth):
    """The box is 1, 2, 3.5 and 21 m high; 128 cells a side are the most."""
    assert grid_depth(load_luminaire(chandelier(chain))) == depth


@pytest.mark.parametrize("name", ["bulbs", "portica"])
def test_lamps_whose_light_is_in_many_cells_keep_them(mi, name):
    """`bulbs` fills its box; `portica` does not, but finer cells would get too few paths."""
    assert grid_depth(load_luminaire(name)) == LEAST_DEPTH


def test_a_faint_glow_far_away_does_not_make_cells_larger(mi, tmp_path):
    """A dark floor 2 m below gets 3 % of the light of a bulb, and reflects a tenth of this."""
    dark = '<bsdf type="diffuse"><spectrum name="reflectance" value="0.1"/></bsdf>'
    floor = cube("floor", (0.5, 0.01, 0.5), (0, -2, 0), dark)
    lamp = lamp_of(tmp_path, sphere("bulb", 0.05, inside=AREA), floor)
    assert grid_depth(lamp) == 7


def test_a_lamp_without_light_keeps_its_cells_and_is_refused(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("bulb", 1, inside=AREA), sphere("shell", 2))
    assert grid_depth(lamp) == LEAST_DEPTH
    with pytest.raises(LumitreeError, match="no light leaves"):
        bake_light_field(lamp, CONFIG, tmp_path)


@pytest.mark.slow
def test_equal_seeds_give_equal_fields_and_other_seeds_equal_grids(mi, tmp_path):
    lamp = load_luminaire(chandelier(1.0))

    def baked(seed=0, **changes):
        folder = tmp_path / f"{seed}{changes}"
        folder.mkdir(exist_ok=True)
        return bake_light_field(lamp, dataclasses.replace(CONFIG, **changes), folder, seed=seed)

    field = baked()
    assert field.depth == baked(seed=1).depth == 6
    assert_equal_fields(field, baked(depth=6))


@pytest.mark.slow
def test_light_between_the_arms_of_a_chandelier_on_a_chain(mi):
    """Against Mitsuba's direct light and path tracing."""
    config = lumitree.BakeConfig(parts=("light", "geometry"), irradiance_paths=0)
    asset = lumitree.bake(chandelier(2.5), config=config, progress=None).asset
    assert asset.light_field.depth == 7
    ratio, rms = irradiance_errors(asset, references(2.5, 0))
    assert np.array(list(ratio.values())) == pytest.approx(1, abs=0.02)
    assert max(rms.values()) < 0.06
