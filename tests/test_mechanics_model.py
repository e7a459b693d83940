"""What the model must do whatever the numbers: symmetry, continuity, refinement, magnitudes."""

from dataclasses import replace

import numpy as np
import pytest
from mechanics_cases import NEEDLE, RULES, random_case
from needle_loads import compute_loads
from numpy.testing import assert_allclose
from pytest import approx
from space_cases import random_spatial_case

from needlefit import Batch, Bevel, Controls, Guide, ModelOptions, Needle, Step, Tissue, simulate_batches
from needlefit.mechanics.simulate import compute_lateral_load, simulate, simulate_steps

DEPTH, BEVEL = 55.0, Bevel(0.085)
PHANTOM = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])


@pytest.mark.parametrize("draw", [random_case, random_spatial_case])
@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("seed", range(4))
def test_tissue_base_guides_and_tracked_tip_balance(seed, kind, draw):
    """All forces, and all moments about the entry, relative to their sizes, along y and z."""
    needle, tissue, steps, rules, lattice = draw(np.random.default_rng(seed), kind)
    rules = replace(rules, tolerance=1e-11)
    shape = simulate_steps(needle, tissue, steps, rules, lattice)
    loads = compute_loads(shape, tissue, needle, steps[-1].controls, rules)
    along = compute_lateral_load(shape, tissue, loads.s, rules)
    assert_allclose(along, [loads.load, loads.load_z], rtol=1e-9, atol=1e-12)
    every = (loads.tissue, loads.base, *loads.guides, loads.tip)
    for force, moment in (("force", "moment"), ("force_z", "moment_z")):
        forces = [getattr(one, force) for one in every]
        moments = [getattr(one, moment) + one.x * getattr(one, force) for one in every]
        for parts in (forces, moments):
            assert abs(sum(parts)) <= 1e-5 * np.sum(np.abs(parts))
            assert (np.sum(np.abs(parts)) > 0) == (force == "force" or shape.leaves_plane)


# ---- numbers of the kernel that no comparison of shapes determines


def test_too_few_iterations_are_reported():
    rules = ModelOptions(tolerance=1e-14, max_iterations=1)
    assert simulate(NEEDLE, PHANTOM, BEVEL, 10.0, rules=rules).status == "not converged"


@pytest.mark.parametrize(("tolerance", "most"), [(1e-7, 1.3), (1e-9, 1.65)])
def test_a_step_takes_little_more_than_one_pass(tolerance, most):
    """A guess that is worse, or tangents that are kept wrongly, cost passes and leave the shape as it is."""
    rules, steps = ModelOptions(tolerance=tolerance), (Step(DEPTH, BEVEL),)
    (shapes,) = simulate_batches([Batch(NEEDLE, PHANTOM, steps, rules, offset=np.linspace(0.06, 0.11, 16))])
    for one in (simulate_steps(NEEDLE, PHANTOM, steps, rules), shapes):
        assert np.all(one.converged) and 1.0 <= np.mean(one.iterations) / DEPTH <= most


# ---- friction: a shaft that slides askew is held back less, by the factor 1 - gamma sin^2 of its angle


# ---- what acts on the needle: closed forms

EI = 1.0e4
BEAM = Needle(150.0, EI)
SOFT_LAYERS = Tissue(
    mu=[0.02, 0.4, 0.1], alpha=[3.0, -4.0, 8.0], boundaries=[9.3, 21.0], thickness=[40.0, 8.0, 15.0]
)


def test_a_guide_before_the_tissue_loads_the_needle_as_a_propped_cantilever():
    # A cantilever of length a is moved by y under F = 3 EI y / a^3; its clamp bears -F and -F a.
    controls, a, y = Controls(guides=(Guide(-30.0, 0.4, None),)), 120.0, 0.4
    shape = simulate_steps(BEAM, SOFT_LAYERS, (Step(0.0, Bevel(0.1), controls),))
    found = compute_loads(shape, SOFT_LAYERS, BEAM, controls)
    force = 3 * EI * y / a**3
    assert found.guides[0].force == approx(force)
    assert (found.base.x, found.base.force) == (-150.0, approx(-force))
    assert (found.base.moment, found.guides[0].moment) == (approx(-force * a), 0.0)
    assert len(found.s) == 0 and (found.tip_force, found.tissue.force) == (0.0, 0.0)
