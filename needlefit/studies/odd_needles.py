"""Needles that the others do not predict: found before a fit by a quick one, or by the fit itself; drawn."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from needlefit.datasets.folds import Fold
from needlefit.inference.doubts import Doubts, find_doubts
from needlefit.inference.problem import Problem
from needlefit.reporting.figures import Drawing
from needlefit.reporting.figures.columns import HEIGHT_COLUMNS, INSERTION_KEYS
from needlefit.schemas.run_metadata import DoubtMetadata
from needlefit.studies.job import Job


def find_odd_needles(job: Job, mode: Sequence[float] | None = None) -> Doubts:
    """Return the needles that any fold fits to, and the others of these do not predict.

    Those with values of another, or with constant ones, are left out. `mode` (P,): the most probable
    parameters of a fit; None: of a quick one.
    """
    named = {
        name
        for warning in job.dataset.warnings
        if warning.kind in ("copy", "axis_unit")
        for name in warning.insertions
    }
    problem = join_folds(job)
    others = tuple(insertion for insertion in problem.insertions if insertion.id not in named)
    sound = replace(problem, insertions=others or problem.insertions)
    return find_doubts(sound, None if mode is None else np.array(mode))


def join_folds(job: Job) -> Problem:
    """Return the problem of all insertions that any fold fits to."""
    fitted = {insertion.id: insertion for fold in job.folds for insertion in fold.tune}
    return job.problem(Fold("all", tuple(fitted.values()), ()))


def draw_odd_needles(odd: Sequence[DoubtMetadata]) -> Drawing:
    """Return each of the needles beside what the others predict."""
    heads = {("all", needle.insertion): f"{needle.sds:.2g} SD" for needle in odd}
    columns = [*INSERTION_KEYS, "curve", "x_mm", *HEIGHT_COLUMNS]
    rows = [
        {"fold": "all", "insertion": needle.insertion, "curve": curve, "x_mm": x, "y_mm": y}
        for needle in odd
        for x, *heights in needle.points
        for curve, y in zip(("measured", "fitted"), heights, strict=True)
    ]
    return Drawing(
        "insertions",
        pd.DataFrame(rows, columns=columns),
        {"heads": heads, "names": {"fitted": "predicted from the others"}},
    )
