"""The compiled kernel is the reference, over random and extreme cases."""

import numpy as np
import pytest
from mechanics_cases import NEEDLE, RULES, assert_close, random_case

from needlefit.errors import ModelError
from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.shape import NeedleShape, compute_positions, map_beam_points, sample_inserted_points
from needlefit.mechanics.simulate import equilibrium, simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("seed", range(28))
def test_kernel_equals_reference(seed: int, kind: str) -> None:
    """One step, or many: inputs and bevel change on the way in, and out, and in again, on any grid."""
    rng = np.random.default_rng(seed)
    case = random_case(rng, kind, 5, 11.0) if seed % 2 else random_case(rng, kind, 0, 22.0)
    assert_close(simulate_steps(*case), reference.simulate_steps(*case))


@pytest.mark.parametrize("depth", [19.63, 23.79, 44.0, 55.0])
def test_kernel_equals_reference_at_the_papers_depths(depth: float) -> None:
    tissue = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])
    slow = reference.simulate(NEEDLE, tissue, Bevel(0.085), depth)
    for tolerance in (1e-7, 1e-10):
        fast = simulate(NEEDLE, tissue, Bevel(0.085), depth, rules=ModelOptions(tolerance=tolerance))
        np.testing.assert_allclose(fast.u, slow.u, atol=tolerance)


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


def test_large_compression_leaves_the_series_and_still_agrees() -> None:
    """A base moved sideways compresses thin tissue by a third: far beyond the series."""
    tissue = Tissue(mu=[0.05], alpha=[8.0], thickness=[3.0])
    case = (NEEDLE, tissue, Bevel(0.02), 12.0, Controls(base_y=1.0))
    fast, slow = simulate(*case), reference.simulate(*case)
    assert np.max(np.abs(fast.u[1:])) / 3.0 > 0.1
    np.testing.assert_allclose(fast.u, slow.u, atol=1e-7)


@pytest.mark.parametrize(("offset", "thickness"), [(0.2, 0.05), (0.1, 0.1), (0.5, 0.5), (30.0, 1.0)])
def test_over_compression_is_reported_at_any_newton_iteration(offset: float, thickness: float) -> None:
    """Also where the first guess was bearable; what was never found is NaN, not 0."""
    tissue = Tissue(mu=[5.0], alpha=[1.0], thickness=[thickness])
    shape = simulate(NEEDLE, tissue, Bevel(offset), 20.0)
    assert shape.status == "over-compressed"
    assert np.isnan(shape.tip_lateral) and np.isnan(shape.u).all()


def test_a_solve_that_ends_over_compressed_is_reported() -> None:
    """Only the base moves: the first iteration, from the straight guess, still compresses nothing fully."""
    points = np.column_stack((np.arange(11.0), np.zeros(11)))
    tissue = Tissue(mu=[1e-3], alpha=[1.0], thickness=[0.5])
    shape = equilibrium(NEEDLE, tissue, points, Controls(base_y=40.0))
    assert shape.iterations > 0
    assert shape.status == "over-compressed"


@pytest.mark.parametrize("depth", [1e-12, 1e-10, 1e-9, 1e-6])
def test_a_tiny_depth_is_a_depth(depth: float) -> None:
    shape = simulate(NEEDLE, Tissue(mu=[5.0], alpha=[1.0]), Bevel(0.1), depth)
    assert shape.converged and shape.depth == pytest.approx(depth, abs=1e-9)
    assert abs(shape.tip_lateral) <= 0.2 * depth


def test_too_few_iterations_is_not_converged() -> None:
    shape = simulate(
        NEEDLE,
        Tissue(mu=[0.2], alpha=[1.0]),
        Bevel(0.1),
        10.0,
        rules=ModelOptions(tolerance=1e-14, max_iterations=1),
    )
    assert shape.status == "not converged"


def test_needle_too_short_is_refused() -> None:
    with pytest.raises(ModelError, match="149"):
        simulate(NEEDLE, Tissue(mu=[0.2], alpha=[1.0]), Bevel(0.1), 149.0, Controls(guides=(Guide(-2.0),)))


def test_positions_keep_the_length() -> None:
    """Along (x, y) the arc length from entry to tip is the depth."""
    tissue = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])
    shape = simulate(NEEDLE, tissue, Bevel(0.085), 55.0)
    points = compute_positions(shape, np.linspace(0, 55, 5001))
    length = np.sum(np.hypot(*np.diff(points, axis=0).T))
    assert abs(length - 55.0) < 1e-6
    assert 0.05 < 55.0 - points[-1, 0] < 0.3  # the tip lags


