"""Points of many needles at once are those of each, to the bit, also where one bends far."""

import numpy as np

from needlefit.mechanics.native import compute_positions


def make_needles(count):
    rng = np.random.default_rng(5)
    x = np.tile(np.concatenate([[-90.0, -40.0], np.linspace(0.0, 20.0, 21)]), (count, 1))
    u, slope = (np.cumsum(part * rng.normal(size=x.shape), axis=1) for part in (0.02, 0.002))
    return x, u, slope, np.sort(rng.uniform(-60.0, 20.0, 30))


def compare(x, u, slope, s):
    single = [compute_positions(*(part[i : i + 1] for part in (x, u, slope)), s)[0] for i in range(len(x))]
    assert np.array_equal(compute_positions(x, u, slope, s), single, equal_nan=True)


def test_a_block_and_a_part_of_one():
    for count in (1, 32, 45):
        compare(*make_needles(count))


def test_a_needle_that_bends_far_and_one_that_failed():
    x, u, slope, s = make_needles(40)
    slope[3] = 1.5
    u[35], slope[35] = np.nan, np.nan
    compare(x, u, slope, s)


def test_needles_with_other_nodes():
    x, u, slope, s = make_needles(40)
    x[2, 1] = -30.0
    compare(x, u, slope, s)
