"""A needle that leaves its plane: what must hold whatever the numbers, and known answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mechanics_cases import NEEDLE, RULES, random_case
from space_cases import assert_turned, list_planes, random_spatial_case, turn_step

from needlefit.mechanics import reference
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import compute_roll_lag, find_roll, turn_tip

FINE = 1e-11
TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("seed", range(3))
def test_all_inputs_turned_about_x_give_the_needle_turned(seed: int, kind: str) -> None:
    needle, tissue, steps, rules, lattice = random_spatial_case(np.random.default_rng(seed), kind)
    rules = replace(rules, tolerance=FINE)
    turned = tuple(turn_step(step, 40.0) for step in steps)
    one, other = (reference.simulate_steps(needle, tissue, s, rules, lattice) for s in (steps, turned))
    assert one.w is not None
    assert_turned(other, one, 40.0, 2e-8)  # of short, stiff elements, rounding


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("roll", [90.0, 180.0, 270.0, 33.0])
def test_a_planar_insertion_that_is_rolled_is_the_planar_needle_rolled(roll: float, kind: str) -> None:
    needle, tissue, steps, rules, lattice = random_case(np.random.default_rng(int(roll)), kind)
    rules = replace(rules, tolerance=FINE)
    turned = tuple(turn_step(step, roll) for step in steps)
    one, other = (reference.simulate_steps(needle, tissue, s, rules, lattice) for s in (steps, turned))
    assert one.w is None
    assert_turned(other, one, roll, 2e-8)


def test_rolling_is_exact_in_a_common_needle() -> None:
    steps = Step(11.3, Bevel(0.085, roll_deg=10.0)), Step(24.3, Bevel(0.085, roll_deg=120.0))
    one = reference.simulate_steps(NEEDLE, TISSUE, steps, ModelOptions(tolerance=FINE))
    turned = tuple(turn_step(step, 40.0) for step in steps)
    other = reference.simulate_steps(NEEDLE, TISSUE, turned, ModelOptions(tolerance=FINE))
    assert_turned(other, one, 40.0, 1e-10)


def test_a_roll_of_180_degrees_is_the_other_side() -> None:
    steps = Step(6.0, Bevel(0.1)), Step(12.5, Bevel(0.1, roll_deg=180.0))
    flipped = Step(6.0, Bevel(0.1)), Step(12.5, Bevel(0.1, -1))
    one, other = (reference.simulate_steps(NEEDLE, TISSUE, s) for s in (steps, flipped))
    assert one.w is None and other.w is None
    np.testing.assert_array_equal(one.u, other.u)


@pytest.mark.parametrize("quarters", range(-5, 6))
def test_quarter_turns_are_exact(quarters: int) -> None:
    exact = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][quarters % 4]
    assert Bevel(0.1, roll_deg=90.0 * quarters).toward == exact
    assert Bevel(0.1, -1, roll_deg=90.0 * quarters + 180.0).toward == exact
    y, z = Bevel(0.1, roll_deg=90.0 * quarters + 30.0).toward
    angle = math.radians(90.0 * quarters + 30.0)
    assert (y, z) == pytest.approx((math.cos(angle), math.sin(angle)), abs=1e-15)


def test_a_needle_turned_by_90_degrees_bends_to_y_and_then_to_z() -> None:
    steps = Step(10.0, Bevel(0.1)), Step(20.0, Bevel(0.1, roll_deg=90.0))
    shape = reference.simulate_steps(NEEDLE, TISSUE, steps)
    before = reference.simulate_steps(NEEDLE, TISSUE, steps[:1])
    assert shape.w is not None and before.w is None
    y, z = list_planes(shape)["constraints"]
    np.testing.assert_allclose(y[:11], before.constraints[:, 1], atol=1e-7)
    np.testing.assert_array_equal(z[:11], 0.0)  # the cut before the turn stays in the plane
    assert z[11] == pytest.approx(0.1, abs=1e-12)  # along the tangent, turned toward z
    assert z[20] > 0.2 and y[20] > 0.2


def test_points_in_space_keep_the_length() -> None:
    steps = Step(20.0, Bevel(0.2)), Step(40.0, Bevel(0.2, roll_deg=90.0))
    shape = reference.simulate_steps(NEEDLE, TISSUE, steps, ModelOptions(2.0, 2.0))
    points = reference.compute_positions(shape, np.linspace(0.0, 40.0, 201))
    assert points.shape == (201, 3)
    length = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1))
    assert length == pytest.approx(40.0, abs=1e-4)
    assert points[-1, 2] > 0.1


# ---- the roll lag

FREE = Tissue(mu=[0.2], alpha=[1.0])
TWISTED = Tissue(mu=[0.2], alpha=[1.0], torsional_friction=0.5)


def test_the_tip_stays_behind_the_hub_by_the_lag() -> None:
    """tau d / GJ (d / 2 + L - d), and a turn back moves it only beyond twice that."""
    rigidity = NEEDLE.flexural_rigidity / 1.3
    lag = math.degrees(0.5 * 20.0 / rigidity * (10.0 + 130.0))
    assert compute_roll_lag(NEEDLE, TWISTED, 20.0) == pytest.approx(lag)
    rolls = [0.0, 90.0, 80.0, 90.0 - 2 * lag - 5.0]
    depths = [20.0, 30.0, 30.0, 40.0]
    steps = [Step(d, Bevel(0.1, roll_deg=r)) for d, r in zip(depths, rolls, strict=True)]
    found = [find_roll(step.bevel) for step in turn_tip(NEEDLE, TWISTED, steps)]
    deeper = compute_roll_lag(NEEDLE, TWISTED, 30.0)
    assert 5.0 < lag < deeper < 20.0
    assert found == pytest.approx([0.0, 90.0 - lag, 90.0 - lag, rolls[3] + deeper])
    untwisted = turn_tip(NEEDLE, TISSUE, steps)
    assert [find_roll(step.bevel) for step in untwisted] == rolls


def test_a_retraction_lets_the_tip_follow_and_sub_steps_change_nothing() -> None:
    turned = Bevel(0.1, roll_deg=90.0)
    back = [Step(30.0, Bevel(0.1)), Step(30.0, turned), Step(5.0, turned), Step(12.0, turned)]
    small = [*back[:2], *(Step(30.0 - n, turned) for n in range(1, 26)), Step(8.5, turned), back[3]]
    one, other = (turn_tip(NEEDLE, TWISTED, steps)[-1].bevel for steps in (back, small))
    assert one == other
    assert find_roll(one) == pytest.approx(90.0 - compute_roll_lag(NEEDLE, TWISTED, 5.0))
    out = turn_tip(NEEDLE, TWISTED, [*back[:2], Step(0.0, turned)])[-1].bevel
    assert out == turned


def test_a_lagging_needle_leaves_its_plane_when_it_is_turned_over() -> None:
    steps = Step(15.0, Bevel(0.1)), Step(25.0, Bevel(0.1, -1))
    shape = reference.simulate_steps(NEEDLE, TWISTED, steps)
    behind = Bevel(0.1, roll_deg=180.0 - compute_roll_lag(NEEDLE, TWISTED, 15.0))
    expected = reference.simulate_steps(NEEDLE, FREE, (steps[0], Step(25.0, behind)))
    assert shape.w is not None and expected.w is not None and abs(shape.w[-1]) > 0.01
    np.testing.assert_allclose(shape.w, expected.w, atol=1e-9)


@pytest.mark.parametrize("name", ["base_z", "base_slope_z", "stage_slope_z"])
def test_inputs_along_z_leave_the_plane(name: str) -> None:
    assert Step(5.0, Bevel(0.1, -1), Controls(0.3, 0.1)).planar
    assert not Step(5.0, Bevel(0.1, -1), Controls(**{name: 0.1})).planar
