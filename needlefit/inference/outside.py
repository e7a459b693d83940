"""Which parameter sets give needles outside what the model assumes: counted, never penalised."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.parameters import Theta
from needlefit.inference.predict import predict_each
from needlefit.inference.problem import Problem
from needlefit.mechanics.lanes import simulate_batches

Floats = NDArray[np.float64]


def outside(problem: Problem, thetas: Sequence[Theta] | Floats, jobs: int = 1) -> NDArray[np.bool_]:
    """Return which of `thetas` (B, P) simulate an insertion of the problem outside its validity, (B,).

    A solve that fails is none of these: it is counted as failed.
    """
    found = np.zeros(len(thetas), dtype=bool)
    if not len(thetas):
        return found
    sets = [problem.values(theta) for theta in thetas]
    batches = [predict_each(sets, problem.medium, problem.dataset.needle, one) for one in problem.insertions]
    for shapes in simulate_batches(batches, jobs):
        found |= shapes.converged & ~shapes.validity.ok
    return found
