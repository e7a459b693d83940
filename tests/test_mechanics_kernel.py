"""The compiled kernel is the reference, over random and extreme cases."""

from itertools import permutations

import numpy as np
import pytest
from mechanics_cases import NEEDLE, RULES, assert_close, random_case
from refusals import refusal
from scipy.interpolate import CubicHermiteSpline

from needlefit.errors import ModelError
from needlefit.mechanics import native, reference
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.shape import NeedleShape, compute_positions, map_beam_points, sample_inserted_points
from needlefit.mechanics.simulate import compute_lateral_load, equilibrium, simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("seed", range(28))
def test_kernel_equals_reference(seed: int, kind: str) -> None:
    """One step, or many: inputs and bevel change on the way in, and out, and in again, on any grid."""
    rng = np.random.default_rng(seed)
    case = random_case(rng, kind, 5, 11.0) if seed % 2 else random_case(rng, kind, 0, 22.0)
    assert_close(simulate_steps(*case), reference.simulate_steps(*case))


@pytest.mark.parametrize("solve", [simulate, reference.simulate])
@pytest.mark.parametrize(
    ("spacing", "first", "cut"), [(0.5, 0.3, 0.12), (1.0, 0.3, 0.06), (2.0, 1.3, 0.13), (10.0, 7.3, 0.146)]
)
def test_the_bevel_turns_the_cut_once_per_constraint_spacing(solve, spacing, first, cut) -> None:
    """7.3 mm deep, b = 0.2 mm: the first cell is the remainder x_1, and its point lies at x_1 b / C_int."""
    tissue, rules = Tissue(mu=[0.2], alpha=[1.0]), ModelOptions(spacing, spacing / 2)
    for side in (1, -1):
        found = solve(NEEDLE, tissue, Bevel(0.2, side), 7.3, rules=rules).constraints
        np.testing.assert_allclose(found[:2], [[0.0, 0.0], [first, side * cut]], atol=1e-12)
        np.testing.assert_allclose(np.diff(found[1:, 0]), spacing)
        assert found[-1, 0] == 7.3


@pytest.mark.parametrize("element", [0.125, 0.0625])
def test_rounding_on_a_fine_mesh_in_soft_tissue_is_no_failure(element: float) -> None:
    """Increments there end at 1e-6 mm, which the tolerance does not get below; the tip is the same."""
    soft = Tissue(mu=[1e-3], alpha=[1.0])
    fine, default = (
        simulate(NEEDLE, soft, Bevel(0.1), 50.0, rules=ModelOptions(1.0, h)) for h in (element, 1.0)
    )
    assert fine.converged
    assert fine.tip_lateral == pytest.approx(default.tip_lateral, abs=2e-4)


def test_large_compression_few_iterations_and_short_needles():
    # A base moved sideways compresses thin tissue by a third: far beyond the series.
    tissue = Tissue(mu=[0.05], alpha=[8.0], thickness=[3.0])
    case = (NEEDLE, tissue, Bevel(0.02), 12.0, Controls(base_y=1.0))
    fast, slow = simulate(*case), reference.simulate(*case)
    assert np.max(np.abs(fast.u[1:])) / 3.0 > 0.1
    np.testing.assert_allclose(fast.u, slow.u, atol=1e-7)
    # Only the base moves: the first iteration, from the straight guess, still compresses nothing fully.
    points = np.column_stack((np.arange(11.0), np.zeros(11)))
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
    with pytest.raises(ModelError, match="149"):
        simulate(NEEDLE, Tissue(mu=[0.2], alpha=[1.0]), Bevel(0.1), 149.0, Controls(guides=(Guide(-2.0),)))


@pytest.mark.parametrize(("offset", "thickness"), [(0.2, 0.05), (0.1, 0.1), (0.5, 0.5), (30.0, 1.0)])
def test_over_compression_is_reported_at_any_newton_iteration(offset: float, thickness: float) -> None:
    """Also where the first guess was bearable; what was never found is NaN, not 0."""
    tissue = Tissue(mu=[5.0], alpha=[1.0], thickness=[thickness])
    shape = simulate(NEEDLE, tissue, Bevel(offset), 20.0)
    assert shape.status == "over-compressed"
    assert np.isnan(shape.tip_lateral) and np.isnan(shape.u).all()


