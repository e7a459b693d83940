"""Variants of the decided rules: the constraint point that tissue takes, the advance, the first cell."""

import numpy as np
import pytest
from mechanics_cases import NEEDLE

from needlefit.errors import ModelError
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue

TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
BEVEL = Bevel(0.1)


def test_a_cell_of_the_point_behind_is_not_pulled_by_the_cut() -> None:
    """After one cell the only point behind is the entry's, so that nothing bends the needle."""
    behind = simulate(NEEDLE, TISSUE, BEVEL, 1.0, rules=ModelOptions(switch=1.0))
    np.testing.assert_allclose(behind.u, 0.0, atol=1e-12)
    np.testing.assert_allclose(behind.constraints[:, 1], [0.0, 0.1])
    half, ahead = (
        simulate(NEEDLE, TISSUE, BEVEL, 1.0, rules=ModelOptions(switch=s)).u[-1] for s in (0.5, 0.0)
    )
    assert 0 < half < ahead


def test_without_the_tangent_the_cut_leaves_the_tip_by_the_bevel_alone() -> None:
    shape = simulate(NEEDLE, TISSUE, BEVEL, 6.0, rules=ModelOptions(tangent=0.0))
    steps = shape.constraints[1:, 1] - shape.tip_track[:-1, 0]
    np.testing.assert_allclose(steps, 0.1, atol=1e-12)
    along = simulate(NEEDLE, TISSUE, BEVEL, 6.0)
    assert 0 < shape.u[-1] < along.u[-1]


def test_a_first_cell_in_the_rules_is_a_lattice() -> None:
    steps = (Step(7.3, BEVEL),)
    chosen = simulate_steps(NEEDLE, TISSUE, steps, ModelOptions(first_cell=0.4))
    given = simulate_steps(NEEDLE, TISSUE, steps, ModelOptions(), Lattice(0.4, 1.0))
    np.testing.assert_array_equal(chosen.u, given.u)
    np.testing.assert_allclose(chosen.constraints[:3, 0], [0.0, 0.4, 1.4])
    (lanes,) = simulate_batches(
        [Batch(NEEDLE, TISSUE, steps, ModelOptions(first_cell=0.4), offset=np.array([0.1]))]
    )
    np.testing.assert_allclose(lanes[0].u, chosen.u, atol=1e-7)


def test_rules_outside_their_range_are_refused() -> None:
    for wrong in ({"switch": -0.1}, {"tangent": 1.1}):
        with pytest.raises(ModelError, match="from 0 to 1"):
            ModelOptions(**wrong)
