"""The solver against closed forms, manufactured solutions and a finer mesh."""

import numpy as np
import pytest
from solver_checks.beams import FOUNDED, LOADED
from solver_checks.clamped import MANUFACTURED, measure_orders
from solver_checks.refinement import measure_random_meshes, measure_shipped_meshes


@pytest.mark.parametrize("case", LOADED)
def test_beams_under_a_uniform_load(case):
    assert LOADED[case]() < 1e-7


@pytest.mark.parametrize("case", FOUNDED)
def test_beams_on_an_elastic_foundation(case):
    assert FOUNDED[case]() < 1e-5


@pytest.mark.parametrize("case", MANUFACTURED)
def test_observed_orders_are_those_of_theory(case):
    """Of deflection and slope: 4 and 3; at the nodes, where the slope superconverges, both 4."""
    orders = np.array(measure_orders(*MANUFACTURED[case]))
    assert np.all(np.abs(orders - [4, 3, 4, 4]) < [0.15, 0.15, 0.2, 0.2])


def test_elements_of_1_mm_are_fine_enough():
    """The tip on elements eight times shorter, in the shipped scenes and in random insertions."""
    assert max(measure_shipped_meshes().values()) < 1e-3
    changes = measure_random_meshes(np.random.default_rng(1), 40)
    assert np.max(changes) < 1e-3 and np.median(changes) < 1e-4
