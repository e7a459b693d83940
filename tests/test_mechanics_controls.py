"""What holds the needle, holds it: base, guides, stage and tracked tip, in known answers."""

from itertools import permutations

import numpy as np
import pytest
from refusals import refusal

from needlefit.errors import ModelError
from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.shape import NeedleShape
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue

NEEDLE = Needle(150.0, 1.0e4)
TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
BEVEL = Bevel(0.1)


def at(shape: NeedleShape, x: float) -> int:
    (node,) = np.flatnonzero(shape.x == x)
    return int(node)


@pytest.mark.parametrize("element", [1.0, 0.5])
@pytest.mark.parametrize("x", [3.0, 3.37, 0.2, 0.0])
@pytest.mark.parametrize("slope", [None, 0.03])
def test_a_guide_in_tissue_holds_once_the_tip_is_past_it_whatever_the_mesh(element, x, slope) -> None:
    controls, rules = Controls(guides=(Guide(x, 0.2, slope, True),)), ModelOptions(1.0, element)
    lattice = Lattice(1.0, 1.0)

    def insert(depth: float) -> NeedleShape:
        return simulate_steps(NEEDLE, TISSUE, (Step(depth, BEVEL, controls),), rules, lattice)

    shy, past, far = (insert(x + d) for d in (0.049, 0.051, 3.3))
    without = simulate_steps(NEEDLE, TISSUE, (Step(shy.depth, BEVEL),), rules, lattice)
    np.testing.assert_allclose(shy.u, without.u, atol=1e-10)
    for shape in (past, far):
        node = at(shape, x)
        assert shape.u[node] == pytest.approx(0.2, abs=1e-13)
        if slope is not None:
            assert shape.slope[node] == pytest.approx(slope, abs=1e-13)


@pytest.mark.parametrize("guides", [
    (Guide(3.0, 0.1, None, True),), (Guide(3.0, 0.1, 0.01, True),), (Guide(0.0, 0.05, 0.02, True),),
    (Guide(4.5, 0.1, None, True), Guide(2.0, 0.05, 0.01, True)), (Guide(2.25, 0.1, 0.0, True), Guide(-3.0)),
])  # fmt: skip
@pytest.mark.parametrize("depths", [(2.0, 3.0, 3.1, 4.5, 6.0), (6.0, 3.0, 3.25, 2.0, 2.25, 2.5, 4.5, 4.4)])
@pytest.mark.parametrize("element", [1.0, 0.25])
def test_a_tip_may_halt_on_a_guide(guides: tuple[Guide, ...], depths: tuple, element: float) -> None:
    """At its depth to the bit, a quarter of a millimetre before or behind it, coming from either side."""
    rules, lattice = ModelOptions(1.0, element), Lattice(1.0, 1.0)
    steps = tuple(Step(depth, BEVEL, Controls(guides=guides)) for depth in depths)
    for n in range(1, len(steps) + 1):
        fast = simulate_steps(NEEDLE, TISSUE, steps[:n], rules, lattice)
        assert fast.converged
    slow = reference.simulate_steps(NEEDLE, TISSUE, steps, rules, lattice)
    np.testing.assert_array_equal(fast.x, slow.x)
    np.testing.assert_allclose(fast.u, slow.u, atol=1e-7)
    np.testing.assert_allclose(fast.constraints, slow.constraints, atol=1e-7)


@pytest.mark.parametrize("depth", [0.4, 5.0, 23.1])
def test_the_stage_carries_the_base_along_its_axis(depth: float) -> None:
    steps = (Step(26.0, BEVEL, Controls(0.3, 0.01, 0.02)), Step(depth, BEVEL, Controls(0.3, 0.01, 0.02)))
    for shape in (
        simulate_steps(NEEDLE, TISSUE, steps),
        simulate(NEEDLE, TISSUE, BEVEL, depth, steps[0].controls),
    ):
        assert shape.x[0] == depth - 150
        assert shape.u[0] == 0.3 + 0.02 * depth
        assert shape.slope[0] == 0.01


@pytest.mark.parametrize("depth", [0.4, 1.0, 7.3, 9.0])
@pytest.mark.parametrize("spacing", [1.0, 2.0])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("solve", [simulate, reference.simulate])
def test_the_first_point_lies_ahead_of_the_free_tip(depth, spacing, side, solve) -> None:
    """Load-free until it enters: c_1 = y + slope (L + x_1) + x_1 s b / C_int."""
    y, slope = 0.7, -0.004
    rules = ModelOptions(spacing, spacing)
    shape = solve(NEEDLE, TISSUE, Bevel(0.1, side), depth, Controls(y, slope), rules)
    x_1 = shape.constraints[1, 0]
    expected = y + slope * (150 + x_1) + x_1 * side * 0.1 / spacing
    assert shape.constraints[1, 1] == pytest.approx(expected, abs=1e-9)
    np.testing.assert_array_equal(shape.constraints[0], 0.0)  # first contact has been
    np.testing.assert_allclose(shape.tip_track[0], [y + slope * 150, slope], atol=1e-12)


def test_the_first_point_lies_ahead_of_a_guided_tip_and_guides_may_be_named_in_any_order():
    # The free tip at the entry of a needle clamped at (-10, 0.2), slope 0.01, then y + 0.01 (10 + x_1).
    shape = simulate(NEEDLE, TISSUE, BEVEL, 5.5, Controls(guides=(Guide(-10.0, 0.2, 0.01),)))
    assert shape.constraints[1, 1] == pytest.approx(0.2 + 0.01 * 10.5 + 0.5 * 0.1, abs=1e-9)
    guides = (Guide(-20.0, 0.1, None), Guide(-4.0), Guide(3.3, 0.05, None, True))
    ways = [Controls(guides=order) for order in permutations(guides)]
    assert all(way == ways[0] for way in ways)
    assert ways[-1].before == guides[:2] and ways[-1].within == guides[2:]


@pytest.mark.parametrize("solve", [simulate, reference.simulate])
def test_a_base_that_would_reach_a_guide_is_refused(solve) -> None:
    guides = (Guide(-3.0), Guide(-130.0, 0.0, None))
    assert solve(NEEDLE, TISSUE, BEVEL, 19.9, Controls(guides=guides)).converged
    refusal(ModelError, "guide 130 mm", lambda: solve(NEEDLE, TISSUE, BEVEL, 20.0, Controls(guides=guides)))
