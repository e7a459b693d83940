"""Try the other rule of advance beside a fit of needles that were turned, for which the rules differ most."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needlefit.datasets.planes import turns_out_of_plane
from needlefit.inference.fit import Callbacks
from needlefit.inference.optimize import minimize
from needlefit.inference.parameters import Parameters, with_hyperparameters
from needlefit.project.random_streams import random_stream
from needlefit.schemas.medium import change_advance
from needlefit.schemas.run_metadata import AdvanceMetadata
from needlefit.studies.job import Job, Settings
from needlefit.studies.score import Row, make_scorer, model_predictor


def find_better_advance(job: Job, errors: Sequence[Row], settings: Settings) -> AdvanceMetadata | None:
    """Return the other rule and its mean tip error beside the stated rule's, mm, where it fits better.

    It is tried where the fit of the first fold misses tips by more than the noise. `errors` are rows of that
    table.
    """
    fold, recipe = job.folds[0], job.recipe
    turned = any(turns_out_of_plane(one) for one in fold.tune)  # none of needles compared in their planes
    free = recipe.minimize == "posterior" and job.medium.bevel_parameter in job.parameters.free
    place = {"fold": fold.name, "role": "tune", "method": "fitted"}
    own = [row for row in errors if place.items() <= row.items()]
    if not (turned and free and own):
        return None
    missed, noise = (float(np.mean([row[name] for row in own])) for name in ("te_mm", "floor_te_mm"))
    if not noise < missed < math.inf:
        return None
    medium = change_advance(job.medium)
    parameters = with_hyperparameters(Parameters.from_record(medium), recipe.likelihood)
    problem = replace(job.problem(fold), medium=medium, parameters=parameters)
    rng = random_stream(recipe.seed, fold.name, "other advance", "starts")
    fit = minimize(problem, recipe, rng, Callbacks(stop=settings.stop, jobs=settings.jobs))
    if not math.isfinite(fit.objective):
        return None
    curves, scorer = model_predictor(fit.values, medium), make_scorer(job)
    error = np.mean([row["te_mm"] for one in fold.tune for row in scorer.score(place, one, curves).errors])
    if not error < missed:
        return None
    return AdvanceMetadata(advance=medium.advance, te_mm=float(error), stated_te_mm=missed)
