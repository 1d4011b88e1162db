"""Small inputs whose light is known, where they are at hand.

Their folder is ../shared/cases beside the repository, or what LUMITREE_CASES names. Values are
worked out by π A L.
"""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

from lumitree.core.photometry import luminance
from lumitree.errors import LumitreeWarning

CASES = Path(
    os.environ.get("LUMITREE_CASES", Path(__file__).parents[1].parent / "shared" / "cases")
)
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason=f"no cases at {CASES}")
LUMENS = {
    "02-emissive-uv-transform/01-tex.gltf": 31.416,
    "02-emissive-uv-transform/02-scalehalf.gltf": 125.664,
    "02-emissive-uv-transform/08-mirror-scale2.gltf": 31.416,
    "02-emissive-uv-transform/41-s2.obj": 21.457,
    "02-emissive-uv-transform/44-tile.obj": 21.457,
    "03-emissive-uv-palette/34-uv-negative.gltf": 31.416,
    "03-emissive-uv-palette/37-uv-line.gltf": 62.832,
    "03-emissive-uv-palette/38-palette-mixed.gltf": 125.664,
    "04-xml-touv-emission/h-touv-half-nearest.xml": 85.83,
    "04-xml-touv-emission/h-touv-scale-nearest.xml": 21.457,
    "12-doubled/dup_sphere.glb": 98.29,
}


@pytest.mark.parametrize("name", LUMENS)
def test_flux_of_bare_emitters(mi, name):
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.trace.light_paths import LampRays

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LumitreeWarning)
        lamp = load_luminaire(CASES / name)
    flux = LampRays(lamp).bare_flux(1 << 17, 1) * lamp.frame.scale**2
    # An eighth of the surface at least is bright: ± 0.7 % at one standard error.
    assert float(luminance(flux)) == pytest.approx(LUMENS[name], rel=0.025)


@pytest.mark.slow
def test_a_textured_emitter_beside_a_plain_one_is_a_number(mi, tmp_path):
    import lumitree

    lamp = CASES / "13-nan" / "nan_textured_plus_plain.glb"
    outputs = [tmp_path / "lamp.ies", tmp_path / "lamp.ldt"]
    result = lumitree.photometry(str(lamp), outputs)
    assert 0 < result.lumens.value < np.inf
    for each in outputs:
        words = each.read_text().lower().replace(",", " ").split()
        assert not {"nan", "inf", "-inf"} & set(words)


def test_two_units_and_rated_lumens_are_warned_of(mi):
    import lumitree
    from lumitree.lamp.luminaire import load_luminaire

    with pytest.warns(LumitreeWarning, match="units"):
        load_luminaire(CASES / "14-blender-units" / "mixed.glb")
    rated = str(CASES / "10-tm33-rated-lumens" / "rated.tm33")
    with (
        pytest.warns(LumitreeWarning, match="no emission areas"),
        pytest.warns(LumitreeWarning, match="974.9.* lm, where its lamps are rated at 4000 lm"),
    ):
        lumitree.bake(rated)
