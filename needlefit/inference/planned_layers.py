"""Predict the layers that a planned insertion meets.

The measured crossings of a held-out insertion already contain its outcome. A prediction starts from
the straight planned path instead, and repeats the simulation with the crossings of the predicted, bent needle
until they converge.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import find_layers
from needlefit.inference.forward_model import predict
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.schemas.medium import MediumRecord

Layers = tuple[Floats, tuple[int, ...]]

CROSSING_TOLERANCE_MM = 1e-3  #: crossings that move by less, mm, stand still
MAX_ROUNDS = 30  #: rounds in which they must
HALVED_ROUNDS = 10  #: rounds after which each moves them only half way
MAX_DRAWN_LAYERS = 32  #: errors drawn for an insertion, so that what a draw is does not depend on its layers


def with_planned_layers(
    insertion: Insertion, values: Mapping[str, float], medium: MediumRecord
) -> Insertion | None:
    """Return an insertion with the layers that `values` (Pa, mm) predict, not the measured ones.

    Of the insertion its depth, surfaces and frame are used. The frame is the entry pose and the bending
    plane, which comes from the bevel where the dataset states it, else from the shape. Layers that are stated
    as depths stay as they are.

    None where a solve fails, the crossings do not come to rest, or the needle leaves the medium.
    """
    if not insertion.surfaces:
        return insertion
    # the straight planned path; it uses nothing of the measured shape
    path = np.outer(np.linspace(0.0, insertion.depth, 101), (1.0, 0.0, 0.0))
    depths, sequence = find_path_layers(path, insertion)
    for round_ in range(MAX_ROUNDS):
        shape = predict(values, medium, replace(insertion, boundaries=depths, sequence=sequence))
        if not shape.converged:
            return None
        before = depths, sequence
        depths, sequence = find_path_layers(sample_inserted_points(shape), insertion)
        if sequence != before[1]:
            continue
        if np.all(np.abs(depths - before[0]) < CROSSING_TOLERANCE_MM):
            left = max(sequence) > medium.layers
            return None if left else replace(insertion, boundaries=depths, sequence=sequence)
        if round_ >= HALVED_ROUNDS:  # crossings can alternate between two states; half steps damp that
            depths = 0.5 * (depths + before[0])
    return None


def find_path_layers(curve: Floats, insertion: Insertion) -> Layers:
    """Return the layers that a curve (K, 3) in C meets."""
    return find_layers(insertion.frame.to_world(curve), insertion.frame, insertion.surfaces)
