"""A needle that leaves its plane: what must hold whatever the numbers, and known answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
import reference_solver
from mechanics_cases import NEEDLE, RULES, assert_close, assert_same_bits, list_seeds, pick, random_case
from needle_loads import compute_loads
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import approx
from refusals import refusal
from space_cases import random_spatial_case

from needlefit import Bevel, Controls, ModelOptions, Session, Step, Tissue
from needlefit.errors import ModelError
from needlefit.mechanics.batch import Batch, linearize_batches
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.shape import LIMITS, compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.torsion import compute_roll_lag, find_roll, turn_tip

FINE = 1e-11
TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("draw", [random_spatial_case, random_case])
@pytest.mark.parametrize("seed", list_seeds(20, 4))
def test_kernel_equals_reference(seed, draw, kind):
    """One step, or many: inputs and bevel change on the way in, and out, and in again, on any grid."""
    rng = default_rng(seed)
    case = draw(rng, kind, 5, 11.0) if seed % 2 else draw(rng, kind, 0, 22.0)
    found, expected = simulate_steps(*case), reference_solver.simulate_steps(*case)
    assert found.leaves_plane == (draw is random_spatial_case)
    assert_close(found, expected)
    s = np.union1d(found.x, rng.uniform(found.x[0], found.depth, 20))
    points = compute_positions(found, s)
    atol = 1e-6 if found.validity.max_slope < 0.3 else 1e-4  # five points in each free span
    assert_allclose(points, reference_solver.compute_positions(expected, s), atol=atol)
    assert (found.tip_lateral, found.tip_z) == approx(points[-1, 1:], abs=1e-12)


# ---- derivatives, sets side by side, sessions


def test_a_twisted_session_follows_the_hub_as_the_steps_do():
    steps = (
        Step(15.0, Bevel(0.1)),
        Step(25.0, Bevel(0.1, -1)),
        Step(9.5, Bevel(0.1, -1)),
        Step(20.0, Bevel(0.1)),
    )
    session = Session(NEEDLE, TWISTED, steps[0].bevel, 1.0)
    for step in steps:
        shape = session.go(step)
    expected = simulate_steps(NEEDLE, TWISTED, steps, lattice=Lattice(1.0, 1.0))
    assert_same_bits(shape, expected, but=("iterations",))
    assert_close(shape, reference_solver.simulate_steps(NEEDLE, TWISTED, steps, lattice=Lattice(1.0, 1.0)))
    refusal(ModelError, "torsional friction", session.input_path)


# ---- forces, validity, and a helix


def test_validity_and_forces_do_not_depend_on_the_roll():
    tissue = replace(TISSUE, thickness=np.array([5.0, 5.0]))
    shapes = []
    for roll in (0.0, 60.0):
        steps = Step(9.0, Bevel(0.3, roll_deg=roll)), Step(21.0, Bevel(0.3, roll_deg=roll + 180.0))
        shapes.append(simulate_steps(NEEDLE, tissue, steps, ModelOptions(tolerance=FINE)))
    one, other = shapes
    for name, _, _ in LIMITS:
        assert getattr(other.validity, name) == approx(getattr(one.validity, name), rel=2e-3), name
    first, second = (compute_loads(shape, tissue, NEEDLE, Controls()) for shape in shapes)
    turned = first.tip_region_force * np.array([0.5, math.sqrt(0.75)])
    assert (second.tip_region_force, second.tip_region_force_z) == approx(turned, rel=1e-6)


# ---- the roll lag

TWISTED = Tissue(mu=[0.2], alpha=[1.0], torsional_friction=0.5)


def test_the_tip_stays_behind_the_hub_by_the_lag():
    """tau d / GJ (d / 2 + L - d), and a turn back moves it only beyond twice that."""
    rigidity = NEEDLE.flexural_rigidity / 1.3
    lag = math.degrees(0.5 * 20.0 / rigidity * (10.0 + 130.0))
    assert compute_roll_lag(NEEDLE, TWISTED, 20.0) == approx(lag)
    rolls = [0.0, 90.0, 80.0, 90.0 - 2 * lag - 5.0]
    depths = [20.0, 30.0, 30.0, 40.0]
    steps = [Step(d, Bevel(0.1, roll_deg=r)) for d, r in zip(depths, rolls, strict=True)]
    found = [find_roll(step.bevel) for step in turn_tip(NEEDLE, TWISTED, steps)]
    deeper = compute_roll_lag(NEEDLE, TWISTED, 30.0)
    assert 5.0 < lag < deeper < 20.0
    assert found == approx([0.0, 90.0 - lag, 90.0 - lag, rolls[3] + deeper])
    untwisted = turn_tip(NEEDLE, TISSUE, steps)
    assert [find_roll(step.bevel) for step in untwisted] == rolls


def test_a_retraction_lets_the_tip_follow_and_sub_steps_change_nothing():
    turned = Bevel(0.1, roll_deg=90.0)
    back = [Step(30.0, Bevel(0.1)), Step(30.0, turned), Step(5.0, turned), Step(12.0, turned)]
    small = [*back[:2], *(Step(30.0 - n, turned) for n in range(1, 26)), back[3]]
    one, other = (turn_tip(NEEDLE, TWISTED, steps)[-1].bevel for steps in (back, small))
    assert one == other
    assert find_roll(one) == approx(90.0 - compute_roll_lag(NEEDLE, TWISTED, 5.0))


@pytest.mark.parametrize(("name", "value"), [("roll", 0.3), ("base_z", 0.1), ("base_slope_z", 1e-3)])
def test_sets_of_one_insertion_differ_by_roll_and_base(name, value):
    needle, tissue, steps, rules, _ = random_case(default_rng(2), "decided", 3, 9.0)
    rules = replace(rules, tolerance=FINE)
    batch = Batch(needle, tissue, steps, rules, **{name: value + np.array([0.0, 1e-4])})
    ((shapes, jacobians),) = linearize_batches([batch], (name,))
    for i in range(2):
        assert_close(shapes[i], simulate_steps(*pick(batch, i)), 1e-9)
    difference = (shapes.w[1] - shapes.w[0]) / 1e-4
    assert_allclose(jacobians.u[1, 0, :, 0], difference, rtol=1e-3, atol=1e-5)
