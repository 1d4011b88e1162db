"""Seeded mutations of an asset: each loads to a sound asset or is refused in one printable line."""

from dataclasses import replace

import numpy as np
import pytest

from lumitree.asset.asset import EmittedSpectrum, light_field_asset
from lumitree.asset.file import load, save
from lumitree.asset.light_field import TracedPaths
from lumitree.errors import LumitreeError
from support.asset_drafts import CHANGES, Draft
from support.fields import random_asset
from support.light_fields import assert_equal_fields, random_light_field
from support.sound_assets import assert_sound
from support.stored_arrays import change_field_arrays

ROUNDS = 40
TRACED = TracedPaths(1 << 20, (0, 7), 64 * "a", 0.02)
SPECTRUM = EmittedSpectrum.of(np.random.default_rng(0).random(471), 0.75)


@pytest.fixture(scope="module", params=["field", "both", "light", "spectrum"])
def asset(request):
    """An asset with a field, with a light field too, with the latter alone, or with a spectrum."""
    plain = random_asset(0, tree_depth=3, l_max=1, half_extents=np.array([1.0, 0.5, 0.25]))
    return {
        "field": plain,
        "both": replace(plain, light_field=random_light_field(0, traced=TRACED)),
        "light": light_field_asset(random_light_field(0), plain.frame, "test"),
        "spectrum": light_field_asset(random_light_field(0), plain.frame, "test", SPECTRUM),
    }[request.param]


def test_the_draft_is_the_file(asset, tmp_path):
    """Unchanged, what this test writes loads: mutations reach the checks behind the checksum."""
    (tmp_path / "draft.lumitree").write_bytes(Draft(asset).file())
    save(load(tmp_path / "draft.lumitree"), tmp_path / "again.lumitree")
    save(asset, tmp_path / "saved.lumitree")
    content = (tmp_path / "again.lumitree").read_bytes()
    assert content == (tmp_path / "saved.lumitree").read_bytes()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mutate", CHANGES)
def test_mutations_are_sound_or_refused(asset, tmp_path, mutate):
    path, again = tmp_path / "mutant.lumitree", tmp_path / "again.lumitree"
    refused = 0
    for number in range(ROUNDS):
        path.write_bytes(mutate(Draft(asset), np.random.default_rng(number)))
        try:
            mutant = load(path)
        except LumitreeError as error:
            message = str(error)
            assert "mutant.lumitree" in message
            assert message.isprintable(), number
            assert len(message) < 1000, number
            refused += 1
        else:
            assert_sound(mutant)
            save(mutant, again)
            loaded = load(again)
            assert loaded.luminaire == mutant.luminaire
            assert (loaded.light_field is None) == (mutant.light_field is None)
            assert (loaded.spectrum is None) == (mutant.spectrum is None)
            if mutant.light_field is not None:
                assert_equal_fields(loaded.light_field, mutant.light_field)
    assert refused > ROUNDS // 8


def test_coefficients_beyond_half_precision_are_refused(tmp_path):
    draft = Draft(random_asset(0, tree_depth=2, l_max=1))

    def change(arrays):
        # Dark leaves, whose other bands have the largest step.
        arrays["coefficients"][:, 0], arrays["coefficients"][:, 1:] = -32767, 32767

    change_field_arrays(draft.tensors, draft.asset, change)
    (tmp_path / "bad.lumitree").write_bytes(draft.file())
    with pytest.raises(LumitreeError, match="NaN or infinity"):
        load(tmp_path / "bad.lumitree")
