"""A fold's insertions as they are planned: their conditions, and shapes that are simulated, not measured."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from needlefit.datasets.insertion import Insertion, Noise
from needlefit.inference.predict import predict
from needlefit.inference.problem import Problem
from needlefit.mechanics.shape import NeedleShape, inserted_points
from needlefit.validation.folds import Fold
from needlefit.validation.job import Job
from needlefit.validation.planned import Floats, planned_layers


def planned(job: Job, fold: Fold, values: Mapping[str, float], noise: Noise | None = None) -> Problem | None:
    """Return the fit's problem with every measured shape replaced by the one that `values` (Pa, mm) give.

    Layers are those that the simulated needle meets, where the dataset has their surfaces; depths, sides,
    poses, noise and the number of points stay; `noise` is for a dataset that states none. None where a needle
    has no solution, or leaves the medium.
    """
    made = [_planned(job, insertion, values) for insertion in fold.tune]
    known = tuple(insertion for insertion in made if insertion is not None)
    return replace(job.problem(fold), insertions=known, noise=noise) if len(known) == len(made) else None


def looked_at(job: Job, fitted: Mapping[str, float] | None = None) -> tuple[dict[str, float], str]:
    """Return the values (Pa, mm) at which a design is looked at, within the bounds, and what they are.

    They are those fitted, or those of the paper's hand-tuned set, or the middle of the bounds.
    """
    parameters = job.parameters
    middle = parameters.values(0.5 * (parameters.lower + parameters.upper))
    if fitted is not None:
        asked, words = dict(fitted), "the fitted values"
    elif job.hand_tuned is not None:
        asked, words = dict(job.hand_tuned), f"the paper's hand-tuned set {job.record.hand_tuned}"
    else:
        asked, words = middle, "the middle of the bounds"
    theta = parameters.theta({**middle, **asked})
    return parameters.values(np.clip(theta, parameters.lower, parameters.upper)), words


def _planned(job: Job, insertion: Insertion, values: Mapping[str, float]) -> Insertion | None:
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
    planar = inserted_points(needle, len(insertion.planar))
    flat = np.zeros(len(planar))
    return replace(
        insertion,
        boundaries=layers[0],
        sequence=layers[1],
        planar=planar,
        centerline=insertion.frame.to_world(np.column_stack((planar, flat))),
        out_of_plane=flat,
    )
