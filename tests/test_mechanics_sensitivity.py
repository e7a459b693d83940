"""The Jacobian is the derivative: complex steps through the equations, and what is known beforehand."""

from dataclasses import replace

import numpy as np
import pytest
from mechanics_cases import (
    NEEDLE,
    RULES,
    assert_derivatives,
    assert_same_bits,
    list_seeds,
    pick,
    random_batch,
    random_case,
)
from numpy.random import default_rng
from refusals import refusal
from space_cases import leave_plane, random_spatial_case

from needlefit import Bevel, Controls, ModelOptions, Step, Tissue, compute_positions, simulate_steps
from needlefit.errors import ModelError
from needlefit.mechanics.batch import (
    DERIVATIVE_KINDS,
    Batch,
    compute_batch_positions,
    differentiate_batch_positions,
    linearize_batches,
    linearize_steps,
    simulate_batches,
)
from needlefit.mechanics.packing import INPUTS_ALONG_Z
from needlefit.mechanics.plan import make_lattice

PHANTOM = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])
SHARP = 1e-9  # mm; Newton's tolerance where a derivative is held to 1e-7 of itself


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("draw", [random_case, random_spatial_case])
@pytest.mark.parametrize("seed", list_seeds(9, 2))
def test_jacobian_equals_complex_steps(seed, draw, kind):
    """Guides before and in the tissue, a tracked tip, retraction, re-insertion, changes of base and bevel.

    Also by what moves a planar needle out of its plane.
    """
    rng = default_rng(seed)
    needle, tissue, steps, rules, lattice = draw(rng, kind, 3, 9.0)
    # in soft tissue rounding alone moves the derivative by more than 1e-7 of itself on a fine mesh
    rules = replace(rules, tolerance=SHARP, element=max(rules.element, 0.5))
    tissue = replace(tissue, mu=np.maximum(tissue.mu, 0.03 if kind != "path_angle" else 0.1))
    lattice = lattice or make_lattice(steps, rules)
    changes = np.array([lattice.depth(m) for m in range(60)])
    changes = (1 - rules.switch) * changes[:-1] + rules.switch * changes[1:]
    if tissue.layers > 1 and np.min(np.abs(tissue.boundaries[:, None] - changes)) < 1e-3:
        pytest.skip("a boundary near a change of constraint has two derivatives")
    kinds = (*DERIVATIVE_KINDS, *INPUTS_ALONG_Z)
    shape, found = linearize_steps(needle, tissue, steps, rules, lattice, wrt=kinds)
    assert shape.converged and {"roll", "base_z"} <= set(found.names)
    # where the cut is linear, complex places of its corners are known less well
    half = slice(seed % 2, None, 2)
    assert_derivatives(found, needle, tissue, steps, rules, lattice, 1e-6 if rules.path_angle else 1e-7, half)


# ---- many sets at once


@pytest.mark.parametrize("is_spatial", [False, True])
@pytest.mark.parametrize("seed", list_seeds(30, 6))
def test_every_set_is_what_a_single_one_gives(seed, is_spatial):
    rng = default_rng(seed)
    friction, kind = float(rng.integers(0, 2)), RULES[seed % 3]
    batch = random_batch(rng, int(rng.integers(1, 12)), bool(seed % 4), friction, kind)
    if is_spatial:
        batch = replace(batch, steps=leave_plane(rng, batch.steps))
    wrt = (*DERIVATIVE_KINDS, *INPUTS_ALONG_Z) if is_spatial else DERIVATIVE_KINDS
    ((shapes, jacobians),) = linearize_batches([batch], wrt)
    s = np.linspace(shapes.x[0, 0] + 1.0, shapes.x[0, -1], 9)
    s = s[s >= shapes.x[:, 0].max()]
    points = compute_batch_positions(shapes, s)
    for i in range(len(batch)):
        shape, jacobian = linearize_steps(*pick(batch, i), wrt=wrt)
        assert_same_bits(shapes[i], shape)
        assert_same_bits(jacobians[i], jacobian)
        if shape.converged:
            np.testing.assert_array_equal(points[i], compute_positions(shape, s))


def test_sets_with_different_boundaries_are_not_differentiated():
    tissue, steps = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[5.3]), (Step(11.4, Bevel(0.1)),)

    def linearize_at(*boundaries):
        batch = Batch(NEEDLE, tissue, steps, boundaries=np.array(boundaries)[:, None])
        (found,) = linearize_batches([batch], ("mu",))
        return found

    shapes, jacobians = linearize_at(5.3, 5.3, np.nan)
    for found, expected in zip((shapes, jacobians), linearize_at(5.3), strict=True):
        assert_same_bits(found[1], expected[0])
    assert shapes.converged.tolist() == [True, True, False]
    refusal(ModelError, "boundaries", linearize_at, 5.3, 6.3)


FIRST, MOVED = Controls(base_y=0.2), Controls(base_y=1.2, base_slope=0.01)
PAST = (Step(20.3, Bevel(0.1), FIRST), Step(31.7, Bevel(0.1), MOVED))


def test_a_gain_scales_the_moves_of_the_base_since_contact():
    gains = np.array([0.75, 1.0])
    (shapes,) = simulate_batches([Batch(NEEDLE, PHANTOM, PAST, gain=gains)], 1)
    for gain, shape in zip(gains, shapes, strict=True):
        moved = Controls(base_y=0.2 + gain, base_slope=gain * 0.01)
        same = simulate_steps(NEEDLE, PHANTOM, (PAST[0], replace(PAST[1], controls=moved)))
        assert shape.tip_lateral == pytest.approx(same.tip_lateral, abs=1e-9)


@pytest.mark.parametrize("rules", [ModelOptions(), ModelOptions(advance="path_angle")])
def test_derivatives_from_now_on_are_differences_of_the_last_step_alone(rules):
    rules = replace(rules, first_cell=0.4, tolerance=1e-10)  # 31.7 mm lie within a cell
    bevel, depth = (Bevel(cut_angle=0.05) if rules.path_angle else Bevel(0.1)), np.array([45.0])
    past = tuple(replace(step, bevel=bevel) for step in PAST)

    def batch(base_y=0.0, base_slope=0.0, roll=0.0):
        base = {"base_y": 1.2 + base_y, "base_slope": 0.01 + base_slope}
        turned = replace(bevel, roll_deg=np.degrees(roll))
        last = Step(45.0, turned, replace(MOVED, **base))
        return Batch(
            NEEDLE, PHANTOM, (*past, last), rules, mu=np.array([[0.2, 33, 0.2, 33], [0.4, 20, 0.3, 20]])
        )

    def tips(**moved):
        return compute_batch_positions(simulate_batches([batch(**moved)], 1)[0], depth)[:, 0]

    names = ("base_y", "base_slope", "roll")
    ((shapes, jacobians),) = linearize_batches([batch()], names, 1, past=2)
    exact = differentiate_batch_positions(shapes, jacobians, depth)[:, 0]
    differences = [(tips(**{name: 1e-4}) - tips(**{name: -1e-4})) / 2e-4 for name in names]
    assert exact == pytest.approx(np.stack(differences, axis=-1), rel=1e-4, abs=1e-7)
