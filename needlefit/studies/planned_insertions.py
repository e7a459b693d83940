"""Predict insertions as planned: the layers that the simulated needle meets, and its shape.

The measured crossings of a held-out insertion already contain its outcome. A prediction starts from
the straight planned path instead, and repeats the simulation with the crossings of the predicted, bent needle
until they converge.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.layers import find_layers
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.inference.compared_points import read_points
from needlefit.inference.forward_model import predict
from needlefit.inference.problem import Problem
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import NeedleShape, sample_inserted_points
from needlefit.schemas.medium import MediumRecord
from needlefit.studies.folds import Fold
from needlefit.studies.job import Job

Layers = tuple[Floats, tuple[int, ...]]

CROSSING_TOLERANCE_MM = 1e-3  #: crossings that move by less, mm, stand still
MAX_ROUNDS = 30  #: rounds in which they must; past the first ten each moves them only half way


def with_planned_layers(
    insertion: Insertion, values: Mapping[str, float], medium: MediumRecord, needle: Needle
) -> Insertion | None:
    """Return an insertion with the layers that `values` (Pa, mm) predict, not the measured ones.

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
    """Return boundaries (n - 1,) along C's x and the n layers that the simulated needle meets.

    None where a solve fails, or the crossings do not come to rest.

    Parameters
    ----------
    insertion : Insertion
        Its depth, its surfaces and its frame alone are used: the entry pose, and the bending plane, which
        comes from the bevel where the dataset states it and else from the measured shape.
    predict : callable
        Boundaries and sequence -> simulated shape.
    """
    # the straight planned path; it uses nothing of the measured shape
    path = np.column_stack((np.linspace(0.0, insertion.depth, 101), np.zeros(101)))
    layers = _find_layers(path, insertion)
    for round_ in range(MAX_ROUNDS):
        shape = predict(*layers)
        if not shape.converged:
            return None
        after = _find_layers(sample_inserted_points(shape), insertion)
        same = after[1] == layers[1]
        if same and np.all(np.abs(after[0] - layers[0]) < CROSSING_TOLERANCE_MM):
            return after
        # crossings can alternate between two states; half steps damp that
        layers = (0.5 * (after[0] + layers[0]), after[1]) if same and round_ >= 10 else after
    return None


def _find_layers(planar: Floats, insertion: Insertion) -> Layers:
    """Return the layers that a curve (K, 2) in C meets."""
    world = insertion.frame.to_world(np.column_stack((planar, np.zeros(len(planar)))))
    return find_layers(world, insertion.frame, insertion.surfaces)


def simulate_design(
    job: Job, fold: Fold, values: Mapping[str, float], noise: Noise | None = None
) -> Problem | None:
    """Return the fit's problem with every measured shape replaced by the one that `values` (Pa, mm) give.

    Layers are those that the simulated needle meets, where the dataset has their surfaces; depths, sides,
    poses, noise and the number of points stay; `noise` is for a dataset that states none. None where a needle
    has no solution, or leaves the medium.
    """
    made = [_simulate_insertion(job, insertion, values) for insertion in fold.tune]
    known = tuple(insertion for insertion in made if insertion is not None)
    return replace(job.problem(fold), insertions=known, noise=noise) if len(known) == len(made) else None


def choose_reference_values(
    job: Job, fitted: Mapping[str, float] | None = None
) -> tuple[dict[str, float], str]:
    """Return the values (Pa, mm) at which a design is evaluated, within the bounds, and their origin.

    They are those fitted, or those of the paper's hand-tuned set, or the middle of the bounds.
    """
    parameters = job.parameters
    middle = parameters.values(parameters.expected)
    if fitted is not None:
        asked, words = dict(fitted), "the fitted values"
    elif job.hand_tuned is not None:
        asked, words = dict(job.hand_tuned), f"the paper's parameters, set {job.record.paper_parameters}"
    else:
        asked, words = middle, "the middle of the bounds"
    theta = parameters.theta({**middle, **asked})
    return parameters.values(np.clip(theta, parameters.lower, parameters.upper)), words


def _simulate_insertion(job: Job, insertion: Insertion, values: Mapping[str, float]) -> Insertion | None:
    """Return one insertion as it would go."""

    def shape(boundaries: Floats, sequence: tuple[int, ...]) -> NeedleShape:
        through = replace(insertion, boundaries=boundaries, sequence=sequence)
        return predict(values, job.medium, job.dataset.needle, through)

    layers = insertion.boundaries, insertion.sequence
    if insertion.surfaces:
        found = planned_layers(insertion, shape)
        if found is None or max(found[1]) > job.medium.layers:
            return None
        layers = found
    needle = shape(*layers)
    if not needle.converged:
        return None
    planar = (
        read_points(insertion, needle, insertion.depths)
        if isinstance(insertion, TipTrack)
        else sample_inserted_points(needle, len(insertion.planar))
    )
    return replace(insertion.with_planar(planar), boundaries=layers[0], sequence=layers[1])
