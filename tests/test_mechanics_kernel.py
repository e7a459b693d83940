"""The compiled kernel is the reference, over random and extreme cases."""

import numpy as np
import pytest
import reference_solver
from equilibrium import equilibrium
from mechanics_cases import NEEDLE, RULES, assert_close, list_seeds, random_case
from numpy.testing import assert_allclose

from needlefit import (
    Batch,
    Bevel,
    Controls,
    Guide,
    ModelOptions,
    NeedleShape,
    Step,
    Tissue,
    compute_positions,
    simulate_batches,
)
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.simulate import find_last_shape, simulate, simulate_steps


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("seed", list_seeds(28, 10))
def test_kernel_equals_reference(seed, kind):
    """One step, or many: inputs and bevel change on the way in, and out, and in again, on any grid."""
    rng = np.random.default_rng(seed)
    case = random_case(rng, kind, 5, 11.0) if seed % 2 else random_case(rng, kind, 0, 22.0)
    assert_close(simulate_steps(*case), reference_solver.simulate_steps(*case))


def test_large_compression_few_iterations_and_short_needles():
    # A base moved sideways compresses thin tissue by a third: far beyond the series.
    tissue = Tissue(mu=[0.05], alpha=[8.0], thickness=[3.0])
    case = (NEEDLE, tissue, Bevel(0.02), 12.0, Controls(base_y=1.0))
    fast, slow = simulate(*case), reference_solver.simulate(*case)
    assert np.max(np.abs(fast.u[1:])) / 3.0 > 0.1
    assert_allclose(fast.u, slow.u, atol=1e-7)
    # Only the base moves: the first iteration, from the straight guess, still compresses nothing fully.
    points = np.outer(np.arange(11.0), [1.0, 0.0, 0.0])
    tissue = Tissue(mu=[1e-3], alpha=[1.0], thickness=[0.5])
    shape = equilibrium(NEEDLE, tissue, points, Controls(base_y=40.0))
    assert shape.iterations > 0
    assert shape.status == "over-compressed"
    shape = simulate(
        NEEDLE,
        Tissue(mu=[0.2], alpha=[1.0]),
        Bevel(0.1),
        10.0,
        rules=ModelOptions(tolerance=1e-14, max_iterations=1),
    )
    assert shape.status == "not converged"


def test_a_deflection_of_constant_curvature_is_drawn_as_a_circle():
    """It is exact in cubic elements."""
    x, radius = np.concatenate(([-95.0, -20.0], np.arange(56.0))), 300.0
    along, flat = x + 95.0, np.zeros_like(x)
    bent = x, along**2 / 2 / radius, along / radius, flat, flat
    shape = NeedleShape(*bent, np.zeros((1, 3)), np.zeros((1, 4)), "converged", 0)
    place = compute_positions(shape, np.linspace(x[0], x[-1], 301))
    assert_allclose(np.hypot(place[:, 0] + 95.0, place[:, 1] - radius), radius, atol=1e-9)


# ---- numbers of the kernel that no comparison of shapes determines

DEPTH = 55.0
TISSUE = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])


@pytest.mark.parametrize(("tolerance", "most"), [(1e-7, 1.3), (1e-9, 1.65)])
def test_a_step_takes_little_more_than_one_pass(tolerance, most):
    """A guess that is worse, or tangents that are kept wrongly, cost passes and leave the shape as it is."""
    rules = ModelOptions(tolerance=tolerance)
    alone = simulate(NEEDLE, TISSUE, Bevel(0.085), DEPTH, rules=rules)
    offsets = np.linspace(0.06, 0.11, 16)
    (together,) = simulate_batches([Batch(NEEDLE, TISSUE, (Step(DEPTH, Bevel()),), rules, offset=offsets)])
    assert alone.converged and together.converged.all()
    assert 1.0 <= alone.iterations / DEPTH <= most
    assert 1.0 <= together.iterations.mean() / DEPTH <= most


# ---- what holds the needle, holds it: base, guides, stage and tracked tip, in known answers

TWO_LAYERS = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
BEVEL = Bevel(0.1)


def at(shape, x):
    (node,) = np.flatnonzero(shape.x == x)
    return int(node)


@pytest.mark.parametrize("element", [1.0, 0.5])
@pytest.mark.parametrize("x", [3.0, 3.37, 0.2, 0.0])
@pytest.mark.parametrize("slope", [None, 0.03])
def test_a_guide_in_tissue_holds_once_the_tip_is_past_it_whatever_the_mesh(element, x, slope):
    controls, rules = Controls(guides=(Guide(x, 0.2, slope, True),)), ModelOptions(1.0, element)
    lattice = Lattice(1.0, 1.0)

    def insert(depth):
        return find_last_shape(NEEDLE, TWO_LAYERS, (Step(depth, BEVEL, controls),), rules, lattice)

    shy, past, far = (insert(x + d) for d in (0.049, 0.051, 3.3))
    without = find_last_shape(NEEDLE, TWO_LAYERS, (Step(shy.depth, BEVEL),), rules, lattice)
    assert_allclose(shy.u, without.u, atol=1e-10)
    for shape in (past, far):
        node = at(shape, x)
        assert shape.u[node] == pytest.approx(0.2, abs=1e-13)
        if slope is not None:
            assert shape.slope[node] == pytest.approx(slope, abs=1e-13)


@pytest.mark.parametrize("depth", [0.4, 1.0, 7.3, 9.0])
@pytest.mark.parametrize("spacing", [1.0, 2.0])
@pytest.mark.parametrize("side", [1, -1])
def test_the_first_point_lies_ahead_of_the_free_tip(depth, spacing, side):
    """Load-free until it enters: c_1 = y + slope (L + x_1) + x_1 s b / C_int."""
    y, slope = 0.7, -0.004
    rules = ModelOptions(spacing, spacing)
    shape = simulate(NEEDLE, TWO_LAYERS, Bevel(0.1, side), depth, Controls(y, slope), rules)
    x_1 = shape.constraints[1, 0]
    expected = y + slope * (150 + x_1) + x_1 * side * 0.1 / spacing
    assert shape.constraints[1, 1] == pytest.approx(expected, abs=1e-9)
    np.testing.assert_array_equal(shape.constraints[0], 0.0)  # first contact has been
    assert_allclose(shape.tip_track[0], [y + slope * 150, slope, 0.0, 0.0], atol=1e-12)
