"""Numbers of the kernel that no comparison of shapes determines."""

import numpy as np
import pytest
from mechanics_cases import NEEDLE, assert_same_bits
from scipy.interpolate import CubicHermiteSpline

from needlefit.mechanics import native, reference
from needlefit.mechanics.batch import Batch, simulate_batches
from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step
from needlefit.mechanics.load import compute_lateral_load
from needlefit.mechanics.simulate import equilibrium, simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue

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


@pytest.mark.parametrize(("thickness", "mu", "alpha"), [(0.5, 0.2, 1.0), (0.3, 1.0, 3.0), (0.2, 5.0, 1.0)])
def test_sets_whose_tissue_is_crushed_leave_the_others_as_they_are(thickness, mu, alpha) -> None:
    """Each set has the bytes that it has alone, though others begin again, or fail, at other stops."""
    tissue = Tissue(mu=[mu], alpha=[alpha], thickness=[thickness])
    steps, offsets = (Step(30.0, Bevel()),), np.linspace(0.02, 0.5, 8)
    batch = Batch(NEEDLE, tissue, steps, offset=offsets)
    (together,) = simulate_batches([batch])
    for i in range(len(batch)):
        alone = simulate_steps(*batch.pick(i))
        assert_same_bits(together[i], alone)


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
