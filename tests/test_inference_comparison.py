"""Which points are compared: equal fractions from the entry, or equal arc lengths from the tip."""

import math
from dataclasses import replace

import numpy as np
import pytest
from inference_cases import insertion

from needlefit.datasets.insertion import find_free_reach
from needlefit.errors import DataError
from needlefit.inference.compared_points import compare_points, select_points

RIGHT_ANGLE = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 20.0]])  # 60 mm along, then 20 mm aside


def measured(depth: float, planar: np.ndarray):
    return replace(insertion(depth), planar=planar)


def line(length: float) -> np.ndarray:
    """A straight needle measured in unequal steps, turned by 53 degrees and far from its frame."""
    along = length * np.array([0.0, 0.1, 0.15, 0.6, 1.0])
    return np.outer(along, [0.6, 0.8]) + np.array([50.0, -7.0])


@pytest.mark.parametrize(
    ("length", "depth", "drop", "reach"),
    [(80.0, 100.0, 10.0, 70.0), (120.0, 100.0, 10.0, 90.0), (100.0, 100.0, 0.0, 100.0)],
)
def test_a_free_comparison_reaches_as_far_as_both_curves_less_the_drop(length, depth, drop, reach):
    scored = measured(depth, line(length))
    assert find_free_reach(drop, scored) == pytest.approx(reach)
    goal = select_points("free", drop, scored, 11)
    np.testing.assert_allclose(goal.s, np.linspace(depth - reach, depth, 11))
    # in the axes of its entry side a straight needle lies on x, from the first scored point
    np.testing.assert_allclose(
        goal.measured, np.column_stack([np.linspace(0, reach, 11), np.zeros(11)]), atol=1e-9
    )


def test_nothing_left_to_compare_names_the_insertion():
    assert find_free_reach(9.9, measured(10.0, line(30.0))) == pytest.approx(0.1)
    for planar, depth in ((line(10.0), 30.0), (line(30.0), 10.0)):
        with pytest.raises(DataError, match=f"at{depth:g}"):
            find_free_reach(10.0, measured(depth, planar))


def test_a_known_comparison_takes_equal_fractions_of_each_curves_own_length():
    goal = select_points(
        "known", 10.0, measured(40.0, RIGHT_ANGLE), 9
    )  # what is dropped is a matter of free shapes
    np.testing.assert_allclose(goal.s, np.arange(0, 41, 5.0))
    np.testing.assert_allclose(goal.measured[:7], np.outer(np.arange(0, 61, 10.0), [1, 0]))
    np.testing.assert_allclose(goal.measured[7:], [[60, 10], [60, 20]])


def test_free_points_are_counted_from_the_tip():
    """A right angle 20 mm before the tip: 10 of the 30 mm compared lie before it, along x."""
    scored = measured(100.0, RIGHT_ANGLE)
    goal = select_points("free", 50.0, scored, 31)
    assert goal.s[0] == 70.0 and goal.s[-1] == 100.0
    np.testing.assert_allclose(goal.measured[10], [10, 0], atol=1e-9)
    np.testing.assert_allclose(goal.measured[-1], [10, 20], atol=1e-9)


def test_the_simulated_points_are_those_at_the_same_distance_from_the_tip():
    """What is compared is laid on it rigidly: a bent needle, moved and turned, is found without error.

    Its proximal 40 mm, which only one of the two has, do not count.
    """

    def bent(s):
        s = np.asarray(s, dtype=float)
        return np.column_stack([np.minimum(s, 80.0), np.maximum(s - 80.0, 0.0)])

    c, d = math.cos(2.0), math.sin(2.0)
    seen = bent(np.arange(40.0, 100.5)) @ np.array([[c, d], [-d, c]]) + [300.0, 1.0]
    simulated, shown = compare_points("free", 5.0, measured(100.0, seen), bent, 56)
    np.testing.assert_allclose(simulated, shown, atol=1e-9)
    simulated, shown = compare_points("free", 5.0, measured(101.0, seen), lambda s: bent(s - 1.0), 56)
    np.testing.assert_allclose(simulated, shown, atol=1e-9)


def test_known_points_are_never_moved():
    away = measured(10.0, np.array([[0.0, 3.0], [10.0, 3.0]]))
    simulated, shown = compare_points("known", 0.0, away, lambda s: np.column_stack([s, 0 * s]), 5)
    np.testing.assert_allclose(shown - simulated, np.tile([0.0, 3.0], (5, 1)))
