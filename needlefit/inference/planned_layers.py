"""Predict the layers that a planned insertion meets.

The measured crossings of a held-out insertion already contain its outcome. A prediction starts from
the straight planned path instead, and repeats the simulation with the crossings of the predicted, bent needle
until they converge.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import find_layers
from needlefit.inference.forward_model import predict
from needlefit.mechanics.shape import NeedleShape, sample_inserted_points
from needlefit.schemas.medium import MediumRecord

Layers = tuple[Floats, tuple[int, ...]]

CROSSING_TOLERANCE_MM = 1e-3  #: crossings that move by less, mm, stand still
MAX_ROUNDS = 30  #: rounds in which they must; past the first ten each moves them only half way
MAX_DRAWN_LAYERS = 32  #: errors drawn for an insertion, so that what a draw is does not depend on its layers


def with_planned_layers(
    insertion: Insertion, values: Mapping[str, float], medium: MediumRecord
) -> Insertion | None:
    """Return an insertion with the layers that `values` (Pa, mm) predict, not the measured ones.

    None where `planned_layers` finds none, or the needle leaves the medium; layers that are stated as depths
    stay as they are.
    """
    if not insertion.surfaces:
        return insertion
    layers = planned_layers(
        insertion,
        lambda boundaries, sequence: predict(values, medium, insertion, boundaries, sequence),
    )
    if layers is None or max(layers[1]) > medium.layers:
        return None
    return replace(insertion, boundaries=layers[0], sequence=layers[1])


def planned_layers(
    insertion: Insertion, predict: Callable[[Floats, tuple[int, ...]], NeedleShape]
) -> Layers | None:
    """Return boundaries (n - 1,) along C's x and the n layers that the simulated needle meets.

    None where a solve fails, or the crossings do not come to rest. `predict` takes boundaries and sequence to
    the simulated shape. Of the insertion its depth, surfaces and frame alone are used. The frame is the entry
    pose and the bending plane, which comes from the bevel where the dataset states it, else from the shape.
    """
    # the straight planned path; it uses nothing of the measured shape
    path = np.outer(np.linspace(0.0, insertion.depth, 101), (1.0, 0.0, 0.0))
    layers = find_path_layers(path, insertion)
    for round_ in range(MAX_ROUNDS):
        shape = predict(*layers)
        if not shape.converged:
            return None
        after = find_path_layers(sample_inserted_points(shape), insertion)
        same = after[1] == layers[1]
        if same and np.all(np.abs(after[0] - layers[0]) < CROSSING_TOLERANCE_MM):
            return after
        # crossings can alternate between two states; half steps damp that
        layers = (0.5 * (after[0] + layers[0]), after[1]) if same and round_ >= 10 else after
    return None


def find_path_layers(curve: Floats, insertion: Insertion) -> Layers:
    """Return the layers that a curve (K, 3) in C meets."""
    return find_layers(insertion.frame.to_world(curve), insertion.frame, insertion.surfaces)
