"""The band of an ECDF errs as often as it says."""

import numpy as np
import pytest

from needlefit.inference.ecdf_band import ecdf_band, probability_inside


def test_a_simultaneous_band_covers_its_nominal_fraction():
    low, high = ecdf_band(60, 80, 0.1)
    drawn = np.random.default_rng(1).integers(0, 80, (10000, 60))
    below = np.stack([(drawn < place).sum(axis=1) for place in range(1, 80)], axis=1)
    held = np.mean(np.all((below >= low) & (below <= high), axis=1))
    assert 0.9 <= probability_inside(60, low, high) < 0.92
    assert held == pytest.approx(probability_inside(60, low, high), abs=0.01)
