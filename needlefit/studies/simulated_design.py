"""The design of a fit, simulated: its insertions as stated parameters would have made them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from needlefit.datasets.insertion import Insertion
from needlefit.inference.forward_model import predict, with_planned_layers
from needlefit.inference.likelihood.observations import TrueNeedle, measure
from needlefit.inference.problem import Problem
from needlefit.studies.job import Job


def simulate_design(problem: Problem, values: Mapping[str, float]) -> Problem | None:
    """Return the problem with every measured shape replaced by the one that `values` (Pa, mm) give.

    Layers are those that the simulated needle meets, where the dataset has their surfaces; depths, sides,
    poses, noise and the number of points stay. None where a needle has no solution, or leaves the medium.
    """
    made = list[Insertion]()
    for insertion in problem.insertions:
        met = with_planned_layers(insertion, values, problem.medium)
        if met is None:
            return None
        needle = TrueNeedle(met, predict(values, problem.medium, met))
        measured = measure(problem.dataset, replace(insertion, sections=None), needle)
        if measured is None:
            return None
        made.append(replace(measured, boundaries=met.boundaries, sequence=met.sequence))
    return replace(problem, insertions=tuple(made))


def choose_reference_values(job: Job) -> tuple[dict[str, float], str]:
    """Return the values (Pa, mm) at which a design is evaluated, within the bounds, and their origin.

    They are those of the paper's hand-tuned set, or the middle of the bounds.
    """
    parameters = job.parameters
    middle = parameters.values(parameters.expected)
    if job.hand_tuned is not None:
        asked, words = dict(job.hand_tuned), f"the paper's parameters, set {job.record.paper_parameters}"
    else:
        asked, words = middle, "the middle of the bounds"
    theta = parameters.theta({**middle, **asked})
    return parameters.values(np.clip(theta, parameters.lower, parameters.upper)), words
