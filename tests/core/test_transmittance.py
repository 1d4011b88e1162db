"""Laws of the two transmittances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lumitree.core.transmittance import LAWS, emission_weights, transmittance


@given(law=st.sampled_from(LAWS), taus=st.lists(st.floats(0, 20), min_size=1, max_size=30))
def test_weights_sum_to_opacity(law, taus):
    tau = np.concatenate([[0.0], np.cumsum(taus)])
    through = transmittance(tau, law, np)
    weights = emission_weights(through[:-1], through[1:], law, "decrease")
    assert (weights >= 0).all()
    assert weights.sum() == pytest.approx(1 - through[-1])
    assert through[0] == 1


def test_closed_forms():
    tau = np.array([0.0, 0.25, 1.0, 3.0])
    assert transmittance(tau, "linear", np).tolist() == [1, 0.75, 0, 0]
    assert transmittance(tau, "exponential", np) == pytest.approx(np.exp(-tau))
    with pytest.raises(ValueError, match="unknown transmittance law"):
        transmittance(tau, "cubic", np)


@pytest.mark.parametrize("law", LAWS)
def test_literal_weights_are_the_integral_of_the_transmittance(law):
    ends = np.array([0.0, 0.3, 0.4, 0.9, 1.7, 2.0])
    through = transmittance(ends, law, np)
    weights = emission_weights(through[:-1], through[1:], law, "literal")
    steps = (np.arange(20_000) + 0.5) / 20_000
    for weight, start, end in zip(weights, ends[:-1], ends[1:], strict=True):
        integral = transmittance(start + steps * (end - start), law, np).mean() * (end - start)
        assert weight == pytest.approx(integral, abs=1e-8)
    if law == "linear":
        # However dense a field is, no ray shows more than half of its emission.
        assert weights.sum() == pytest.approx(0.5)