@pytest.mark.parametrize("depth", [1e-12, 1e-10, 1e-9, 1e-6])
def test_a_tiny_depth_is_a_depth(depth: float) -> None:
    shape = simulate(NEEDLE, Tissue(mu=[5.0], alpha=[1.0]), Bevel(0.1), depth)
    assert shape.converged and shape.depth == pytest.approx(depth, abs=1e-9)
    assert abs(shape.tip_lateral) <= 0.2 * depth


def test_positions_keep_the_length():
    # Along (x, y) the arc length from entry to tip is the depth.
    tissue = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])
    shape = simulate(NEEDLE, tissue, Bevel(0.085), 55.0)
    points = compute_positions(shape, np.linspace(0, 55, 5001))
    length = np.sum(np.hypot(*np.diff(points, axis=0).T))
    assert abs(length - 55.0) < 1e-6
    assert 0.05 < 55.0 - points[-1, 0] < 0.3  # the tip lags
    # No bevel and a guide-free, tilted base in almost nothing: a straight line of slope 0.1.
    shape = simulate(NEEDLE, Tissue(mu=[1e-12], alpha=[1.0]), Bevel(0.0), 30.0, Controls(base_slope=0.1))
    points = compute_positions(shape, np.array([0.0, 30.0]))
    advance = points[1] - points[0]
    np.testing.assert_allclose(advance, [30.0 * np.cos(0.1), 30.0 * np.sin(0.1)], rtol=1e-7)
    shape = simulate(NEEDLE, Tissue(mu=[0.2], alpha=[1.0]), Bevel(0.1), 30.25)
    points = sample_inserted_points(shape, 7)
    assert points.shape == (7, 2)
    assert points[-1, 1] == pytest.approx(shape.tip_lateral)
    assert -0.01 < points[0, 0] <= 0.0  # the free span lags by a little too


def test_a_deflection_of_constant_curvature_is_drawn_as_a_circle() -> None:
    """It is exact in cubic elements."""
    x, radius = np.concatenate(([-95.0, -20.0], np.arange(56.0))), 300.0
    along, still = x + 95.0, np.zeros((1, 2))
    shape = NeedleShape(x, along**2 / 2 / radius, along / radius, still, still, "converged", 0)
    place = compute_positions(shape, np.linspace(x[0], x[-1], 301))
    np.testing.assert_allclose(np.hypot(place[:, 0] + 95.0, place[:, 1] - radius), radius, atol=1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_points_in_the_plane_are_those_of_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = simulate_steps(*random_case(rng))
    s = np.union1d(shape.x, rng.uniform(shape.x[0], shape.depth, 100))
    np.testing.assert_allclose(compute_positions(shape, s), reference.compute_positions(shape, s), atol=1e-6)


def test_points_are_drawn_as_far_from_the_needle_as_the_model_knows_them() -> None:
    """A steep needle falls short of its beam coordinate by centimetres, and what belongs to it with it."""
    shape = simulate(NEEDLE, Tissue(mu=[33.0], alpha=[1.0]), Bevel(0.2), 100.0)
    needle = compute_positions(shape, shape.x)
    np.testing.assert_array_equal(map_beam_points(shape, np.column_stack((shape.x, shape.u))), needle)
    assert shape.x[-1] - needle[-1, 0] > 10.0 and shape.u[-1] - needle[-1, 1] > 5.0
    offsets = np.array([0.3, -0.2])
    beside = map_beam_points(shape, np.column_stack((shape.x[-2:], shape.u[-2:] + offsets)))
    np.testing.assert_allclose(beside - needle[-2:], np.column_stack(([0.0, 0.0], offsets)), atol=1e-12)


def test_an_over_compressed_guess_is_not_the_solution() -> None:
    """The base moves by more than t before the first cell; the needle finds its place, and stays there."""
    tissue = Tissue(mu=[33.0], alpha=[1.0], thickness=[5.0])
    found = simulate_steps(NEEDLE, tissue, (Step(3.0, Bevel(0.05), Controls(base_y=5.1)),))
    assert found.converged and 3.0 < found.tip_lateral < 5.0
    state = np.column_stack((found.u, found.slope)).ravel()
    again, used = reference.equilibrium(
        NEEDLE,
        tissue,
        found.x,
        found.constraints,
        state,
        np.arange(len(state)) < 2,
        ModelOptions(tolerance=np.inf),
    )
    assert used == 1
    np.testing.assert_allclose(again, state, atol=1e-7)


# ---- numbers of the kernel that no comparison of shapes determines

DEPTH = 55.0
TISSUE = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])


