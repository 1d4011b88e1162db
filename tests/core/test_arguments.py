"""Checks of numbers that are given as arguments."""

import numpy as np
import pytest

import lumitree
from lumitree.core.arguments import check_count, check_range
from lumitree.errors import LumitreeError


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (4.0, r"spp is 4\.0; expected a whole number"),
        (True, "spp is True; expected a whole number"),
        (np.int64(4), r"spp is np\.int64\(4\); expected a whole number \(int\)"),
        ("4", "spp is '4'; expected a whole number"),
        (0, "spp is 0; expected 1 to 10"),
    ],
)
def test_counts_are_whole_numbers(value, message):
    check_count("spp", 4, 1, 10)
    with pytest.raises(LumitreeError, match=message):
        check_count("spp", value, 1, 10)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.float32(0.5), r"noise is np\.float32\(0\.5\); expected 0 to 1"),
        (float("nan"), "noise is nan; expected 0 to 1"),
        (2, "noise is 2; expected 0 to 1"),
    ],
)
def test_numbers_are_in_their_range(value, message):
    check_range("noise", 0.5, 0, 1)
    with pytest.raises(LumitreeError, match=message):
        check_range("noise", value, 0, 1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: lumitree.Placement("a.lumitree", size="0.85"), "size '0.85' is not a length"),
        (lambda: lumitree.Placement("a.lumitree", at="here"), "at 'here' is not 3 numbers"),
        (lambda: lumitree.BakeConfig(parts="light"), "parts are 'light'; expected a list of texts"),
        (lambda: lumitree.photometry("bulbs", step="5"), "angular step is 5; expected 0.5 to 30"),
    ],
)
def test_texts_in_place_of_numbers_and_lists_are_refused(make, message):
    with pytest.raises(LumitreeError, match=message):
        make()


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: lumitree.preview(""), "luminaire"),
        (lambda: lumitree.capture("bulbs", ""), "output"),
        (lambda: lumitree.bake("bulbs", work=""), "work"),
        (lambda: lumitree.bake_many([""], "lamps"), "luminaires"),
        (lambda: lumitree.collect(""), "folder"),
        (lambda: lumitree.photometry("bulbs", ["a.ies", ""]), "output"),
        (lambda: lumitree.shape(""), "a source"),
        (lambda: lumitree.load_luminaire(lumitree.LuminaireSource("")), "a source"),
    ],
)
def test_an_empty_path_is_not_the_current_folder(call, name):
    with pytest.raises(LumitreeError, match=f"{name} is ''; expected a"):
        call()
