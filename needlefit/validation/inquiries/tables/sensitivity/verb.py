"""Carrying out every variation, and what changes under it."""

from collections.abc import Mapping
from functools import cached_property, partial

import pandas as pd

from needlefit.datasets.noise import NoiseFloor
from needlefit.inference.starts import Fit
from needlefit.project.records.sensitivity import SensitivityRecord, VariationRecord
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.answered import Frames, Plan, answered
from needlefit.validation.inquiries.blamed import blamed
from needlefit.validation.inquiries.pieces import Piece, Rows, joined
from needlefit.validation.inquiries.tables.cells import (
    CELL,
    ERRORS,
    cells,
    every_job,
    floors_of,
    numbers_of,
    scored,
    searched,
)
from needlefit.validation.inquiries.tables.pattern import generalising
from needlefit.validation.inquiries.tables.sensitivity.varied import tuned_again, varied
from needlefit.validation.job import Job, Settings
from needlefit.validation.provenance import rules
from needlefit.validation.score import Row, model_rival

AS_DECIDED = "as decided"
"""The variation that changes nothing."""

_WHERE = ("of", "variation", "tuned")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": (*_WHERE, *ERRORS),
    "parameters": (*_WHERE, "study", "parameter", "value", "at_bound", "comparable"),
}
"""`tuned`: "again" under the variation, or "kept" as they stood. `comparable` is false where b means another
thing."""

CHANGES = (*_WHERE, *CELL, "metric", "unit", "value", "as_decided", "change", "floor", "change_in_floors")


class _AsItStands:
    """The fits as they stand: needed by every variation, found once, whichever piece asks first."""

    def __init__(self, jobs: Mapping[str, Job], settings: Settings) -> None:
        self.jobs, self.settings = jobs, settings

    @cached_property
    def floors(self) -> dict[str, NoiseFloor]:
        return floors_of(self.jobs.values())

    @cached_property
    def fits(self) -> dict[str, Fit]:
        return {name: searched(job, "fitted", self.settings) for name, job in self.jobs.items()}


def ask(name: str, record: SensitivityRecord, settings: Settings) -> Answer:
    """Carry out studies and fits as they stand and under every variation.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    FitError
        If a search finds no point that can be solved.
    """
    with blamed(name, "studies, fits"):
        jobs = every_job(record.studies, record.fits, settings)
    base = _AsItStands(jobs, settings)
    pieces: dict[str, Piece] = {AS_DECIDED: partial(_as_decided, base)}
    for one in record.variations:
        pieces[f"{one.of}: {one.name}"] = partial(_piece, base, one, record.starts, settings)
    first = next(iter(jobs.values()))
    also = {"variations": {f"{v.of}: {v.name}": rules(varied(first, v).medium) for v in record.variations}}
    conclude = partial(_conclude, numbers_of(jobs))
    return answered(name, record, settings, Plan(list(jobs.values()), pieces, FRAMES, conclude, also))


def _as_decided(base: _AsItStands) -> Rows:
    where = dict(zip(_WHERE, (AS_DECIDED, AS_DECIDED, "again"), strict=True))
    return joined([_scored(job, base, base.fits[name], where) for name, job in base.jobs.items()])


def _piece(base: _AsItStands, variation: VariationRecord, starts: int, settings: Settings) -> Rows:
    """Tune and score everything under one variation; with parameters kept too, where b stays what it is."""
    same_b = variation.constraint_spacing_mm is None
    parts = []
    for name, job in base.jobs.items():
        changed = varied(job, variation)
        again = tuned_again(changed, base.fits[name], starts, settings)
        fits = {"again": again} | ({"kept": base.fits[name]} if same_b else {})
        for tuned, fit in fits.items():
            where = dict(zip(_WHERE, (variation.of, variation.name, tuned), strict=True))
            parts.append(_scored(changed, base, fit, where))
    return joined(parts)


def _scored(job: Job, base: _AsItStands, fit: Fit, where: Row) -> Rows:
    comparable = job.medium.constraint_spacing_mm == base.jobs[job.name].medium.constraint_spacing_mm
    rival = model_rival(fit.values, job.medium, job.dataset)
    parameters = []
    for name in job.parameters.free:
        value, bounds = fit.values[name], job.parameters.bounds[name]
        ends = any(abs(value - end) < 1e-3 * abs(end) for end in bounds)
        row = {"study": job.name, "parameter": name, "value": value, "at_bound": ends}
        parameters.append({**where, **row, "comparable": comparable})
    return {
        "errors": [{**where, **row} for row in scored(job, {"fitted": rival}, base.floors)],
        "parameters": parameters,
    }


def _conclude(numbers: Mapping[str, int], frames: Frames) -> tuple[str, ...]:
    errors = frames["errors"]
    frames["cells"] = _against(cells(errors, numbers, _WHERE))
    studies = generalising(errors, _WHERE)
    decided = studies[studies["of"] == AS_DECIDED].set_index("study")
    for column in ("ipe_mean_mm", "te_mm"):
        change = studies[column] - studies["study"].map(decided[column])
        studies[f"{column.removesuffix('_mm')}_change_mm"] = change
        studies[f"{column.removesuffix('_mm')}_change_in_floors"] = change / studies[f"floor_{column}"]
    studies["conclusion_changes"] = studies["generalises"] != studies["study"].map(decided["generalises"])
    frames["studies"] = studies
    frames["parameter_changes"] = _ratios(frames["parameters"])
    failed = int((~errors["converged"].astype(bool)).sum())
    return (f"{failed} simulations did not converge",) if failed else ()


def _against(every: pd.DataFrame) -> pd.DataFrame:
    """Return every cell with its change against the one as decided."""
    keys = [*CELL, "metric"]
    decided = every[every["of"] == AS_DECIDED].set_index(keys)["value"].rename("as_decided")
    found = every.join(decided, on=keys)
    change = found["value"] - found["as_decided"]
    return found.assign(change=change, change_in_floors=change / found["floor"])[list(CHANGES)]


def _ratios(parameters: pd.DataFrame) -> pd.DataFrame:
    """Return parameters tuned again as multiples of those as decided; none where b means another thing."""
    keys = ["study", "parameter"]
    decided = parameters[parameters["of"] == AS_DECIDED].set_index(keys)["value"].rename("as_decided")
    again = parameters[parameters["tuned"] == "again"].join(decided, on=keys)
    ratio = (again["value"] / again["as_decided"]).where(again["comparable"].astype(bool))
    return again.assign(ratio=ratio).drop(columns="tuned")
