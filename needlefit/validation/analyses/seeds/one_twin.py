"""Run all studies and fits on the twin of one seed, beside the true needle."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from needlefit.datasets.insertion import Insertion
from needlefit.inference.compared_points import Curve, make_curve
from needlefit.mechanics.control import Bevel, ModelOptions
from needlefit.mechanics.simulate import simulate
from needlefit.mechanics.tissue import Tissue
from needlefit.schemas.analyses import SeedsRecord
from needlefit.synthetic.build import build_unscanned
from needlefit.synthetic.design import PlannedInsertion, list_planned_insertions
from needlefit.synthetic.insertion import SyntheticInsertion, simulate_insertion
from needlefit.synthetic.truth import bevel_offset, draw_needle, draw_specimen
from needlefit.validation.analyses.paper_cells import (
    ERROR_COLUMNS,
    compute_floors,
    prepare_jobs,
    run_search,
    score_methods,
    with_starts,
)
from needlefit.validation.analyses.runner import FrameRows
from needlefit.validation.job import Job, Settings
from needlefit.validation.result_rows import make_predictors
from needlefit.validation.score import Predictor, Row, curve_predictor

TRUTH = "truth"
"""The method that knows the needle as it really is."""

FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": ("seed", *ERROR_COLUMNS),
    "parameters": ("seed", "study", "parameter", "value", "true", "paper"),
}
"""Of `parameters`: those that are fitted; `true` is the geometric mean over what a fit learns from."""


def run_on_twin(
    seed: int, record: SeedsRecord, plan: Sequence[PlannedInsertion], settings: Settings
) -> FrameRows:
    """Return the errors of all methods on one twin of the insertions `plan`, and the fitted parameters."""
    with TemporaryDirectory() as folder:
        dataset = build_unscanned(Path(folder), seed, plan)
        jobs = prepare_jobs(record.studies, record.fits, settings, str(dataset))
    floors = compute_floors(jobs.values())
    truth = true_predictor(seed)
    errors: list[Row] = []
    parameters: list[Row] = []
    for job in (with_starts(job, record.starts) for job in jobs.values()):
        searches = [search for search in job.searches if search != "fitted_metric"]
        fits = {search: run_search(job, search, settings) for search in searches}
        errors += score_methods(job, {**make_predictors(job, job.folds[0], fits), TRUTH: truth}, floors)
        parameters += _parameter_rows(job, fits["fitted"].values, seed)
    found = {"errors": errors, "parameters": parameters}
    return {frame: [{"seed": seed, **row} for row in rows] for frame, rows in found.items()}


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
            "true": _true_value(job, name, seed),
            "paper": (job.hand_tuned or {}).get(name, float("nan")),
        }
        for name in job.parameters.free
    ]


def _true_value(job: Job, name: str, seed: int) -> float:
    """Return the geometric mean of a parameter over specimens, layers and bevels that a fit learns from."""
    planned = {one.id: one for one in list_planned_insertions()}
    tuned = [planned[one.id] for one in job.folds[0].tune]
    specimens = [draw_specimen(seed, one.medium, one.specimen) for one in tuned]
    if name == "bevel_mm":
        known: list[Any] = [bevel_offset(*pair) for pair in zip(specimens, tuned, strict=True)]
        return float(np.exp(np.mean(np.log(known))))
    same = [name, *(tied for tied, (_, source) in job.parameters.ties.items() if source == name)]
    layers = [int(one.removeprefix("mu").removesuffix("_pa")) - 1 for one in same if one.startswith("mu")]
    if not layers:
        return float("nan")
    return float(1e6 * np.exp(np.mean([np.log(specimen.mu[layers]) for specimen in specimens])))
