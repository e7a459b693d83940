"""Numbers of the kernel that no comparison of shapes determines."""

import numpy as np
import pytest

from needlefit.mechanics.batch import Batch
from needlefit.mechanics.control import Bevel, ModelOptions, Step
from needlefit.mechanics.lanes import simulate_batches
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.simulate import simulate
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
