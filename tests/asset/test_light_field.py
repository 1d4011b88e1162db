"""The light field in memory: packed colours, light inside the box, and what is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lumitree.asset.light_field import (
    MAX_BINS,
    LightField,
    dense,
    make_light_field,
    pack,
    parts_of_ending,
    unpack,
)
from lumitree.errors import LumitreeError
from lumitree.octree.build import morton
from support.light_fields import random_inside, random_light_field

FIELD = random_light_field(0)
INSIDE = random_inside(0, FIELD)

# Half a step of a mantissa of 9 bits, relative to the largest channel. It is largest where rounding
# carries: from 511.5 steps up the step is twice as large.
BOUND = 2**-9 * 512 / 511.5


@given(st.tuples(*[st.floats(0, 1)] * 3))
def test_a_packed_colour_is_near(colour):
    colour = np.array(colour)
    found = unpack(pack(colour))
    assert np.abs(found - colour).max() <= max(BOUND * colour.max(), 2**-40)
    assert BOUND < 0.002


def test_many_packed_colours_are_near():
    random = np.random.default_rng(0)
    colours = random.random((1 << 16, 3)) * np.exp2(-random.uniform(0, 25, (1 << 16, 1)))
    error = np.abs(unpack(pack(colours)) - colours).max(axis=1) / colours.max(axis=1)
    assert error.max() <= BOUND
    # The error is as large as the bits allow, and not biased.
    assert error.max() > 0.9 * BOUND
    assert abs((unpack(pack(colours)) / colours).mean() - 1) < 1e-3


def test_powers_of_two_zero_and_one_are_exact():
    powers = np.exp2(-np.arange(31.0))
    colours = np.stack([powers, powers / 2, powers / 256], axis=1)
    simple = np.array([[0, 0, 0], [1, 1, 1], [1, 0, 0], [0, 0, 1], [0, 1, 0.5]])
    for each in (colours, colours[:, ::-1], simple):
        assert np.array_equal(unpack(pack(each)), each)
    packed = pack(simple)
    assert packed.dtype == np.uint32
    assert packed[0] == 0


@pytest.mark.parametrize("exponent", [0, -1, -7, -29])
@pytest.mark.parametrize("mantissa", [511, 511.4, 511.5, 511.6, 511.99])
def test_rounding_that_carries(exponent, mantissa):
    """511.5 to 512 steps are rounded up to the next power of two."""
    largest = mantissa / 512 * 2.0**exponent
    red, green, blue = unpack(pack(np.array([largest, largest / 3, 0])))
    assert red == (2.0**exponent if mantissa >= 511.5 else 511 / 512 * 2.0**exponent)
    assert green == pytest.approx(largest / 3, abs=BOUND * largest)
    assert blue == 0


def test_tiny_values():
    """Steps of 2⁻³⁹ are the smallest; what is less than half of one is 0."""
    step = 2.0**-39
    colours = np.array([[0.4, 0.3, 0], [0.6, 0, 0], [3, 200, 511], [511.6, 1, 0], [1e-290, 0, 0]])
    packed = pack(colours * step)
    expected = [[0, 0, 0], [1, 0, 0], [3, 200, 511], [512, 0, 0], [0, 0, 0]]
    assert np.array_equal(unpack(packed) / step, expected)
    assert packed[0] == packed[4] == 0


def test_every_packed_number_is_kept():
    """Unpacking and packing again gives the same colour."""
    packed = np.random.default_rng(0).integers(1 << 32, size=4096, dtype=np.uint32)
    colours = unpack(packed)
    colours = colours[colours.max(axis=1) <= 1]
    assert len(colours) > 3000
    assert np.array_equal(unpack(pack(colours)), colours)


def changed(light, name, index, value):
    array = getattr(light, name).copy()
    array[index] = value
    return {name: array}


def both(intensity):
    """Members of a field whose light is all bent."""
    return {"intensity": intensity, "bent": intensity}


def field(name, index, value):
    return FIELD, changed(FIELD, name, index, value)


def inside(name, index, value):
    return INSIDE, changed(INSIDE, name, index, value)


FIRST = int(np.unpackbits(FIELD.lit[0]).sum())
NO_CELLS = {"cells": FIELD.cells[:0], "lit": FIELD.lit[:0], **both(FIELD.intensity[:0])}
DARK = np.concatenate([np.zeros_like(FIELD.lit[:1]), FIELD.lit[1:]])
# Members that are changed, and a word of the refusal.
BROKEN = [
    (FIELD, {"cells": FIELD.cells.astype(np.int64)}, "cells is int64"),
    (FIELD, {"cells": FIELD.cells[:, :2]}, "cells is uint8"),
    (FIELD, {"cells": FIELD.cells.ravel()}, "cells is uint8"),
    (FIELD, {"cells": np.uint8(0)}, "cells is uint8"),
    (FIELD, {"cells": FIELD.cells[1:]}, "lit is uint8"),
    (FIELD, {"lit": FIELD.lit.view(np.int8)}, "lit is int8"),
    (FIELD, {"lit": FIELD.lit[:, :1]}, "lit is uint8"),
    (FIELD, {"lit": np.uint8(0)}, "lit is uint8"),
    (FIELD, {"intensity": FIELD.intensity.view(np.int32)}, "intensity is int32"),
    (FIELD, {"intensity": FIELD.intensity.astype(np.float64)}, "intensity is float64"),
    (FIELD, {"intensity": FIELD.intensity[:, None]}, "intensity is uint32"),
    (FIELD, {"intensity": np.uint32(1)}, "intensity is uint32"),
    (FIELD, both(FIELD.intensity[1:]), "intensities for"),
    (FIELD, both(np.append(FIELD.intensity, FIELD.intensity)), "intensities for"),
    (FIELD, {"bent": FIELD.bent[1:]}, "bent is uint32"),
    (FIELD, {"bent": FIELD.bent.view(np.int32)}, "bent is int32"),
    (*field("bent", 3, pack(np.array([1.0, 0, 0]))), "a bent part is larger"),
    (*field("bent", slice(None), FIELD.intensity + 1), "a bent part is larger"),
    (*field("intensity", 3, 0), "an intensity is 0"),
    (*field("intensity", 3, 7 << 27), "an intensity is 0"),
    (*field("lit", (0, 0), FIELD.lit[0, 0] ^ 1), "intensities for"),
    (*field("cells", (0, 0), 4), "outside the grid"),
    (*field("cells", (0, 0), 255), "outside the grid"),
    (*field("cells", 1, FIELD.cells[0]), "repeated or out of order"),
    (FIELD, {"cells": FIELD.cells[::-1]}, "repeated or out of order"),
    (FIELD, {"depth": 1}, "outside the grid"),
    *((FIELD, {"depth": value}, "depth") for value in (0, 8, 2.0, True)),
    (FIELD, {"resolution": 8}, "lit is uint8"),
    *((FIELD, {"resolution": value}, "resolution") for value in (2, 6, 1024, 4.0)),
    *(
        (light, {"scale": value}, "scale")
        for light in (FIELD, INSIDE)
        for value in (0.0, 9e-16, 2e15, -1.0, float("nan"), float("inf"), True)
    ),
    (FIELD, NO_CELLS, "0 cells of 16 bins"),
    (FIELD, {"lit": DARK, **both(FIELD.intensity[FIRST:])}, "a cell emits nothing"),
    (INSIDE, {"cells": INSIDE.cells.astype(np.int64)}, "cells is int64"),
    (INSIDE, {"cells": np.uint8(0)}, "cells is uint8"),
    (INSIDE, {"cells": INSIDE.cells[::-1]}, "repeated or out of order"),
    (*inside("cells", 1, INSIDE.cells[0]), "repeated or out of order"),
    (INSIDE, {"lit": np.uint8(0)}, "lit is uint8"),
    (INSIDE, {"lit": INSIDE.lit[1:]}, "lit is uint8"),
    (INSIDE, {"intensity": INSIDE.intensity.astype(np.float32)}, "intensity is float32"),
    (INSIDE, {"intensity": np.uint32(0)}, "intensity is uint32"),
    (INSIDE, {"reach": INSIDE.reach[1:]}, "reach is uint8"),
    (INSIDE, {"bent_reach": INSIDE.bent_reach.astype(np.int64)}, "bent_reach is int64"),
    (INSIDE, {"bent": INSIDE.bent[1:]}, "bent is uint32"),
    (*inside("bent", slice(None), pack(np.ones(3))), "a bent part is larger"),
    (INSIDE, {"distances": INSIDE.distances[:3]}, "reach_curves is float32"),
    (INSIDE, {"distances": np.float32(0)}, "distances is float32"),
    (INSIDE, {"reach_curves": np.float32(0)}, "reach_curves is float32"),
    (INSIDE, {"reach_curves": INSIDE.reach_curves[:0]}, "reach curves are not"),
    (*inside("distances", 0, 0.05), "distances"),
    *((*inside("distances", 3, value), "distances") for value in (0.1, np.inf, np.nan)),
    *((*inside("reach_curves", (0, 0), value), "reach curves are not") for value in (1.01, np.nan)),
    (*inside("reach_curves", (0, 2), 1), "a reach increases"),
    (*inside("reach_curves", (0, slice(None)), 0.5), "last value is not 0"),
    *((*inside(name, 0, 4), "a reach curve is named") for name in ("reach", "bent_reach")),
]


@pytest.mark.parametrize(("light", "change", "word"), BROKEN, ids=range(len(BROKEN)))
def test_what_a_renderer_could_not_use_is_refused(light, change, word):
    with pytest.raises(LumitreeError, match=f"invalid light .*{word}") as caught:
        dataclasses.replace(light, **change)
    assert str(caught.value).isprintable()


def test_too_many_bins_are_refused():
    """They are counted before anything is made of them."""
    count = MAX_BINS // 128**2 + 1
    # Views of one number: the arrays themselves would be half a gigabyte.
    with pytest.raises(LumitreeError, match=f"{count} cells of 16384 bins"):
        LightField(
            cells=np.broadcast_to(np.uint8(0), (count, 3)),
            lit=np.broadcast_to(np.uint8(255), (count, 128**2 // 8)),
            **both(np.zeros(0, np.uint32)),
            depth=7,
            resolution=128,
            scale=1.0,
        )


def test_dense_puts_values_where_the_bins_are():
    intensity = pack(np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]))
    field = LightField(
        cells=np.array([[0, 0, 0], [1, 1, 1]], np.uint8),
        # The first bin is in the highest bit.
        lit=np.array([[0b10000000, 0b00000001], [0b01000010, 0]], np.uint8),
        **both(intensity),
        depth=1,
        resolution=4,
        scale=2.0,
    )
    dense = field.dense(np.arange(1, 5))
    assert dense.shape == (2, 16)
    assert {tuple(at) for at in np.argwhere(dense)} == {(0, 0), (0, 15), (1, 1), (1, 6)}
    assert (dense[0, 0], dense[0, 15]) == (1, 2)
    assert (dense[1, 1], dense[1, 6]) == (3, 4)
    assert field.dense(np.ones(4, np.float32)).dtype == np.float32
    assert field.num_bytes == 2 * 3 + 2 * 2 + 4 * 4 + 4 * 4


def test_a_field_of_intensities():
    random = np.random.default_rng(1)
    cells = np.array([[3, 0, 1], [0, 0, 0], [0, 1, 0], [1, 0, 0], [2, 2, 2]])
    intensity = 40 * random.random((5, 64, 3))
    intensity[3] = 0
    intensity[4] = 0
    intensity[4, 17, 2] = 1
    intensity[0, 5] = 0
    field = make_light_field(cells, intensity, 2)
    # The dark cell is dropped; the others are in Morton order.
    assert field.cells.tolist() == [[0, 0, 0], [0, 1, 0], [3, 0, 1], [2, 2, 2]]
    assert (np.diff(morton(field.cells)) > 0).all()
    assert (field.depth, field.resolution) == (2, 8)
    assert field.scale == intensity.max()
    found = np.zeros((4, 64, 3))
    for channel in range(3):
        found[..., channel] = field.scale * field.dense(unpack(field.intensity)[:, channel])
    expected = intensity[[1, 2, 0, 4]]
    bound = BOUND * expected.max(axis=2, keepdims=True)
    assert (np.abs(found - expected) <= bound).all()
    assert np.unpackbits(field.lit, axis=1).sum(axis=1).tolist() == [64, 64, 63, 1]
    assert unpack(field.intensity).max() == 1


def test_light_too_dim_for_a_packed_number_is_dropped():
    """A cell whose bins are all rounded to 0 must not stay as a cell without light."""
    intensity = np.full((2, 16, 3), 1e-13)
    intensity[0] = 1
    field = make_light_field(np.array([[1, 1, 1], [0, 0, 0]]), intensity, 1)
    assert field.cells.tolist() == [[1, 1, 1]]


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, -1.0, 1e16, 1e-16])
def test_intensities_out_of_range_are_refused(value):
    with pytest.raises(LumitreeError, match=r"largest intensity is|scale 1e"):
        make_light_field(np.array([[0, 0, 0]]), np.full((1, 16, 3), value), 1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-3])
def test_one_intensity_out_of_range_is_refused(value):
    intensity = np.ones((2, 16, 3))
    intensity[1, 7, 2] = value
    with pytest.raises(LumitreeError, match=r"the (largest|smallest) intensity is"):
        make_light_field(np.array([[0, 0, 0], [1, 0, 0]]), intensity, 1)
    with pytest.raises(LumitreeError, match="expected light"):
        make_light_field(np.zeros((0, 3), np.int64), np.zeros((0, 16, 3)), 1)


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
    needed = {tuple(cell) for cell in FIELD.cells.tolist()}
    for row, cell in enumerate(INSIDE.cells.tolist()):
        if tuple(cell) in needed:
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
    with pytest.raises(LumitreeError, match="lit is uint8"):
        dataclasses.replace(random_light_field(0, resolution=16), inside=INSIDE)
    with pytest.raises(LumitreeError, match="a cell is outside the grid"):
        dataclasses.replace(
            random_light_field(0, depth=1), inside=random_inside(0, random_light_field(0, depth=3))
        )


def test_values_of_bins_that_do_not_fill_their_bytes():
    """Four bins a cell, as beside a light field of 4 bins a side."""
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
