"""The layers that a planned insertion would meet: its outcome is not known, so it is simulated.

The measured crossings of a held-out insertion already tell where its needle went. A prediction starts
from the straight planned path instead, and follows the simulated needle until its own crossings stand still.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import layers_met
from needlefit.inference.predict import predict
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape, inserted_points
from needlefit.project.records.medium import MediumRecord

Floats = NDArray[np.float64]
Layers = tuple[Floats, tuple[int, ...]]

TOLERANCE = 1e-3
"""Crossings that move by less, mm, stand still."""

MOST = 30
"""Rounds in which they must; past the first ten each moves them only half way."""


def as_planned(
    insertion: Insertion, values: Mapping[str, float], medium: MediumRecord, needle: Needle
) -> Insertion | None:
    """Return an insertion with the layers that `values` (Pa, mm) foretell, not those it was seen to meet.

    None where `planned_layers` finds none; layers that are stated as depths stay as they are.
    """
    if not insertion.surfaces:
        return insertion
    found = planned_layers(
        insertion,
        lambda boundaries, sequence: predict(values, medium, needle, insertion, boundaries, sequence),
    )
    return None if found is None else replace(insertion, boundaries=found[0], sequence=found[1])


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
