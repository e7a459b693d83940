"""Variants of the decided rules: the constraint point that tissue takes, the advance, the first cell."""

from dataclasses import replace

import numpy as np
import pytest
from mechanics_cases import random_batch, random_needle, random_rules, random_steps, random_tissue

from needlefit.errors import ModelError
from needlefit.mechanics import reference
from needlefit.mechanics.batch import Batch, linearize_steps, simulate_batches
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.plan import Lattice
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.verification import complex_step
from needlefit.verification.cases import RandomCase

NEEDLE = Needle.from_tube(150.0, 1.27, 80e3)
TISSUE = Tissue(mu=[0.2, 33.0], alpha=[1.0, -1.0], boundaries=[9.3])
BEVEL = Bevel(0.1)


def random_variant(rng: np.random.Generator, rules: ModelOptions) -> ModelOptions:
    first = float(rng.uniform(0.05, 1.0)) * rules.spacing
    return replace(
        rules,
        switch=float(rng.choice([0.0, 1.0, rng.uniform()])),
        tangent=float(rng.choice([0.0, rng.uniform()])),
        first_cell=first if rng.random() < 0.5 else None,
    )


@pytest.mark.parametrize("seed", range(12))
def test_kernel_equals_reference_under_any_rules(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rules = random_variant(rng, random_rules(rng))
    needle, tissue = random_needle(rng, rules), random_tissue(rng, rules, rng.choice([0.0, 0.3]))
    case = (needle, tissue, random_steps(rng, 3, deepest=11.0), rules)
    fast, slow = simulate_steps(*case), reference.simulate_steps(*case)
    assert fast.converged
    for name in ("u", "slope", "constraints"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), atol=1e-7, err_msg=name)


@pytest.mark.parametrize("seed", range(12))
def test_lanes_equal_the_scalar_kernel_under_any_rules(seed: int) -> None:
    rng = np.random.default_rng(seed)
    batch = random_batch(rng, 6)
    batch = replace(batch, rules=random_variant(rng, batch.rules))
    (shapes,) = simulate_batches([batch])
    for i in range(len(batch)):
        alone = simulate_steps(*batch.pick(i))
        np.testing.assert_allclose(shapes[i].u, alone.u, atol=1e-7)
        np.testing.assert_allclose(shapes[i].constraints, alone.constraints, atol=1e-7)


@pytest.mark.parametrize(("switch", "tangent"), [(0.0, 1.0), (1.0, 1.0), (0.3, 0.6), (0.5, 0.0), (1.0, 0.0)])
def test_derivatives_equal_complex_steps_under_any_rules(switch: float, tangent: float) -> None:
    rules = ModelOptions(tolerance=1e-11, switch=switch, tangent=tangent)
    turned = Bevel(0.08, -1)
    case = RandomCase(
        NEEDLE, TISSUE, (Step(8.2, BEVEL), Step(12.6, turned), Step(11.1, turned), Step(14.6, BEVEL))
    )
    named = complex_step.parameters(case)
    names = ("mu1", "mu2", "alpha2", "offset", "rigidity", "base_y", "boundary1")
    kinds = ("mu", "shape", "offset", "rigidity", "base_y", "boundaries")
    exact, points = complex_step.derivatives(case, [named[name] for name in names], rules)
    _, found = linearize_steps(*(case.needle, case.tissue, case.steps, rules), wrt=kinds)
    columns = [found.names.index(name) for name in names]
    ours = np.stack((found.u, found.slope), axis=1).reshape(len(exact), -1)[:, columns]
    scale = np.abs(exact).max(axis=0)
    np.testing.assert_allclose(ours / scale, exact / scale, atol=1e-6)
    np.testing.assert_allclose(found.constraints[:, columns] / scale, points / scale, atol=1e-6)


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


def test_rules_outside_their_range_are_refused() -> None:
    for wrong in ({"switch": -0.1}, {"tangent": 1.1}):
        with pytest.raises(ModelError, match="from 0 to 1"):
            ModelOptions(**wrong)
