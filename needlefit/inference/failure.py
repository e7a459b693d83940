"""Why an evaluation failed: it is simulated again, so that a recorded failure is also a reproduced one."""

from dataclasses import dataclass

from needlefit.inference.ledger import FAILURES
from needlefit.inference.parameters import Theta
from needlefit.inference.predict import predict
from needlefit.inference.problem import Problem


@dataclass(frozen=True)
class Failure:
    """What ended an evaluation.

    Attributes
    ----------
    insertion : str
        The first one without a solution; empty if all have one.
    reason : str
        The status of its shape; or the error that was raised, `ModelError: ...`; or "value not finite",
        if no simulation is to blame.
    """

    insertion: str
    reason: str


def failure(problem: Problem, theta: Theta) -> Failure:
    """Return why a theta has no objective and no density, insertion by insertion as they are evaluated."""
    values = problem.values(theta)
    for insertion in problem.insertions:
        try:
            shape = predict(values, problem.medium, problem.dataset.needle, insertion)
        except FAILURES as error:
            return Failure(insertion.id, _named(error))
        if not shape.converged:
            return Failure(insertion.id, shape.status)
    return Failure("", "value not finite")


def _named(error: Exception) -> str:
    """Return the error's kind and the first line of its text, which says what is wrong."""
    text = str(error).partition("\n")[0]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
