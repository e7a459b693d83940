"""A job under a variation, and its fit tuned again."""

from dataclasses import replace

import numpy as np

from needlefit.inference.goal import goal_of
from needlefit.inference.optimize.search import search
from needlefit.inference.starts import Fit, Place, Start
from needlefit.mechanics.needle import Needle
from needlefit.project.records.sensitivity import VariationRecord
from needlefit.validation.inquiries.tables.cells import searched, with_insertions, with_starts
from needlefit.validation.job import Job, Settings

_OF_MEDIUM = (
    *("constraint_switch", "tangent_part", "constraint_spacing_mm"),
    *("first_cell_mm", "thickness_mm"),
)


def varied(job: Job, variation: VariationRecord) -> Job:
    """Return the job under a variation."""
    changes = {key: getattr(variation, key) for key in _OF_MEDIUM}
    medium = job.medium.model_copy(update={key: new for key, new in changes.items() if new is not None})
    needle = job.dataset.needle
    rigidity = needle.flexural_rigidity * _stiffer(job, variation)
    dataset = replace(job.dataset, needle=Needle(needle.length, rigidity))
    shift = variation.boundary_shift_sd or 0.0
    moved = with_insertions(
        job, lambda one: replace(one, boundaries=one.boundaries + shift * one.boundary_sd)
    )
    return replace(moved, medium=medium, dataset=dataset)


def _stiffer(job: Job, variation: VariationRecord) -> float:
    """Return the factor of the needle's rigidity; a hollow one's is of a tube as wide as the dataset's."""
    factor = variation.rigidity_factor or 1.0
    inner, outer = variation.inner_diameter_mm, job.dataset.outer_diameter
    if inner is None or outer is None:
        return factor
    return factor * (1 - (inner / outer) ** 4)


def tuned_again(job: Job, before: Fit, starts: int, settings: Settings) -> Fit:
    """Return the best fit from a few random starts and from where the fit before had ended."""
    problem = job.problem(job.folds[0])
    found = searched(with_starts(job, starts), "fitted", settings)
    goal = goal_of(problem, job.recipe.minimize)
    near = search(goal, job.recipe, Place(starts, before.theta), settings.stop)
    if not near.objective < found.objective:
        return found
    return _from(near, found, problem.values(np.array(near.theta)))


def _from(best: Start, fit: Fit, values: dict[str, float]) -> Fit:
    """Return a fit whose best point is that of one more start."""
    return replace(fit, theta=best.theta, values=values, objective=best.objective, starts=(*fit.starts, best))
