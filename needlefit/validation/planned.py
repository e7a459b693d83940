"""The layers that a planned insertion would meet: its outcome is not known, so it is simulated.

The measured crossings of a held-out insertion already tell where its needle went. A prediction starts
from the straight planned path instead, and follows the simulated needle until its own crossings stand still.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import layers_met
from needlefit.mechanics.shape import NeedleShape, inserted_points

Floats = NDArray[np.float64]
Layers = tuple[Floats, tuple[int, ...]]

TOLERANCE = 1e-3
"""Crossings that move by less, mm, stand still."""

MOST = 30
"""Rounds in which they must; past the first ten each moves them only half way."""


def planned_layers(
    insertion: Insertion, predict: Callable[[Floats, tuple[int, ...]], NeedleShape]
) -> Layers | None:
    """Return boundaries (n - 1,) along C's x and the n layers met by the needle that `predict` simulates.

    None where a solve fails, or the crossings do not come to rest.

    Parameters
    ----------
    insertion : Insertion
        Its depth, its surfaces and its frame alone are used: the entry pose, and the bending plane, which
        comes from the bevel where the dataset states it and else from the measured shape.
    predict : callable
        Boundaries and sequence -> simulated shape.
    """
    path = np.column_stack((np.linspace(0.0, insertion.depth, 101), np.zeros(101)))
    layers = _met(path, insertion)
    for round_ in range(MOST):
        shape = predict(*layers)
        if not shape.converged:
            return None
        after = _met(inserted_points(shape), insertion)
        same = after[1] == layers[1]
        if same and np.all(np.abs(after[0] - layers[0]) < TOLERANCE):
            return after
        layers = (0.5 * (after[0] + layers[0]), after[1]) if same and round_ >= 10 else after
    return None


def _met(planar: Floats, insertion: Insertion) -> Layers:
    """Return the layers that a curve (K, 2) in C meets."""
    world = insertion.frame.to_world(np.column_stack((planar, np.zeros(len(planar)))))
    return layers_met(world, insertion.frame, insertion.surfaces)
