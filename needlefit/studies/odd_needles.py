"""Needles that the others do not predict: found before a fit by a quick one, or by the fit itself; drawn."""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from needlefit.datasets.folds import Fold
from needlefit.inference.doubts import Doubts, find_doubts, fit_quickly
from needlefit.reporting.figures import Drawing
from needlefit.reporting.figures import fit_forms as forms
from needlefit.reporting.table_files import Row
from needlefit.schemas.run_metadata import NeedleDoubtMetadata
from needlefit.studies.job import Job


def find_odd_needles(job: Job, mode: Sequence[float] | None = None) -> Doubts:
    """Return the needles that any fold fits to, and the others of these do not predict.

    `mode` (P,): the most probable parameters of a fit; without it a quick one is made.
    """
    fitted = {one.id: one for fold in job.folds for one in fold.tune}
    problem = job.problem(Fold("all", tuple(fitted.values()), ()))
    if mode is None and not (job.dataset.noise_is_stated and job.recipe.minimize == "posterior"):
        return Doubts()
    return find_doubts(problem, fit_quickly(problem) if mode is None else np.array(mode))


def draw_odd_needles(odd: Sequence[NeedleDoubtMetadata]) -> Drawing:
    """Return each of the needles beside what the others predict."""
    heads = {("all", one.insertion): f"{one.sds:.2g} SD" for one in odd}
    columns = [*forms.INSERTION_KEYS, "curve", "x_mm", *forms.HEIGHT_COLUMNS]
    rows = pd.DataFrame([row for one in odd for row in _list_points(one)], columns=columns)
    return Drawing(forms.insertions, rows, {"heads": heads, "names": {"fitted": "predicted from the others"}})


def _list_points(one: NeedleDoubtMetadata) -> Iterator[Row]:
    for x, measured, predicted in one.points:
        for curve, y in (("measured", measured), ("fitted", predicted)):
            yield {"fold": "all", "insertion": one.insertion, "curve": curve, "x_mm": x, "y_mm": y}
