"""The light field in memory: packed colours, and what is refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lumitree.asset.light_field import MAX_BINS, LightField, make_light_field, pack, unpack
from lumitree.errors import LumitreeError
from lumitree.octree.build import morton
from support.light_fields import random_light_field

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


def test_powers_of_two_are_exact():
    powers = np.exp2(-np.arange(31.0))
    colours = np.stack([powers, powers / 2, powers / 256], axis=1)
    assert np.array_equal(unpack(pack(colours)), colours)
    assert np.array_equal(unpack(pack(colours[:, ::-1])), colours[:, ::-1])


def test_zero_and_one():
    colours = np.array([[0, 0, 0], [1, 1, 1], [1, 0, 0], [0, 0, 1], [0, 1, 0.5]])
    packed = pack(colours)
    assert packed.dtype == np.uint32
    assert packed[0] == 0
    assert np.array_equal(unpack(packed), colours)


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


FIELD = random_light_field(0)


def changed(name, index, value):
    array = getattr(FIELD, name).copy()
    array[index] = value
    return {name: array}


def both(intensity):
    """Members of a field whose light is all bent."""
    return {"intensity": intensity, "bent": intensity}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cells": FIELD.cells.astype(np.int64)}, r"cells is int64 \(5, 3\), expected uint8"),
        ({"cells": FIELD.cells[:, :2]}, r"cells is uint8 \(5, 2\), expected uint8 \(5, 3\)"),
        ({"cells": FIELD.cells.ravel()}, r"cells is uint8 \(15,\)"),
        ({"cells": np.uint8(0)}, r"cells is uint8 \(\)"),
        ({"cells": FIELD.cells[1:]}, r"lit is uint8 \(5, 2\), expected uint8 \(4, 2\)"),
        ({"lit": FIELD.lit.view(np.int8)}, "lit is int8"),
        ({"lit": FIELD.lit[:, :1]}, r"lit is uint8 \(5, 1\), expected uint8 \(5, 2\)"),
        ({"lit": np.uint8(0)}, r"lit is uint8 \(\)"),
        ({"intensity": FIELD.intensity.view(np.int32)}, "intensity is int32"),
        ({"intensity": FIELD.intensity.astype(np.float64)}, "intensity is float64"),
        ({"intensity": FIELD.intensity[:, None]}, r"intensity is uint32 \(\d+, 1\)"),
        ({"intensity": np.uint32(1)}, r"intensity is uint32 \(\)"),
        (both(FIELD.intensity[1:]), r"\d+ intensities for"),
        (both(np.append(FIELD.intensity, FIELD.intensity)), r"\d+ intensities for \d+"),
        ({"bent": FIELD.bent[1:]}, "bent is uint32"),
        ({"bent": FIELD.bent.view(np.int32)}, "bent is int32"),
        (changed("bent", 3, pack(np.array([1.0, 0, 0]))), "a bent part is larger"),
        (changed("bent", slice(None), FIELD.intensity + 1), "a bent part is larger"),
        (changed("intensity", 3, 0), "an intensity is 0"),
        (changed("intensity", 3, 7 << 27), "an intensity is 0"),
        (changed("lit", (0, 0), FIELD.lit[0, 0] ^ 1), "intensities for"),
        (changed("cells", (0, 0), 4), "a cell is outside the grid"),
        (changed("cells", (0, 0), 255), "a cell is outside the grid"),
        (changed("cells", 1, FIELD.cells[0]), "repeated or out of order"),
        ({"cells": FIELD.cells[::-1]}, "repeated or out of order"),
        ({"depth": 1}, "a cell is outside the grid"),
        ({"depth": 0}, "depth 0, expected 1 to 7"),
        ({"depth": 8}, "depth 8"),
        ({"depth": 2.0}, "depth 2.0"),
        ({"depth": True}, "depth True"),
        ({"resolution": 8}, r"lit is uint8 \(5, 2\), expected uint8 \(5, 8\)"),
        ({"resolution": 2}, "resolution 2, expected a power of two from 4 to 512"),
        ({"resolution": 6}, "resolution 6"),
        ({"resolution": 1024}, "resolution 1024"),
        ({"resolution": 4.0}, "resolution 4.0"),
        ({"scale": 0.0}, "scale 0.0, expected 1e-15 to 1e15"),
        ({"scale": 9e-16}, "scale 9e-16"),
        ({"scale": 2e15}, "scale 2000000000000000.0"),
        ({"scale": -1.0}, "scale -1.0"),
        ({"scale": float("nan")}, "scale nan"),
        ({"scale": float("inf")}, "scale inf"),
        ({"scale": 1}, "scale 1,"),
        (
            {
                "cells": FIELD.cells[:0],
                "lit": FIELD.lit[:0],
                **both(FIELD.intensity[:0]),
            },
            "0 cells of 16 bins",
        ),
    ],
)
def test_what_a_renderer_could_not_use_is_refused(change, message):
    with pytest.raises(LumitreeError, match=message) as caught:
        dataclasses.replace(FIELD, **change)
    assert str(caught.value).startswith("invalid light field: ")
    assert str(caught.value).isprintable()


def test_a_cell_that_emits_nothing_is_refused():
    first = int(np.unpackbits(FIELD.lit[0]).sum())
    with pytest.raises(LumitreeError, match="a cell emits nothing"):
        dataclasses.replace(
            FIELD,
            lit=np.concatenate([np.zeros_like(FIELD.lit[:1]), FIELD.lit[1:]]),
            **both(FIELD.intensity[first:]),
        )


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


@pytest.mark.parametrize("scale", [1e-15, 1e15])
def test_the_ends_of_the_range_are_accepted(scale):
    assert dataclasses.replace(FIELD, scale=scale).scale == scale


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
    # The dark cell is left out; the others are in Morton order.
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


def test_light_too_dim_for_a_packed_number_is_left_out():
    """A cell whose bins are all rounded to 0 must not stay as a cell without light."""
    intensity = np.full((2, 16, 3), 1e-13)
    intensity[0] = 1
    field = make_light_field(np.array([[1, 1, 1], [0, 0, 0]]), intensity, 1)
    assert field.cells.tolist() == [[1, 1, 1]]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (0.0, "largest intensity is 0.0; expected light"),
        (np.nan, "largest intensity is nan"),
        (np.inf, "largest intensity is inf"),
        (-1.0, "largest intensity is 0.0"),
        (1e16, "scale 1e"),
        (1e-16, "scale 1e"),
    ],
)
def test_intensities_out_of_range_are_refused(value, message):
    with pytest.raises(LumitreeError, match=message):
        make_light_field(np.array([[0, 0, 0]]), np.full((1, 16, 3), value), 1)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-3])
def test_one_intensity_out_of_range_is_refused(value):
    intensity = np.ones((2, 16, 3))
    intensity[1, 7, 2] = value
    with pytest.raises(LumitreeError, match=r"the (largest|smallest) intensity is"):
        make_light_field(np.array([[0, 0, 0], [1, 0, 0]]), intensity, 1)


def test_no_cells_are_refused():
    with pytest.raises(LumitreeError, match="expected light"):
        make_light_field(np.zeros((0, 3), np.int64), np.zeros((0, 16, 3)), 1)
