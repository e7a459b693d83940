"""Insertions whose centrelines are copies of one another: one measurement under two ids."""

from collections.abc import Iterator, Sequence

import numpy as np

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers_met import Placed
from needlefit.project.result_warnings import ResultWarning

SAME_MM = 1e-6
"""Largest distance of two points, per axis, that are one."""


def is_copy(one: Insertion, other: Insertion) -> bool:
    """Whether two insertions have the same centreline, point by point."""
    a, b = one.centerline, other.centerline
    if a.shape != b.shape or np.abs(a[-1] - b[-1]).max() > SAME_MM:  # tips differ in nearly every pair
        return False
    return bool(np.abs(a - b).max() <= SAME_MM)


def copy_warnings(placed: Sequence[Placed]) -> Iterator[ResultWarning]:
    """Yield a warning for each insertion that is a copy of one before it."""
    for n, later in enumerate(placed):
        first = next((one for one in placed[:n] if is_copy(one.insertion, later.insertion)), None)
        if first is not None:
            what = f"{later.insertion.id} has the same centreline as {first.insertion.id}, point by point"
            yield ResultWarning("copy", what, later.where, "remove one of the two, or restore its own file")
