"""The compiled kernel is the reference, over random and extreme cases."""

import numpy as np
import pytest
import reference_solver
from mechanics_cases import NEEDLE, RULES, assert_close, list_seeds, random_case

from needlefit import Batch, Bevel, ModelOptions, Step, Tissue, simulate_batches
from needlefit.mechanics.simulate import simulate, simulate_steps


@pytest.mark.parametrize("kind", RULES)
@pytest.mark.parametrize("seed", list_seeds(28, 10))
def test_kernel_equals_reference(seed, kind):
    """One step, or many: inputs and bevel change on the way in, and out, and in again, on any grid."""
    rng = np.random.default_rng(seed)
    case = random_case(rng, kind, 5, 11.0) if seed % 2 else random_case(rng, kind, 0, 22.0)
    assert_close(simulate_steps(*case), reference_solver.simulate_steps(*case))


def test_too_few_iterations_are_reported():
    rules = ModelOptions(tolerance=1e-14, max_iterations=1)
    assert simulate(NEEDLE, TISSUE, Bevel(0.1), 10.0, rules=rules).status == "not converged"


# ---- numbers of the kernel that no comparison of shapes determines

DEPTH = 55.0
TISSUE = Tissue(mu=[0.2, 33, 0.2, 33], alpha=[1, -1, 1, -1], boundaries=[20, 28, 45])


@pytest.mark.parametrize(("tolerance", "most"), [(1e-7, 1.3), (1e-9, 1.65)])
def test_a_step_takes_little_more_than_one_pass(tolerance, most):
    """A guess that is worse, or tangents that are kept wrongly, cost passes and leave the shape as it is."""
    rules = ModelOptions(tolerance=tolerance)
    alone = simulate(NEEDLE, TISSUE, Bevel(0.085), DEPTH, rules=rules)
    offsets = np.linspace(0.06, 0.11, 16)
    (together,) = simulate_batches([Batch(NEEDLE, TISSUE, (Step(DEPTH, Bevel()),), rules, offset=offsets)])
    assert alone.converged and together.converged.all()
    assert 1.0 <= alone.iterations / DEPTH <= most
    assert 1.0 <= together.iterations.mean() / DEPTH <= most
