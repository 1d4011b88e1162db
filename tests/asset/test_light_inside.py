"""Light inside the box in memory: what is refused, and the bins of what ends."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.light_field import pack, parts_of_ending
from lumitree.errors import LumitreeError
from support.light_fields import random_inside, random_light_field

FIELD = random_light_field(0)
INSIDE = random_inside(0, FIELD)


def changed(name, index, value):
    array = getattr(INSIDE, name).copy()
    array[index] = value
    return {name: array}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cells": INSIDE.cells.astype(np.int64)}, "cells is int64"),
        ({"cells": np.uint8(0)}, r"cells is uint8 \(\)"),
        ({"cells": INSIDE.cells[::-1]}, "repeated or out of order"),
        (changed("cells", 1, INSIDE.cells[0]), "repeated or out of order"),
        ({"lit": np.uint8(0)}, r"lit is uint8 \(\)"),
        ({"lit": INSIDE.lit[1:]}, "lit is uint8"),
        ({"intensity": INSIDE.intensity.astype(np.float32)}, "intensity is float32"),
        ({"intensity": np.uint32(0)}, r"intensity is uint32 \(\)"),
        ({"reach": INSIDE.reach[1:]}, "reach is uint8"),
        ({"bent_reach": INSIDE.bent_reach.astype(np.int64)}, "bent_reach is int64"),
        ({"bent": INSIDE.bent[1:]}, "bent is uint32"),
        (changed("bent", slice(None), pack(np.ones(3))), "a bent part is larger"),
        ({"distances": INSIDE.distances[:3]}, "reach_curves is float32"),
        ({"distances": np.float32(0)}, r"distances is float32 \(\)"),
        ({"reach_curves": np.float32(0)}, r"reach_curves is float32 \(\)"),
        ({"reach_curves": INSIDE.reach_curves[:0]}, "reach curves are not 1 to 256"),
        (changed("distances", 0, 0.05), "distances are no increasing numbers from 0"),
        (changed("distances", 2, 0.1), "distances are no increasing numbers"),
        (changed("distances", 3, np.inf), "distances are no increasing numbers"),
        (changed("distances", 3, np.nan), "distances are no increasing numbers"),
        (changed("reach_curves", (0, 0), 1.01), "reach curves are not"),
        (changed("reach_curves", (0, 0), np.nan), "reach curves are not"),
        (changed("reach_curves", (0, 2), 1), "a reach increases"),
        (changed("reach_curves", (0, slice(None)), 0.5), "last value is not 0"),
        (changed("reach", 0, 4), "a reach curve is named that is not there"),
        (changed("bent_reach", 0, 4), "a reach curve is named that is not there"),
        ({"scale": 0.0}, "scale 0.0"),
        ({"scale": float("nan")}, "scale nan"),
        ({"scale": 1}, "scale 1,"),
    ],
)
def test_what_a_renderer_could_not_use_is_refused(change, message):
    with pytest.raises(LumitreeError, match=message) as caught:
        dataclasses.replace(INSIDE, **change)
    assert str(caught.value).startswith("invalid light inside the box: ")
    assert str(caught.value).isprintable()


def without(row):
    """Light inside without one of its cells."""
    bits = np.unpackbits(INSIDE.lit, axis=1)
    entry = np.repeat(np.arange(len(bits)), bits.sum(axis=1, dtype=np.int64))
    members = {
        name: np.delete(getattr(INSIDE, name), entry == row)
        for name in ("intensity", "bent", "reach", "bent_reach")
    }
    cells, lit = (np.delete(each, row, axis=0) for each in (INSIDE.cells, INSIDE.lit))
    return dataclasses.replace(INSIDE, cells=cells, lit=lit, **members)


def test_every_cell_of_the_light_field_is_needed():
    own = {tuple(cell) for cell in FIELD.cells.tolist()}
    for row, cell in enumerate(INSIDE.cells.tolist()):
        if tuple(cell) in own:
            with pytest.raises(LumitreeError, match="cell of the light field is missing"):
                dataclasses.replace(FIELD, inside=without(row))
        else:
            assert dataclasses.replace(FIELD, inside=without(row)).num_bytes < (
                FIELD.num_bytes + INSIDE.num_bytes
            )


def test_bins_beyond_the_last_are_refused():
    """Q² is 4, and a byte has eight bits."""
    bits = np.unpackbits(INSIDE.lit, axis=1)
    others = [
        row for row, cell in enumerate(INSIDE.cells.tolist()) if cell not in FIELD.cells.tolist()
    ]
    bits[others[0], :5] = [1, 1, 1, 0, 1]
    inside = dataclasses.replace(INSIDE, lit=np.packbits(bits, axis=1))
    with pytest.raises(LumitreeError, match="a bin beyond the last has an entry"):
        dataclasses.replace(FIELD, inside=inside)


def test_light_inside_of_another_grid_is_refused():
    with pytest.raises(LumitreeError, match=r"lit is uint8 \(7, 1\), expected uint8 \(7, 8\)"):
        dataclasses.replace(random_light_field(0, resolution=16), inside=INSIDE)
    with pytest.raises(LumitreeError, match="a cell is outside the grid"):
        dataclasses.replace(
            random_light_field(0, depth=1), inside=random_inside(0, random_light_field(0, depth=3))
        )


def test_values_of_bins_that_do_not_fill_their_bytes():
    """Four bins a cell, as beside a light field of 4 bins a side."""
    from lumitree.asset.light_field import dense

    stored = np.array([[True, False, True, True], [False, False, True, False]])
    values = np.array([[1, 2], [3, 4], [5, 6], [7, 8]])
    found = dense(np.packbits(stored, axis=1), 4, values)
    assert found.shape == (2, 4, 2)
    assert np.array_equal(found[stored], values)
    assert not found[~stored].any()


def test_light_that_ends_is_where_little_leaves():
    """The level of I + J, against bisection: no bin with J is above it, none without is below."""
    random = np.random.default_rng(0)
    leaving = random.exponential(1, (500, 4)) * (random.random((500, 4)) < 0.6)
    ending = random.exponential(1, 500) * (random.random(500) < 0.9)
    solid_angle = random.uniform(0.5, 1, (500, 4))
    parts = parts_of_ending(leaving, ending, solid_angle)
    low, high = np.zeros(500), np.full(500, 1e3)
    for _ in range(60):
        level = (low + high) / 2
        filled = (np.maximum(level[:, None] - leaving, 0) * solid_angle).sum(axis=1)
        above = filled > ending * solid_angle.sum(axis=1)
        low, high = np.where(above, low, level), np.where(above, level, high)
    expected = np.maximum(low[:, None] - leaving, 0)
    some = ending > 0
    assert (parts * ending[:, None])[some] == pytest.approx(expected[some], abs=1e-9)
    assert (parts[~some] == 1).all()
    mean = (parts * solid_angle).sum(axis=1) / solid_angle.sum(axis=1)
    assert mean == pytest.approx(1)
