"""A further insertion: the posterior given those made so far, its stated errors, and how deep it can go."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Bools, Floats
from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import MAX_PARETO_K, Effort, sample_about_fit
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import describe_key
from needlefit.studies.held_out_predictions import PosteriorFit, fit_posterior
from needlefit.studies.job import Job, Settings, farthest_guide
from needlefit.studies.score import Row


def find_template(job: Job, like: str) -> Insertion:
    """Return the insertion whose stated errors a new one gets.

    Raises ConfigError if there is no such insertion.
    """
    known = {insertion.id: insertion for insertion in job.dataset.insertions}
    if like not in known:
        raise ConfigError(
            f"insertion {like} is not in the dataset",
            where=describe_key(job.name, "template_insertion"),
            key="template_insertion",
            expected=f"one of {', '.join(known)}",
        )
    return replace(known[like], side=1, sd=None)


def check_reach(job: Job, like: Insertion, depths: Mapping[str, float]) -> None:
    """Refuse depths (mm, by the study's key) that the needle cannot reach.

    Raises ConfigError naming the first such key.
    """
    guide = farthest_guide(job.parameters, like)
    longest = job.dataset.needle.length - guide
    through = f", held by a guide {guide:g} mm before the tissue," if guide else ""
    for key, depth in depths.items():
        if depth >= longest:
            raise ConfigError(
                f"a needle of {job.dataset.needle.length:g} mm{through} cannot be inserted {depth:g} mm",
                where=describe_key(job.name, key),
                key=key,
                expected=f"depths below {longest:g} mm",
                fix=f"correct `{key}`, or the needle's length in the dataset",
            )


PLANNING_EFFORT = Effort(draws=500, min_ess=1000.0)
"""More draws than a prediction needs: what data tell is seen by how few of them are left."""

DROPPED_WEIGHT = 1e-3  #: the lightest draws, of this weight together, are left out


@dataclass(frozen=True)
class WeightedPosterior:
    """A posterior as weighted draws."""

    problem: Problem  #: of the insertions made so far
    learned: PosteriorFit
    thetas: Floats  #: (B, P)
    weights: Floats  #: (B,), their sum is 1
    k: float  #: Pareto's k of the weights

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
        """Covariance of theta: (P, P)."""
        away = self.thetas - self.weights @ self.thetas
        return (away * self.weights[:, None]).T @ away

    def only(self, kept: Bools) -> Self:
        """Return only the draws of a mask (B,)."""
        weights = self.weights[kept]
        return replace(self, thetas=self.thetas[kept], weights=weights / weights.sum())

    def drawn(self, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
        """Return indices (`count`,) of draws that represent the posterior without weights."""
        return rng.choice(len(self.weights), size=count, p=self.weights)


def weigh_posterior(job: Job, settings: Settings) -> WeightedPosterior | None:
    """Return the posterior given the insertions that a job is tuned on; None after a stop."""
    problem = job.problem(job.folds[0])
    learned = fit_posterior(job, problem, ("now",), settings)
    if settings.stop():
        return None
    rng = random_stream(job.recipe.seed, job.name, "now", "more")
    found = None
    if problem.names and not learned.sampled:
        found = sample_about_fit(problem, learned.fit, rng, settings.jobs, PLANNING_EFFORT)
    if found is None or found.k > MAX_PARETO_K:  # the fewer draws of the fit are certified, or marked
        thetas = learned.draws.thetas
        return WeightedPosterior(problem, learned, thetas, np.full(len(thetas), 1 / len(thetas)), learned.k)
    weights = np.exp(found.log_weights)
    order = np.argsort(weights, kind="stable")
    heavy = np.sort(order[np.cumsum(weights[order]) > DROPPED_WEIGHT])
    kept = weights[heavy] / weights[heavy].sum()
    return WeightedPosterior(problem, learned, found.thetas[heavy], kept, found.k)


def describe_posterior(known: WeightedPosterior) -> Row:
    """Return how a posterior was computed, and its effective sample size."""
    learned = known.learned
    return {
        "insertions": len(known.problem.insertions),
        "pareto_k": known.k,
        "sampled": learned.sampled,
        "draws": len(known.thetas),
        "ess": 1 / float(np.sum(known.weights**2)),
        "note": "; ".join(learned.draws.faults),
    }
