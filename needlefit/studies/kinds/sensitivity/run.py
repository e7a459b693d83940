"""Measure how much every cell of the paper's tables depends on decisions and on poorly known quantities.

Each variation changes one thing: a rule of the model, the tissue's thickness, the needle's rigidity, the
depths of all layers. Everything is then tuned again and scored under it, which is what another program, with
another reading of the paper, would have printed; and scored with the parameters kept, which is what taking
numbers from one program to the other would do. Two of them have known answers: parameters and rigidity
enter the equilibrium by their ratio, so that a stiffer needle is answered by moduli stiffer by as much, and
no error changes; and at the strains of these needles thickness hardly acts.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
import pandas as pd

from needlefit.datasets.noise import NoiseFloor
from needlefit.inference.fit import Fit, Start, StartPoint
from needlefit.inference.objective import make_objective
from needlefit.inference.optimize.local_search import search
from needlefit.inference.parameters import Parameters
from needlefit.mechanics.needle import Needle
from needlefit.metrics import headline_metrics
from needlefit.project.toml_lines import add_study_context
from needlefit.schemas.medium import use_path_angle
from needlefit.studies.job import Job, Settings, adapt_parameters
from needlefit.studies.kinds.sensitivity.schema import SensitivityRecord, VariationRecord
from needlefit.studies.paper_cells import (
    CELL_KEYS,
    ERROR_COLUMNS,
    compute_floors,
    find_paper_numbers,
    prepare_jobs,
    run_search,
    score_methods,
    tabulate_cells,
    tabulate_generalisation,
    with_insertions,
    with_starts,
)
from needlefit.studies.provenance import describe_model_options
from needlefit.studies.run import Frames, Run
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, join_rows, run_analysis
from needlefit.studies.score import Row, list_score_columns, model_predictor

_MEDIUM_KEYS = (
    *("constraint_switch", "tangent_part", "constraint_spacing_mm"),
    *("first_cell_mm", "thickness_mm"),
)


def apply_variation(job: Job, variation: VariationRecord) -> Job:
    """Return the job under one variation."""
    changes = {key: getattr(variation, key) for key in _MEDIUM_KEYS}
    medium = job.medium.model_copy(update={key: new for key, new in changes.items() if new is not None})
    needle = job.dataset.needle
    rigidity = needle.flexural_rigidity * _rigidity_factor(job, variation)
    dataset = replace(job.dataset, needle=Needle(needle.length, rigidity))
    shift = variation.boundary_shift_sd or 0.0
    moved = with_insertions(
        job, lambda one: replace(one, boundaries=one.boundaries + shift * one.boundary_sd)
    )
    if variation.advance is None:
        return replace(moved, medium=medium, dataset=dataset)
    medium = use_path_angle(medium)
    parameters = adapt_parameters(Parameters.from_record(medium), job.recipe)
    return replace(moved, medium=medium, dataset=dataset, parameters=parameters)


def _rigidity_factor(job: Job, variation: VariationRecord) -> float:
    """Return the factor of the needle's rigidity; a hollow one's is of a tube as wide as the dataset's."""
    factor = variation.rigidity_factor or 1.0
    inner, outer = variation.inner_diameter_mm, job.dataset.outer_diameter
    if inner is None or outer is None:
        return factor
    return factor * (1 - (inner / outer) ** 4)


def refit(job: Job, before: Fit, starts: int, settings: Settings) -> Fit:
    """Return the best fit from a few random starts and from the end of the fit before."""
    problem = job.problem(job.folds[0])
    found = run_search(with_starts(job, starts), "fitted", settings)
    goal = make_objective(problem, job.recipe.minimize)
    begin = before.theta if set(job.parameters.free) <= set(before.values) else found.theta
    near = search(goal, job.recipe, StartPoint(starts, begin), settings.stop)
    if not near.objective < found.objective:
        return found
    return _with_start(near, found, problem.values(np.array(near.theta)))


def _with_start(best: Start, fit: Fit, values: dict[str, float]) -> Fit:
    """Return a fit whose best point is that of one more start."""
    return replace(fit, theta=best.theta, values=values, objective=best.objective, starts=(*fit.starts, best))


BASE_VARIATION = "as decided"
"""The variation that changes nothing."""

_WHERE = ("aspect", "variation", "tuned")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": (*_WHERE, *ERROR_COLUMNS),  # and the columns of metrics
    "parameters": (*_WHERE, "study", "parameter", "value", "at_bound", "comparable"),
}
"""`tuned`: "again" under the variation, or "kept" as they stood. `comparable` is false where b means another
thing."""

CHANGE_COLUMNS = (
    *_WHERE,
    *CELL_KEYS,
    "metric",
    "unit",
    "value",
    "baseline_value",
    "change",
    "floor",
    "change_in_floors",
)


class _BaseFits:
    """The fits as they stand: needed by every variation, found once, by whichever task needs them first."""

    def __init__(self, jobs: Mapping[str, Job], settings: Settings) -> None:
        self.jobs, self.settings = jobs, settings

    def __call__(self) -> None:
        """Compute what the tasks share."""
        _ = self.floors, self.fits

    @cached_property
    def floors(self) -> dict[str, NoiseFloor]:
        return compute_floors(self.jobs.values())

    @cached_property
    def fits(self) -> dict[str, Fit]:
        return {name: run_search(job, "fitted", self.settings) for name, job in self.jobs.items()}


