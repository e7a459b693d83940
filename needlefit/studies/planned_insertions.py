"""Simulate the insertions of a design as planned, at values of the parameters."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from needlefit.datasets.insertion import Insertion, Noise
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.inference.compared_points import read_points
from needlefit.inference.forward_model import predict
from needlefit.inference.planned_layers import with_planned_layers
from needlefit.inference.problem import Problem
from needlefit.mechanics.shape import sample_inserted_points
from needlefit.studies.folds import Fold
from needlefit.studies.job import Job


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
    needle = job.dataset.needle
    met = with_planned_layers(insertion, values, job.medium, needle)
    if met is None:
        return None
    shape = predict(values, job.medium, needle, met)
    if not shape.converged:
        return None
    planar = (
        read_points(insertion, shape, insertion.depths)
        if isinstance(insertion, TipTrack)
        else sample_inserted_points(shape, len(insertion.planar))
    )
    return replace(insertion.with_planar(planar), boundaries=met.boundaries, sequence=met.sequence)
