"""When ensembles learn what to propose, and from which of their steps.

Each learns from its own steps alone, and only after a few fixed ones. Between these it walks by fixed rules,
which have the density as their stationary one; what was walked before the last of them is burn-in. What an
ensemble knows follows from the steps that are kept, so that a run that goes on knows the same.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from needlefit.inference.sampling.ensembles import INDEPENDENT, shares
from needlefit.inference.sampling.independent import Picture, learned, unlearned
from needlefit.schemas.recipe import SampleRecord

Floats = NDArray[np.float64]

LESSONS = (50, 150, 500, 1200, 3000)
"""Steps after which ensembles learn, from the second half of them."""


def lessons(settings: SampleRecord) -> tuple[int, ...]:
    """Return the steps after which ensembles learn; none with less than as many more in the budget."""
    if INDEPENDENT not in shares(settings.moves):
        return ()
    return tuple(step for step in LESSONS if 2 * step <= settings.steps)


def last_lesson(settings: SampleRecord, done: int) -> int:
    """Return after how many of the `done` steps the ensembles have learned last; 0 if never."""
    return max((step for step in lessons(settings) if step <= done), default=0)


def block_length(settings: SampleRecord, done: int) -> int:
    """Return how many steps follow until the run is kept: a lesson or the budget ends them."""
    left = settings.steps - done
    return min(settings.check_interval, left, *(step - done for step in lessons(settings) if step > done))


def pictures(settings: SampleRecord, coordinates: Floats) -> Sequence[Picture]:
    """Return what each ensemble draws independent proposals from, after the steps (E, S, W, P)."""
    ensembles, done, _, dimensions = coordinates.shape
    last = last_lesson(settings, done)
    if not last:
        return [unlearned(dimensions)] * ensembles
    return [learned(seen.reshape(-1, dimensions)) for seen in coordinates[:, last // 2 : last]]