def run(name: str, record: SensitivityRecord, settings: Settings) -> Run:
    """Run studies and fits as they are and under every variation.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    with add_study_context(name, "studies, fits"):
        jobs = prepare_jobs(record.studies, record.fits, settings)
    base = _BaseFits(jobs, settings)
    tasks: dict[str, AnalysisTask] = {BASE_VARIATION: partial(_run_base, base)}
    for one in record.variations:
        tasks[f"{one.factor}: {one.name}"] = partial(_run_variation, base, one, record.starts, settings)
    first = next(iter(jobs.values()))
    also = {
        "variations": {
            f"{v.factor}: {v.name}": describe_model_options(apply_variation(first, v).medium)
            for v in record.variations
        }
    }
    conclude = partial(_conclude, find_paper_numbers(jobs))
    frames = {**FRAMES, "errors": (*FRAMES["errors"], *list_score_columns())}
    return run_analysis(
        name,
        record,
        settings,
        AnalysisPlan(list(jobs.values()), tasks, frames, conclude, also, shared=[base]),
    )


def _run_base(base: _BaseFits) -> FrameRows:
    where = dict(zip(_WHERE, (BASE_VARIATION, BASE_VARIATION, "again"), strict=True))
    return join_rows([_score_fit(job, base, base.fits[name], where) for name, job in base.jobs.items()])


def _run_variation(base: _BaseFits, variation: VariationRecord, starts: int, settings: Settings) -> FrameRows:
    """Tune and score everything under one variation; with parameters kept too, where b stays what it is."""
    same_b = variation.constraint_spacing_mm is None and variation.advance is None
    parts = []
    for name, job in base.jobs.items():
        changed = apply_variation(job, variation)
        again = refit(changed, base.fits[name], starts, settings)
        fits = {"again": again} | ({"kept": base.fits[name]} if same_b else {})
        for tuned, fit in fits.items():
            where = dict(zip(_WHERE, (variation.factor, variation.name, tuned), strict=True))
            parts.append(_score_fit(changed, base, fit, where))
    return join_rows(parts)


def _score_fit(job: Job, base: _BaseFits, fit: Fit, where: Row) -> FrameRows:
    before = base.jobs[job.name].medium
    comparable = (job.medium.constraint_spacing_mm, job.medium.advance) == (
        before.constraint_spacing_mm,
        before.advance,
    )
    method = model_predictor(fit.values, job.medium, job.dataset)
    parameters = []
    for name in job.parameters.free:
        value, bounds = fit.values[name], job.parameters.bounds[name]
        ends = any(abs(value - end) < 1e-3 * abs(end) for end in bounds)
        row = {"study": job.name, "parameter": name, "value": value, "at_bound": ends}
        parameters.append({**where, **row, "comparable": comparable})
    return {
        "errors": [{**where, **row} for row in score_methods(job, {"fitted": method}, base.floors)],
        "parameters": parameters,
    }


def _conclude(numbers: Mapping[str, int], frames: Frames) -> tuple[str, ...]:
    errors = frames["errors"]
    frames["cells"] = _compare_with_base(tabulate_cells(errors, numbers, _WHERE))
    frames["studies"] = tabulate_study_changes(errors)
    frames["parameter_changes"] = _parameter_ratios(frames["parameters"])
    failed = int((~errors["converged"].astype(bool)).sum())
    return (f"{failed} simulations did not converge",) if failed else ()


def tabulate_study_changes(errors: pd.DataFrame) -> pd.DataFrame:
    """Return one row per variation, study and headline metric: the error, and its change."""
    studies = tabulate_generalisation(errors, _WHERE)
    decided = studies[studies["aspect"] == BASE_VARIATION].set_index("study")
    changed = studies["generalises"] != studies["study"].map(decided["generalises"])
    head = studies[[*_WHERE, "study"]]
    verdict = studies[["limit_mm", "generalises"]].assign(conclusion_changes=changed)
    parts = []
    for metric in headline_metrics():
        value, floor = (studies.get(name, np.nan) for name in (metric.name, f"floor_{metric.name}"))
        change = value - studies["study"].map(decided[metric.name])
        numbers = {"value": value, "floor": floor, "change": change, "change_in_floors": change / floor}
        parts.append(pd.concat([head.assign(metric=metric.name, **numbers), verdict], axis=1))
    return pd.concat(parts).sort_index(kind="stable").reset_index(drop=True)


def _compare_with_base(every: pd.DataFrame) -> pd.DataFrame:
    """Return every cell with its change against the one as decided."""
    keys = [*CELL_KEYS, "metric"]
    decided = every[every["aspect"] == BASE_VARIATION].set_index(keys)["value"].rename("baseline_value")
    found = every.join(decided, on=keys)
    change = found["value"] - found["baseline_value"]
    return found.assign(change=change, change_in_floors=change / found["floor"])[list(CHANGE_COLUMNS)]


def _parameter_ratios(parameters: pd.DataFrame) -> pd.DataFrame:
    """Return parameters tuned again as multiples of those as decided; none where b means another thing."""
    keys = ["study", "parameter"]
    decided = (
        parameters[parameters["aspect"] == BASE_VARIATION].set_index(keys)["value"].rename("baseline_value")
    )
    again = parameters[parameters["tuned"] == "again"].join(decided, on=keys)
    ratio = (again["value"] / again["baseline_value"]).where(again["comparable"].astype(bool))
    return again.assign(ratio=ratio).drop(columns="tuned")
