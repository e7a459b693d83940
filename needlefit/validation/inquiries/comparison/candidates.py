"""What a candidate learns from some insertions, and how probable it makes the points of another one."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.inference.baselines import curve_for
from needlefit.inference.curve_density import CurveDensity, log_likelihoods
from needlefit.inference.density import Density
from needlefit.inference.likelihood.depths import nodes
from needlefit.inference.likelihood.evidence import evidence
from needlefit.inference.parameters import Parameters, with_noise_scale
from needlefit.inference.prior import Prior
from needlefit.inference.sampling.laplace import laplace
from needlefit.inference.ties import NOISE_SCALE, dimension
from needlefit.inference.weighing.importance import Effort, importance, resampled
from needlefit.mechanics import laws
from needlefit.project.records.medium import MediumRecord, ParameterRecord
from needlefit.project.streams import stream
from needlefit.validation.folds import Fold
from needlefit.validation.inquiries.learned import DRAWS, learn
from needlefit.validation.job import Job, Settings
from needlefit.validation.planned import as_planned
from needlefit.validation.score import Rival, curve_rival, model_rival

Floats = NDArray[np.float64]

MOST = 1000.0
"""Largest noise factor: a candidate that misses by millimetres where points err by hundredths needs it."""


@dataclass(frozen=True)
class Candidate:
    """What one candidate knows after some insertions.

    Attributes
    ----------
    values : mapping
        Its parameters at its greatest density (Pa, mm; curves: mm^-(k + 1)), the noise factor among them.
    rival : Rival
        The curve of these.
    densities : callable
        Insertion -> the log densities (B,) of its points, one for every draw; -inf where a solve fails.
    k : float
        Pareto's, of the draws' weights.
    sampled : bool
        Whether they were sampled instead.
    """

    values: Mapping[str, float]
    rival: Rival
    densities: Callable[[Insertion], Floats]
    k: float
    sampled: bool


def candidate(name: str, job: Job, fold: Fold, settings: Settings) -> Candidate:
    """Return what the candidate of this name learns from the insertions that a fold tunes on."""
    return _by_law(job, fold, settings) if name in laws.names() else _by_curve(name, job, fold)


def job_of(name: str, job: Job) -> Job:
    """Return the job of one candidate: its law, if it is one, and a noise factor that is estimated."""
    medium = _with_law(job.medium, name) if name in laws.names() else job.medium
    likelihood = job.recipe.likelihood.model_copy(update={"noise_scale": "estimated"})
    return replace(
        job,
        name=f"{job.name} {name}",
        medium=medium,
        parameters=with_noise_scale(Parameters.from_record(medium), MOST),
        recipe=job.recipe.model_copy(update={"likelihood": likelihood}),
        hand_tuned=None,
    )


def _with_law(medium: MediumRecord, law: str) -> MediumRecord:
    """Return the medium of another law; only Ogden's uses alpha."""
    if law == "ogden":
        return medium.model_copy(update={"law": law})
    fixed = {
        name: ParameterRecord(fixed=1.0) if dimension(name) == "exponent" else parameter
        for name, parameter in medium.parameters.items()
    }
    return medium.model_copy(update={"law": law, "parameters": fixed})


def _by_law(job: Job, fold: Fold, settings: Settings) -> Candidate:
    known = learn(job, job.problem(fold), (fold.name,), settings)
    sets = [job.parameters.values(theta) for theta in known.draws.thetas]
    likelihood = replace(job.parameters, prior=Prior())

    def densities(insertion: Insertion) -> Floats:
        seen = evidence(job.dataset, insertion, how=job.recipe.likelihood)
        logs = []
        for values in sets:
            met = as_planned(insertion, values, job.medium, job.dataset.needle)
            if met is None:
                logs.append(-np.inf)
                continue
            at = replace(seen, nodes=nodes(met, seen.nodes.s[0], job.recipe.likelihood.depths))
            logs.append(Density(likelihood, job.medium, job.dataset.needle, (at,)).log(values))
        found: Floats = np.nan_to_num(np.array(logs), nan=-np.inf)
        return found

    rival = model_rival(known.fit.values, job.medium, job.dataset)
    return Candidate(known.fit.values, rival, densities, known.k, known.sampled)


def _by_curve(name: str, job: Job, fold: Fold) -> Candidate:
    density = CurveDensity(name, job.dataset, fold.tune, job.recipe.likelihood, MOST)
    rng = stream(job.recipe.seed, job.name, fold.name, "weighed")
    bounds = (density.lower, density.upper)
    found = importance(density, [laplace(density, density.peak, *bounds)], bounds, rng, Effort())
    thetas = found.thetas[resampled(found, DRAWS, rng)]
    best = density.curve(density.peak)
    coefficients = {f"c{k}": value for k, value in enumerate(best.coefficients)}

    def densities(insertion: Insertion) -> Floats:
        return log_likelihoods(density, density.of(insertion), thetas)

    values = {**coefficients, NOISE_SCALE: float(np.exp(density.peak[-1]))}
    rival = curve_rival(lambda insertion: curve_for(best, insertion))
    return Candidate(values, rival, densities, found.k, False)
