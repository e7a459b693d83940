"""What the insertions made so far tell, as weighted draws of the parameters and of what follows from them."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.inference.predict import predict_each
from needlefit.inference.problem import Problem
from needlefit.inference.weighing.about_fit import of_fit
from needlefit.inference.weighing.importance import Effort
from needlefit.mechanics.batch import positions_each
from needlefit.mechanics.lanes import follow_batches
from needlefit.project.streams import stream
from needlefit.validation.inquiries.learned import Learned, learn
from needlefit.validation.job import Job, Settings
from needlefit.validation.score import Row

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

MANY = Effort(draws=500, enough=1000.0)
"""More draws than a prediction needs: what data tell is seen by how few of them are left."""

LIGHT = 1e-3
"""The lightest draws, of this weight together, are left out."""


@dataclass(frozen=True)
class Knowledge:
    """A posterior as weighted draws.

    Attributes
    ----------
    problem : Problem
        Of the insertions made so far.
    learned : Learned
    thetas : (B, P) array
    weights : (B,) array
        They sum to 1.
    """

    problem: Problem
    learned: Learned
    thetas: Floats
    weights: Floats

    @property
    def sets(self) -> list[dict[str, float]]:
        """The values (Pa, mm) of every draw."""
        return [self.problem.values(theta) for theta in self.thetas]

    @property
    def middle(self) -> dict[str, float]:
        """The values (Pa, mm) at the mean of theta."""
        return self.problem.values(self.weights @ self.thetas)

    @property
    def covariance(self) -> Floats:
        """Of theta: (P, P)."""
        away = self.thetas - self.weights @ self.thetas
        found: Floats = (away * self.weights[:, None]).T @ away
        return found

    def only(self, kept: Mask) -> Self:
        """Return the draws of a mask (B,)."""
        weights = self.weights[kept]
        return replace(self, thetas=self.thetas[kept], weights=weights / weights.sum())

    def drawn(self, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
        """Return which draws (`count`,) stand for the posterior, without weights."""
        return rng.choice(len(self.weights), size=count, p=self.weights)


def knowledge(job: Job, settings: Settings) -> Knowledge | None:
    """Return what the insertions that tune a job tell; None after a stop."""
    problem = job.problem(job.folds[0])
    learned = learn(job, problem, ("now",), settings)
    if settings.stop():
        return None
    if learned.sampled or not problem.names:
        thetas = learned.draws.thetas
        return Knowledge(problem, learned, thetas, np.full(len(thetas), 1 / len(thetas)))
    rng = stream(job.recipe.seed, job.name, "now", "more")
    found = of_fit(problem, learned.fit, rng, settings.jobs, MANY)
    weights = np.exp(found.log_weights)
    order = np.argsort(weights, kind="stable")
    heavy = np.sort(order[np.cumsum(weights[order]) > LIGHT])
    return Knowledge(problem, learned, found.thetas[heavy], weights[heavy] / weights[heavy].sum())


def tips(known: Knowledge, insertion: Insertion) -> Floats:
    """Return the deflection (B,) of an insertion's tip by every draw, mm; NaN where a solve fails."""
    batch = predict_each(known.sets, known.problem.medium, known.problem.dataset.needle, insertion)
    (shapes,) = follow_batches([batch], 1)
    found: Floats = positions_each(shapes, np.array([insertion.depth]))[:, 0, 1]
    return np.where(shapes.converged, found, np.nan)


def about(known: Knowledge) -> Row:
    """Return how a posterior was come by, and what its draws are worth."""
    learned = known.learned
    return {
        "insertions": len(known.problem.insertions),
        "pareto_k": learned.k,
        "sampled": learned.sampled,
        "draws": len(known.thetas),
        "independent": 1 / float(np.sum(known.weights**2)),
        "fault": "; ".join(learned.draws.faults),
    }
