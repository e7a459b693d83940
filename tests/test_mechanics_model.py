"""What the model must do whatever the numbers: symmetry, continuity, refinement, magnitudes."""

import numpy as np
import pytest
from mechanics_cases import NEEDLE

from needlefit.errors import ModelError
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.scene import RulesRecord


def phantom(boundaries: tuple[float, ...] = (20.0, 28.0, 45.0)) -> Tissue:
    return Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=np.array(boundaries))


def tip(depth: float, boundaries: tuple[float, ...] = (20.0, 28.0, 45.0), element: float = 1.0) -> float:
    return simulate(
        NEEDLE, phantom(boundaries), Bevel(0.085), depth, rules=ModelOptions(element=element)
    ).tip_lateral


def test_without_bevel_the_needle_stays_straight() -> None:
    shape = simulate(NEEDLE, phantom(), Bevel(0.0), 55.0)
    assert np.max(np.abs(shape.u)) == 0.0


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


def test_default_mesh_is_converged() -> None:
    assert abs(tip(55.0) - tip(55.0, element=0.125)) < 1e-4
    odd = (20.3, 28.7, 45.1)
    assert abs(tip(52.37, odd) - tip(52.37, odd, element=0.125)) < 1e-4


def test_a_layer_cut_in_two_is_the_same_layer() -> None:
    whole = Tissue(mu=[0.2, 33], alpha=[1, -1], boundaries=[17.2])
    cut = Tissue(mu=[0.2, 0.2, 33], alpha=[1, 1, -1], boundaries=[9.37, 17.2])
    one, two = (simulate(NEEDLE, tissue, Bevel(0.085), 30.0) for tissue in (whole, cut))
    np.testing.assert_allclose(one.u, two.u, atol=1e-6)


@pytest.mark.parametrize(("depth", "expected"), [(52.79, 3.3), (44.19, 2.2), (23.79, 0.69), (19.63, 0.42)])
def test_magnitudes_with_the_papers_parameters(depth: float, expected: float) -> None:
    """Parameters read as Pa and mm, boundaries invented: the tables imply 4.3, 3.4, 0.9, 0.4 mm."""
    assert tip(depth) == pytest.approx(expected, rel=0.06)


def test_one_more_modulus_bends_more_in_stiff_tissue() -> None:
    deflections = [
        simulate(NEEDLE, Tissue(mu=[mu], alpha=[1.0]), Bevel(0.085), 50.0).tip_lateral
        for mu in (0.01, 0.1, 1)
    ]
    assert deflections == sorted(deflections)


def test_alpha_hardly_moves_the_tip() -> None:
    """Why shapes cannot tell alpha: over its whole range the tip moves by 0.01 mm at t = 40 mm."""
    ends = [
        simulate(NEEDLE, Tissue(mu=[0.2, 33], alpha=[a, a], boundaries=[20]), Bevel(0.085), 50.0).tip_lateral
        for a in (-3.0, 5.0)
    ]
    assert abs(ends[1] - ends[0]) < 0.015
    assert abs(ends[1] - ends[0]) > 1e-4


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"mu": [0.2, -1.0]}, "layer 2 .*mu -1 MPa"),
        ({"thickness": [0.0, 40.0]}, "layer 1 .*thickness 0 mm"),
        ({"friction": [0.0, -0.1]}, r"layer 2 .*friction -0\.1"),
    ],
)
def test_a_wrong_layer_is_named_with_its_value(wrong, message):
    with pytest.raises(ModelError, match=message):
        Tissue(**{"mu": np.ones(2), "alpha": np.ones(2), "boundaries": np.array([5.0])} | wrong)


@pytest.mark.parametrize(
    ("spacing", "element"), [(1.0, 1.0), (0.5, 0.5), (0.3, 0.3), (1.5, 0.75), (2.0, 1.0), (2.5, 2.5 / 3)]
)
def test_a_record_s_mesh_divides_its_spacing_into_elements_of_up_to_1_mm(spacing, element):
    assert ModelOptions.from_record(RulesRecord(constraint_spacing_mm=spacing)).element == pytest.approx(
        element
    )
    given = RulesRecord(constraint_spacing_mm=spacing, element_mm=spacing / 4)
    assert ModelOptions.from_record(given).element == pytest.approx(spacing / 4)
