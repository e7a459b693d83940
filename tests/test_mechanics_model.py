"""What the model must do whatever the numbers: symmetry, continuity, refinement, magnitudes."""

import numpy as np
import pytest
from mechanics_cases import NEEDLE

from needlefit.mechanics import reference
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.simulate import equilibrium, simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.scene import RulesRecord
from needlefit.verification.check import Group, find_checks, verify


def phantom(boundaries: tuple[float, ...] = (20.0, 28.0, 45.0)) -> Tissue:
    return Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=np.array(boundaries))


def tip(depth: float, boundaries: tuple[float, ...] = (20.0, 28.0, 45.0), element: float = 1.0) -> float:
    return simulate(
        NEEDLE, phantom(boundaries), Bevel(0.085), depth, rules=ModelOptions(element=element)
    ).tip_lateral


@pytest.mark.parametrize("group", [one for one in Group if one not in (Group.SENSITIVITIES, Group.STATED)])
def test_the_checks_of_verify_pass(group):
    """Closed forms, manufactured solutions, symmetries, balances, the reference, convergence."""
    checks = [one for one in find_checks() if one.group is group]
    assert checks and not verify(1, checks).failed


def test_without_bevel_a_needle_stays_straight_and_alpha_hardly_moves_it():
    shape = simulate(NEEDLE, phantom(), Bevel(0.0), 55.0)
    assert np.max(np.abs(shape.u)) == 0.0
    deflections = [
        simulate(NEEDLE, Tissue(mu=[mu], alpha=[1.0]), Bevel(0.085), 50.0).tip_lateral
        for mu in (0.01, 0.1, 1)
    ]
    assert deflections == sorted(deflections)
    # Why shapes cannot tell alpha: over its whole range the tip moves by 0.01 mm at t = 40 mm.
    ends = [
        simulate(NEEDLE, Tissue(mu=[0.2, 33], alpha=[a, a], boundaries=[20]), Bevel(0.085), 50.0).tip_lateral
        for a in (-3.0, 5.0)
    ]
    assert abs(ends[1] - ends[0]) < 0.015
    assert abs(ends[1] - ends[0]) > 1e-4


@pytest.mark.parametrize("depth", [50.0, 50.5, 45.0, 28.0, 20.5, 49.75])
def test_tip_is_continuous_in_depth(depth: float) -> None:
    """At whole cells, where the entry loses its node, and where the tip enters a layer.

    What is left of a jump is the discretisation error of the mesh that changes there.
    """
    near = [abs(tip(depth + d) - tip(depth - d)) for d in (1e-3, 1e-5)]
    assert near[0] < 8.0 * 2e-3
    assert near[1] < 2e-4


@pytest.mark.parametrize("third", [44.5, 45.0, 45.25, 54.5, 55.0])
def test_tip_is_continuous_in_boundary_position(third: float) -> None:
    """Through a node, a change of constraint, the tip: steep at most, never a jump."""
    step = abs(tip(55.0, (20.0, 28.0, third + 1e-5)) - tip(55.0, (20.0, 28.0, third - 1e-5)))
    assert step < 8.0 * 2e-5 + 1e-7


def test_the_default_mesh_is_converged():
    assert abs(tip(55.0) - tip(55.0, element=0.125)) < 1e-4
    odd = (20.3, 28.7, 45.1)
    assert abs(tip(52.37, odd) - tip(52.37, odd, element=0.125)) < 1e-4


@pytest.mark.parametrize(("depth", "expected"), [(52.79, 3.3), (44.19, 2.2), (23.79, 0.69), (19.63, 0.42)])
def test_magnitudes_with_the_papers_parameters(depth: float, expected: float) -> None:
    """Parameters read as Pa and mm, boundaries invented: the tables imply 4.3, 3.4, 0.9, 0.4 mm."""
    assert tip(depth) == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize(
    ("spacing", "element"), [(1.0, 1.0), (0.5, 0.5), (0.3, 0.3), (1.5, 0.75), (2.0, 1.0), (2.5, 2.5 / 3)]
)
def test_a_record_s_mesh_divides_its_spacing_into_elements_of_up_to_1_mm(spacing, element):
    assert ModelOptions.from_record(RulesRecord(constraint_spacing_mm=spacing)).element == pytest.approx(
        element
    )
    given = RulesRecord(constraint_spacing_mm=spacing, element_mm=spacing / 4)
    assert ModelOptions.from_record(given).element == pytest.approx(spacing / 4)


# ---- variants of the decided rules

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


# ---- friction: a shaft that slides askew is held back less, by the factor 1 - gamma sin^2 of its angle


@pytest.mark.parametrize(("gamma", "factor"), [(0.0, 1.0), (0.5, 0.9), (1.0, 0.8), (2.0, 0.6)])
def test_a_tilted_cantilever_carries_the_load_less_friction(gamma: float, factor: float) -> None:
    """At slope 1/2 sin^2 is 1/5; soft, very distant tissue pulls with a uniform load on the outer part."""
    length, a, load, away = NEEDLE.length, 60.0, 1e-6, 1e8
    tissue = Tissue(mu=[load / away / 3], alpha=[1.0], thickness=[1e9], friction=[gamma], law="linear")
    points = np.column_stack((np.arange(91.0), np.full(91, away)))
    whole = load * (3 * length**4 - 4 * length * a**3 + a**4) / (24 * NEEDLE.flexural_rigidity)
    for slope in (0.5, -0.5):
        shape = equilibrium(NEEDLE, tissue, points, Controls(base_slope=slope))
        assert shape.u[-1] - slope * length == pytest.approx(factor * whole, rel=1e-3)


@pytest.mark.parametrize("solve", [simulate, reference.simulate])
def test_newton_stays_quadratic_with_friction(solve) -> None:
    """Its slope is part of Newton's matrix: it costs at most one iteration in each of the twelve cells."""
    without, strong = (
        solve(NEEDLE, Tissue([0.5], [2.0], friction=[gamma]), BEVEL, 12.0, Controls(base_slope=0.2))
        for gamma in (0.0, 3.0)
    )
    assert strong.converged and strong.iterations <= without.iterations + 12
