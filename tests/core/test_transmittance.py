"""Laws of the two transmittances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lumitree.core.transmittance import LAWS, transmittance


@given(law=st.sampled_from(LAWS), taus=st.lists(st.floats(0, 20), min_size=1, max_size=30))
def test_weights_sum_to_opacity(law, taus):
    tau = np.concatenate([[0.0], np.cumsum(taus)])
    through = transmittance(tau, law, np)
    weights = through[:-1] - through[1:]
    assert (weights >= 0).all()
    assert weights.sum() == pytest.approx(1 - through[-1])
    assert through[0] == 1


def test_closed_forms():
    tau = np.array([0.0, 0.25, 1.0, 3.0])
    assert transmittance(tau, "linear", np).tolist() == [1, 0.75, 0, 0]
    assert transmittance(tau, "exponential", np) == pytest.approx(np.exp(-tau))
    with pytest.raises(ValueError, match="unknown transmittance law"):
        transmittance(tau, "cubic", np)
