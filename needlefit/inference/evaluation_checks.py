"""Explain failed evaluations, and find parameter sets outside the model's range of validity."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.inference.evaluation_recorder import EVALUATION_ERRORS
from needlefit.inference.forward_model import make_batch, predict
from needlefit.inference.parameters import Theta
from needlefit.inference.problem import Problem
from needlefit.mechanics.lanes import simulate_batches


@dataclass(frozen=True)
class EvaluationFailure:
    """Why one evaluation failed, and at which insertion.

    Attributes
    ----------
    insertion : str
        The first one without a solution; empty if all have one.
    reason : str
        The status of its shape; or the error that was raised, `ModelError: ...`; or "value not finite",
        if every simulation converged.
    """

    insertion: str
    reason: str


def explain_failure(problem: Problem, theta: Theta) -> EvaluationFailure:
    """Return why a theta cannot be evaluated: the first insertion that fails, and how."""
    values = problem.values(theta)
    for insertion in problem.insertions:
        try:
            shape = predict(values, problem.medium, problem.dataset.needle, insertion)
        except EVALUATION_ERRORS as error:
            return EvaluationFailure(insertion.id, _describe_error(error))
        if not shape.converged:
            return EvaluationFailure(insertion.id, shape.status)
    return EvaluationFailure("", "value not finite")


def _describe_error(error: Exception) -> str:
    """Return the error's kind and the first line of its text, which says what is wrong."""
    text = str(error).partition("\n")[0]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def find_outside_validity(
    problem: Problem, thetas: Sequence[Theta] | Floats, jobs: int = 1
) -> NDArray[np.bool_]:
    """Return a mask (B,): the `thetas` (B, P) that simulate any insertion outside the model's validity.

    A solve that fails is none of these: it is counted as failed.
    """
    found = np.zeros(len(thetas), dtype=bool)
    if not len(thetas):
        return found
    sets = [problem.values(theta) for theta in thetas]
    batches = [make_batch(sets, problem.medium, problem.dataset.needle, one) for one in problem.insertions]
    for shapes in simulate_batches(batches, jobs):
        found |= shapes.converged & ~shapes.validity.ok
    return found