@pytest.mark.parametrize(("tolerance", "most"), [(1e-7, 1.3), (1e-9, 1.65)])
def test_a_step_takes_little_more_than_one_pass(tolerance: float, most: float) -> None:
    """A guess that is worse, or tangents that are kept wrongly, cost passes and leave the shape as it is."""
    rules = ModelOptions(tolerance=tolerance)
    alone = simulate(NEEDLE, TISSUE, Bevel(0.085), DEPTH, rules=rules)
    offsets = np.linspace(0.06, 0.11, 16)
    (together,) = simulate_batches([Batch(NEEDLE, TISSUE, (Step(DEPTH, Bevel()),), rules, offset=offsets)])
    assert alone.converged and together.converged.all()
    assert 1.0 <= alone.iterations / DEPTH <= most
    assert 1.0 <= together.iterations.mean() / DEPTH <= most


def test_deflections_between_nodes_are_cubic() -> None:
    """Also beyond the ends, where the cubic of the nearest element goes on."""
    shape = simulate(NEEDLE, TISSUE, Bevel(0.085), 20.3)
    s = np.random.default_rng(1).uniform(shape.x[0] - 1.0, shape.depth + 1.0, 200)  # in no order
    exact = CubicHermiteSpline(shape.x, shape.u, shape.slope)(s)
    found = native.compute_deflections(shape.x, shape.u, shape.slope, s)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12)


def test_the_load_at_a_point_does_not_depend_on_the_others() -> None:
    shape = simulate(NEEDLE, TISSUE, Bevel(0.085), 30.0)
    s = np.random.default_rng(2).uniform(-20.0, 30.0, 60)
    found = compute_lateral_load(shape, TISSUE, s)
    np.testing.assert_array_equal(
        found, [compute_lateral_load(shape, TISSUE, s[i : i + 1])[0] for i in range(60)]
    )
    np.testing.assert_array_equal(found == 0.0, s < 0.0)


def test_the_mesh_of_an_equilibrium_starts_from_the_depth_of_point_1() -> None:
    for first, inside in ((0.3, [0.0, 0.3, 0.8, 1.3, 1.8, 2.3]), (0.7, [0.2, 0.7, 1.2, 1.7, 2.2, 2.7])):
        depths = first + np.arange(3.0)
        points = np.column_stack((np.concatenate(([0.0], depths)), np.zeros(4)))
        found = equilibrium(NEEDLE, TISSUE, points, rules=ModelOptions(1.0, 0.5))
        np.testing.assert_allclose(found.x, [depths[-1] - 150.0, *inside], atol=1e-12)


@pytest.mark.parametrize("guided", [False, True])
@pytest.mark.parametrize("friction", [0.0, 0.3, 0.9])
@pytest.mark.parametrize(("alpha", "depth"), [(-8.0, 7.5), (8.0, 12.0)])
def test_newtons_method_goes_on_until_nothing_moves(
    alpha: float, depth: float, friction: float, guided: bool
) -> None:
    """One more step changes nothing, also where all elements are linearised in every pass (`guided`).

    The increment before the last is of some 1e-5 mm here: ending there would be wrong by 1e-7 mm.
    """
    tissue = Tissue(mu=[0.5], alpha=[alpha], thickness=[0.2], friction=[friction])
    not_reached = (Guide(60.0, 0.0, None, in_tissue=True),) if guided else ()
    found = simulate(NEEDLE, tissue, Bevel(0.1), depth, Controls(guides=not_reached))
    state = np.column_stack((found.u, found.slope)).ravel()
    held = np.arange(len(state)) < 2
    again, used = reference.equilibrium(
        NEEDLE, tissue, found.x, found.constraints, state, held, ModelOptions(tolerance=np.inf)
    )
    assert found.converged and used == 1
    np.testing.assert_allclose(again[0::2], found.u, rtol=0, atol=3e-10)


