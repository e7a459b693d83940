"""Numbers of the kernel that no comparison of shapes determines."""

import numpy as np
import pytest

from needlefit.mechanics.batch import Batch
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate, simulate_steps
from needlefit.mechanics.tissue import Tissue

NEEDLE, DEPTH = Needle.from_tube(150.0, 1.27, 80e3), 55.0
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
        assert together[i].status == alone.status and together[i].iterations == alone.iterations
        for name in ("u", "slope", "constraints", "tip_track"):
            np.testing.assert_array_equal(getattr(together[i], name), getattr(alone, name), err_msg=name)
