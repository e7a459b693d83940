"""Run all studies and fits on the twin of one seed, beside the true needle."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.read import read
from needlefit.inference.compared_points import Curve, make_curve
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.cross_validation.result_rows import make_predictors
from needlefit.studies.kinds.seeds.schema import SeedsRecord
from needlefit.studies.paper_cells import (
    ERROR_COLUMNS,
    LoadedFit,
    compute_floors,
    prepare_on_dataset,
    run_search,
    score_methods,
    with_starts,
)
from needlefit.studies.runner import FrameRows
from needlefit.studies.score import Predictor, Row, curve_predictor, list_score_columns
from needlefit.studies.simulated_data import find_true_value
from needlefit.synthetic.build import build_unscanned
from needlefit.synthetic.design import PlannedInsertion, list_planned_insertions
from needlefit.synthetic.insertion import SyntheticInsertion, simulate_insertion
from needlefit.synthetic.truth import bevel_offset, draw_needle

TRUTH = "truth"
"""The method that knows the needle as it really is."""


def list_frames() -> dict[str, tuple[str, ...]]:
    """Return the columns of the frames.

    Of `parameters`: those that are fitted; `truth` is the geometric mean over what a fit learns from.
    """
    return {
        "errors": ("seed", *ERROR_COLUMNS, *list_score_columns()),
        "parameters": ("seed", "study", "parameter", "value", "truth", "paper"),
    }


def run_on_twin(
    seed: int,
    record: SeedsRecord,
    fits: Mapping[str, LoadedFit],
    plan: Sequence[PlannedInsertion],
    settings: Settings,
) -> FrameRows:
    """Return the errors of all methods on one twin of the insertions `plan`, and the fitted parameters.

    It may run on a machine without the files of `fits`.
    """
    with TemporaryDirectory() as folder:
        dataset = read(build_unscanned(Path(folder), seed, plan))
    jobs = prepare_on_dataset(fits, settings, dataset)
    floors = compute_floors(jobs.values())
    truth = true_predictor(seed)
    errors: list[Row] = []
    parameters: list[Row] = []
    for job in (with_starts(job, record.starts) for job in jobs.values()):
        searches = [search for search in job.searches if search != "fitted_metric"]
        found = {search: run_search(job, search, settings) for search in searches}
        errors += score_methods(job, {**make_predictors(job, job.folds[0], found), TRUTH: truth}, floors)
        parameters += _parameter_rows(job, found["fitted"].values, seed)
    frames = {"errors": errors, "parameters": parameters}
    return {frame: [{"seed": seed, **row} for row in rows] for frame, rows in frames.items()}


def true_predictor(seed: int) -> Predictor:
    """Return the method that simulates the twin's true needle, moduli, friction and bevel.

    It is given what the fit is given besides: the stated pose, the measured depth and crossings. What it
    still errs by is what the measurement does.
    """
    planned = {one.id: one for one in list_planned_insertions()}
    twins: dict[str, SyntheticInsertion] = {}

    def curve(insertion: Insertion) -> Curve:
        if insertion.id not in twins:
            twins[insertion.id] = simulate_insertion(planned[insertion.id], seed)
        twin = twins[insertion.id]
        tissue = twin.true_insertion.tissue
        if twin.specimen.field is None:  # the layers that it was measured to meet
            layers = np.array(insertion.sequence) - 1
            mu, alpha = twin.specimen.mu[layers], twin.specimen.alpha[layers]
            gamma = np.array([twin.specimen.friction])
            tissue = Tissue(mu, alpha, insertion.boundaries, friction=gamma)
        bevel = Bevel(bevel_offset(twin.specimen, twin.planned), insertion.side)
        return make_curve(simulate(draw_needle(seed), tissue, bevel, insertion.depth, rules=ModelOptions()))

    return curve_predictor(curve)


def _parameter_rows(job: Job, values: Mapping[str, float], seed: int) -> list[Row]:
    """Return the free parameters of a fit beside the twin's own and the paper's."""
    return [
        {
            "study": job.name,
            "parameter": name,
            "value": values[name],
            "truth": find_true_value(job, name, seed),
            "paper": (job.hand_tuned or {}).get(name, float("nan")),
        }
        for name in job.parameters.free
    ]
