"""A further insertion: the posterior in its specimen, its stated errors, and how deep it can go."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Bools, Floats
from needlefit.datasets.insertion import Insertion
from needlefit.errors import ConfigError
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import MAX_PARETO_K, Effort, sample_about_fit
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import describe_key
from needlefit.schemas.analyses import TunedAnalysisRecord
from needlefit.studies.held_out_predictions import (
    PosteriorFit,
    Specimens,
    choose_specimen,
    fit_posterior,
)
from needlefit.studies.job import Job, Settings, farthest_guide
from needlefit.studies.score import Row


class FurtherInsertionRecord(TunedAnalysisRecord):
    """The keys of a study of further insertions."""

    template_insertion: str
    """Insertion whose stated errors of pose, depths and points a further one would have."""
    specimen: Literal["new", "same"] | None = None
    """Whether it goes into a specimen that was not fitted ("new") or, as the template, one that was ("same");
    without it, into the template's."""


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


SPECIMEN_DRAWS = 2000  #: draws of the parameters in one of several specimens, or in a new one


@dataclass(frozen=True)
class WeightedPosterior:
    """A posterior as weighted draws."""

    problem: Problem  #: of the insertions made so far
    learned: PosteriorFit
    thetas: Floats  #: (B, P)
    weights: Floats  #: (B,), their sum is 1
    k: float  #: Pareto's k of the weights
    bevel_sd: float  #: by how many SDs the bevel of a further insertion deviates, as an SD
    new: Specimens | None = None  #: of which the draws are a further one; None if its specimen was tuned on

    @property
    def sets(self) -> list[dict[str, float]]:
        """The values (Pa, mm) of every draw."""
        return [self.problem.values(theta) for theta in self.thetas]

    @property
    def middle(self) -> dict[str, float]:
        """The values (Pa, mm) at the mean of theta."""
        return self.problem.values(self.weights @ self.thetas)

    def only(self, kept: Bools) -> Self:
        """Return only the draws of a mask (B,)."""
        weights = self.weights[kept]
        return replace(self, thetas=self.thetas[kept], weights=weights / weights.sum())

    def drawn(self, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
        """Return indices (`count`,) of draws that represent the posterior without weights."""
        return rng.choice(len(self.weights), size=count, p=self.weights)


def find_specimen(job: Job, like: Insertion, stated: Literal["new", "same"] | None) -> Insertion | None:
    """Return an insertion into the specimen of a further one; None if that was not tuned on.

    Raises ConfigError if it is to be one of several that were tuned on, but the template is in none of them.
    """
    known = Specimens(job, job.folds[0])
    into = stated or ("new" if known.differs(like) else "same")
    return choose_specimen(known, like.specimen if into == "same" and like.specimen in known.tuned else into)


def weigh_posterior(job: Job, into: Insertion | None, settings: Settings) -> WeightedPosterior | None:
    """Return the posterior of a further insertion as `find_specimen` returns it; None after a stop."""
    problem, (fold,) = job.problem(job.folds[0]), job.folds
    learned = fit_posterior(job, problem, ("now",), settings)
    if settings.stop():
        return None
    specimens = Specimens(job, fold, learned.draws, settings.jobs)
    rng = random_stream(job.recipe.seed, job.name, "now", "more")
    thetas, k = learned.draws.thetas, learned.k  # certified, or marked
    weights = np.full(len(thetas), 1 / len(thetas))
    if problem.names and not learned.sampled and not specimens.separate:
        found = sample_about_fit(problem, learned.fit, rng, settings.jobs, (PLANNING_EFFORT,))
        if not found.k > MAX_PARETO_K:
            thetas, weights, k = found.thetas, np.exp(found.log_weights), found.k
            order = np.argsort(weights, kind="stable")
            heavy = np.sort(order[np.cumsum(weights[order]) > DROPPED_WEIGHT])
            thetas, weights = thetas[heavy], weights[heavy] / weights[heavy].sum()
    known = WeightedPosterior(problem, learned, thetas, weights, k, specimens.bevel_sd_in(into))
    return move_to_specimen(known, specimens, into, rng)


def move_to_specimen(
    known: WeightedPosterior, specimens: Specimens, into: Insertion | None, rng: np.random.Generator
) -> WeightedPosterior:
    """Return the posterior of the parameters in the specimen of an insertion; of None in a new one."""
    if into is not None and not specimens.separate:
        return known
    draws = replace(known.learned.draws, thetas=known.thetas[known.drawn(SPECIMEN_DRAWS, rng)])
    some = replace(specimens, draws=draws)
    moved = some.draws_in(into)
    found = replace(known, learned=replace(known.learned, draws=moved))
    if not len(moved.thetas):  # a specimen's own are not certified
        return found
    found = replace(found, new=some if into is None else None)
    if not some.separate:
        return replace(found, thetas=moved.thetas, weights=np.full(SPECIMEN_DRAWS, 1 / SPECIMEN_DRAWS))
    # of a specimen's own draws some are chosen several times
    thetas, counts = np.unique(moved.thetas, axis=0, return_counts=True)
    return replace(found, thetas=thetas, weights=counts / SPECIMEN_DRAWS, k=moved.pareto_k)


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
