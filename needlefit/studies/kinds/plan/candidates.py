"""Make candidate insertions with the layers each would meet, and the posterior from those made so far."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.layers import select_layers
from needlefit.errors import ConfigError
from needlefit.geometry.frames import Frame, make_entry_frame, normalize
from needlefit.inference.forward_model import make_batch, predict
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.importance import MAX_PARETO_K, Effort, sample_about_fit
from needlefit.mechanics.batch import compute_batch_positions, simulate_batches
from needlefit.mechanics.shape import NeedleShape, sample_inserted_points
from needlefit.project.random_streams import random_stream
from needlefit.project.toml_lines import describe_key as place_of
from needlefit.studies.job import Job, Settings, farthest_guide
from needlefit.studies.kinds.next_insertion.schema import CandidateEntryRecord, NextInsertionRecord
from needlefit.studies.planned_insertions import planned_layers
from needlefit.studies.posterior_fit import PosteriorFit, fit_posterior
from needlefit.studies.score import Row

CandidatePlace = tuple[CandidateEntryRecord, float, float]
"""Entry, angle (degrees) and depth (mm)."""

MEASURED_POINTS = 31
"""At which a candidate would be measured: neighbours err alike, so that more add next to nothing."""


def iterate_places(record: NextInsertionRecord) -> Iterator[CandidatePlace]:
    """Yield the entry, angle and depth of every candidate."""
    for entry in record.entries:
        for angle in entry.angles_deg:
            for depth in entry.depths_mm or record.depths_mm:
                yield entry, angle, depth


def find_template(job: Job, like: str) -> Insertion:
    """Return the insertion whose stated errors a new one gets.

    Raises
    ------
    ConfigError
        If there is no such insertion.
    """
    known = {insertion.id: insertion for insertion in job.dataset.insertions}
    if like not in known:
        raise ConfigError(
            f"insertion {like} is not in the dataset",
            where=place_of(job.name, "template_insertion"),
            key="template_insertion",
            expected=f"one of {', '.join(known)}",
        )
    return replace(known[like], side=1, sd=None)


def check_reach(job: Job, like: Insertion, depths: Mapping[str, float]) -> None:
    """Refuse depths (mm, by the study's key) that the needle cannot reach.

    Raises
    ------
    ConfigError
        Naming the first such key.
    """
    guide = farthest_guide(job.parameters, like)
    longest = job.dataset.needle.length - guide
    through = f", held by a guide {guide:g} mm before the tissue," if guide else ""
    for key, depth in depths.items():
        if depth >= longest:
            raise ConfigError(
                f"a needle of {job.dataset.needle.length:g} mm{through} cannot be inserted {depth:g} mm",
                where=place_of(job.name, key),
                key=key,
                expected=f"depths below {longest:g} mm",
                fix=f"correct `{key}`, or the needle's length in the dataset",
            )


def predict_candidate(
    job: Job, like: Insertion, place: CandidatePlace, values: Mapping[str, float]
) -> Insertion | None:
    """Return a candidate as `values` (Pa, mm) predict it; None if it has no solution or leaves the medium.

    The layers are those that the predicted needle meets, the same for all draws of the parameters: as it will
    be once they are measured.

    Raises
    ------
    ConfigError
        If nothing says which layers it meets.
    """
    entry, angle, depth = place
    planned = replace(like, id=entry.name, depth=depth, frame=frame_of(entry, angle))
    layers = _find_layers(job, planned, entry, values)
    if layers is None or max(layers[1]) > job.medium.layers:
        return None
    return with_predicted_shape(job, replace(planned, boundaries=layers[0], sequence=layers[1]), values)


def with_predicted_shape(job: Job, insertion: Insertion, values: Mapping[str, float]) -> Insertion | None:
    """Return an insertion with the shape that `values` predict as the measured one; None if there is none."""
    needle = predict(values, job.medium, job.dataset.needle, insertion)
    return (
        replace(insertion, planar=sample_inserted_points(needle, MEASURED_POINTS), sections=None)
        if needle.converged
        else None
    )


def frame_of(entry: CandidateEntryRecord, angle: float) -> Frame:
    """Return the frame C in the world at an entry, with x turned by `angle` (degrees) to the bevel side."""
    x = normalize(entry.direction)
    y = make_entry_frame(entry.position_mm, x, entry.bending_direction).rotation[:, 1]
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return make_entry_frame(entry.position_mm, cos * x + sin * y, cos * y - sin * x)


def _find_layers(
    job: Job, planned: Insertion, entry: CandidateEntryRecord, values: Mapping[str, float]
) -> tuple[Floats, tuple[int, ...]] | None:
    """Return boundaries (n - 1,) and the n layers met; None where the planned path does not come to rest."""
    if entry.layers is not None:
        before, met = select_layers(np.array(entry.boundaries_mm, dtype=np.float64), planned.depth)
        return before, entry.layers[: len(met)]
    if not planned.surfaces:
        raise ConfigError(
            f"medium {planned.medium} has no surfaces: the layers at entry `{entry.name}` are not known",
            where=place_of(job.name, "entries"),
            key="entries",
            fix="list the entry's `layers`, and their boundaries_mm",
        )

    def shape(boundaries: Floats, sequence: tuple[int, ...]) -> NeedleShape:
        return predict(values, job.medium, job.dataset.needle, planned, boundaries, sequence)

    return planned_layers(planned, shape)


Mask = NDArray[np.bool_]

PLANNING_EFFORT = Effort(draws=500, min_ess=1000.0)
"""More draws than a prediction needs: what data tell is seen by how few of them are left."""

DROPPED_WEIGHT = 1e-3
"""The lightest draws, of this weight together, are left out."""


@dataclass(frozen=True)
class WeightedPosterior:
    """A posterior as weighted draws.

    Attributes
    ----------
    problem : Problem
        Of the insertions made so far.
    learned : Learned
    thetas : (B, P) array
    weights : (B,) array
        They sum to 1.
    k : float
        Pareto's k of the weights.
    """

    problem: Problem
    learned: PosteriorFit
    thetas: Floats
    weights: Floats
    k: float

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
        found: Floats = (away * self.weights[:, None]).T @ away
        return found

    def only(self, kept: Mask) -> Self:
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


def predict_tips(known: WeightedPosterior, insertion: Insertion) -> Floats:
    """Return the tip deflection (B,) of an insertion for every draw, mm; NaN where a solve fails."""
    batch = make_batch(known.sets, known.problem.medium, known.problem.dataset.needle, insertion)
    (shapes,) = simulate_batches([batch], 1)
    found: Floats = compute_batch_positions(shapes, np.array([insertion.depth]))[:, 0, 1]
    return np.where(shapes.converged, found, np.nan)


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