# ---- what holds the needle, holds it: base, guides, stage and tracked tip, in known answers

TWO_LAYERS = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
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
        return simulate_steps(NEEDLE, TWO_LAYERS, (Step(depth, BEVEL, controls),), rules, lattice)

    shy, past, far = (insert(x + d) for d in (0.049, 0.051, 3.3))
    without = simulate_steps(NEEDLE, TWO_LAYERS, (Step(shy.depth, BEVEL),), rules, lattice)
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
        fast = simulate_steps(NEEDLE, TWO_LAYERS, steps[:n], rules, lattice)
        assert fast.converged
    slow = reference.simulate_steps(NEEDLE, TWO_LAYERS, steps, rules, lattice)
    np.testing.assert_array_equal(fast.x, slow.x)
    np.testing.assert_allclose(fast.u, slow.u, atol=1e-7)
    np.testing.assert_allclose(fast.constraints, slow.constraints, atol=1e-7)


@pytest.mark.parametrize("depth", [0.4, 5.0, 23.1])
def test_the_stage_carries_the_base_along_its_axis(depth: float) -> None:
    steps = (Step(26.0, BEVEL, Controls(0.3, 0.01, 0.02)), Step(depth, BEVEL, Controls(0.3, 0.01, 0.02)))
    for shape in (
        simulate_steps(NEEDLE, TWO_LAYERS, steps),
        simulate(NEEDLE, TWO_LAYERS, BEVEL, depth, steps[0].controls),
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
    shape = solve(NEEDLE, TWO_LAYERS, Bevel(0.1, side), depth, Controls(y, slope), rules)
    x_1 = shape.constraints[1, 0]
    expected = y + slope * (150 + x_1) + x_1 * side * 0.1 / spacing
    assert shape.constraints[1, 1] == pytest.approx(expected, abs=1e-9)
    np.testing.assert_array_equal(shape.constraints[0], 0.0)  # first contact has been
    np.testing.assert_allclose(shape.tip_track[0], [y + slope * 150, slope], atol=1e-12)


def test_the_first_point_lies_ahead_of_a_guided_tip_and_guides_may_be_named_in_any_order():
    # The free tip at the entry of a needle clamped at (-10, 0.2), slope 0.01, then y + 0.01 (10 + x_1).
    shape = simulate(NEEDLE, TWO_LAYERS, BEVEL, 5.5, Controls(guides=(Guide(-10.0, 0.2, 0.01),)))
    assert shape.constraints[1, 1] == pytest.approx(0.2 + 0.01 * 10.5 + 0.5 * 0.1, abs=1e-9)
    guides = (Guide(-20.0, 0.1, None), Guide(-4.0), Guide(3.3, 0.05, None, True))
    ways = [Controls(guides=order) for order in permutations(guides)]
    assert all(way == ways[0] for way in ways)
    assert ways[-1].before == guides[:2] and ways[-1].within == guides[2:]


@pytest.mark.parametrize("solve", [simulate, reference.simulate])
def test_a_base_that_would_reach_a_guide_is_refused(solve) -> None:
    guides = (Guide(-3.0), Guide(-130.0, 0.0, None))
    assert solve(NEEDLE, TWO_LAYERS, BEVEL, 19.9, Controls(guides=guides)).converged
    refusal(
        ModelError, "guide 130 mm", lambda: solve(NEEDLE, TWO_LAYERS, BEVEL, 20.0, Controls(guides=guides))
    )