def test_positions_of_a_straight_tilted_needle_are_exact() -> None:
    """No bevel and a guide-free, tilted base in almost nothing: a straight line of slope 0.1."""
    shape = simulate(NEEDLE, Tissue(mu=[1e-12], alpha=[1.0]), Bevel(0.0), 30.0, Controls(base_slope=0.1))
    points = compute_positions(shape, np.array([0.0, 30.0]))
    advance = points[1] - points[0]
    np.testing.assert_allclose(advance, [30.0 * np.cos(0.1), 30.0 * np.sin(0.1)], rtol=1e-7)


def bent_to_circle(curvature: float, x: np.ndarray) -> NeedleShape:
    """Return the needle u = curvature (x - x_0)^2 / 2, which no load has to bend."""
    along = x - x[0]
    u, slope = 0.5 * curvature * along**2, curvature * along
    return NeedleShape(x, u, slope, np.zeros((1, 2)), np.zeros((1, 2)), "converged", 0)


def test_a_needle_of_constant_curvature_is_drawn_as_a_circle() -> None:
    radius = 250.0
    shape = bent_to_circle(1 / radius, np.array([-95.0, -20.0, 0.0, 1.0, 2.0, 3.0, 40.0]))
    points = compute_positions(shape, np.linspace(-95.0, 40.0, 271))
    np.testing.assert_allclose(np.hypot(points[:, 0] + 95.0, points[:, 1] - radius), radius, rtol=1e-9)
    np.testing.assert_allclose(np.hypot(*np.diff(points, axis=0).T), 2 * radius * np.sin(0.25 / radius))


@pytest.mark.parametrize("seed", range(4))
def test_positions_equal_the_reference(seed: int) -> None:
    """Short and long elements, gentle and steep: to 1e-6 mm where the base is turned by half a radian."""
    rng = np.random.default_rng(seed)
    guides = (Guide(-30.0, 2.0, None),) if seed % 2 else ()
    controls = Controls(rng.uniform(-10, 10), rng.uniform(-0.5, 0.5), guides=guides)
    shape = simulate(NEEDLE, Tissue(mu=[0.5], alpha=[1.0]), Bevel(0.3), 40.3, controls)
    s = np.union1d(shape.x, rng.uniform(shape.x[0], shape.depth, 50))
    np.testing.assert_allclose(
        compute_positions(shape, s), reference.compute_positions(shape, s), rtol=0, atol=1e-6
    )


def test_points_are_drawn_as_far_from_the_needle_as_the_model_knows_them() -> None:
    """A steep needle falls short of its beam coordinate by centimetres, and what belongs to it with it."""
    shape = simulate(NEEDLE, Tissue(mu=[33.0], alpha=[1.0]), Bevel(0.2), 100.0)
    needle = compute_positions(shape, shape.x)
    np.testing.assert_array_equal(map_beam_points(shape, np.column_stack((shape.x, shape.u))), needle)
    assert shape.x[-1] - needle[-1, 0] > 10.0 and shape.u[-1] - needle[-1, 1] > 5.0
    offsets = np.array([0.3, -0.2])
    beside = map_beam_points(shape, np.column_stack((shape.x[-2:], shape.u[-2:] + offsets)))
    np.testing.assert_allclose(beside - needle[-2:], np.column_stack(([0.0, 0.0], offsets)), atol=1e-12)


def test_inserted_points_begin_at_the_entry_and_end_at_the_tip() -> None:
    shape = simulate(NEEDLE, Tissue(mu=[0.2], alpha=[1.0]), Bevel(0.1), 30.25)
    points = sample_inserted_points(shape, 7)
    assert points.shape == (7, 2)
    assert points[-1, 1] == pytest.approx(shape.tip_lateral)
    assert -0.01 < points[0, 0] <= 0.0  # the free span lags by a little too


@pytest.mark.parametrize("rules", [(1.0, 0.04), (0.04, 0.04)])
def test_elements_so_short_that_rounding_wins_are_refused(rules) -> None:
    """1 kPa tissue with 0.02 mm elements would be 3 % off, and look converged."""
    with pytest.raises(ModelError, match=r"elements of 0\.04 mm"):
        ModelOptions(*rules)


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
