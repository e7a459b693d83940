"""Measure how much every cell of the paper's tables depends on decisions and on poorly known quantities.

Each variation changes one thing: a rule of the model, the tissue's thickness, the needle's rigidity, the
depths of all layers. Everything is then tuned again and scored under it, which is what another program, with
another reading of the paper, would have printed; and scored with the parameters kept, which is what taking
numbers from one program to the other would do. Two of them have known answers: parameters and rigidity
enter the equilibrium by their ratio, so that a stiffer needle is answered by moduli stiffer by as much, and
no error changes; and at the strains of these needles thickness hardly acts.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Self

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from needlefit.datasets.noise import NoiseFloor
from needlefit.inference.fit import Fit, StartPoint
from needlefit.inference.optimize import search
from needlefit.inference.parameters import Parameters
from needlefit.inference.problem import make_objective
from needlefit.mechanics.needle import Needle
from needlefit.metrics import METRICS, headline_metrics
from needlefit.project.toml import add_study_context
from needlefit.reporting.figures import Drawing, Look
from needlefit.reporting.labels import SERIES_COLOURS, layers_name, medium_name
from needlefit.reporting.number_format import MISSING, format_bare_symbol, format_metric
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.base import Name, Record
from needlefit.schemas.limits import MAX_CONSTRAINT_SPACING_MM, MAX_STARTS, MIN_ELEMENT_MM
from needlefit.schemas.medium import use_path_angle
from needlefit.studies import paper_cells, runner
from needlefit.studies.fit_frames import list_score_columns
from needlefit.studies.job import Job, Settings, adapt_parameters
from needlefit.studies.kind import StudyKind
from needlefit.studies.provenance import describe_model_options
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Frames, Run, Status
from needlefit.studies.score import Row, model_predictor


class VariationRecord(Record):
    """One change of the model, of the needle or of the data; keys that are left out stay."""

    factor: str
    """What is varied, in words."""
    name: Name
    """Name of the variation in tables."""
    constraint_switch: float | None = Field(default=None, ge=0, le=1)
    """Replaces `constraint_switch` of every tissue model."""
    tangent_part: float | None = Field(default=None, ge=0, le=1)
    """Replaces `tangent_part`."""
    constraint_spacing_mm: float | None = Field(default=None, ge=MIN_ELEMENT_MM, le=MAX_CONSTRAINT_SPACING_MM)
    """Replaces `constraint_spacing_mm`."""
    first_cell_mm: float | None = Field(default=None, gt=0)
    """Replaces `first_cell_mm`."""
    thickness_mm: float | None = Field(default=None, gt=0)
    """Replaces `thickness_mm`."""
    rigidity_factor: float | None = Field(default=None, gt=0)
    """Factor on the flexural rigidity EI."""
    inner_diameter_mm: float | None = Field(default=None, ge=0)
    """Makes the needle a tube."""
    boundary_shift_sd: float | None = None
    """Shifts all layer boundaries by this many standard deviations of each."""
    advance: Literal["path_angle"] | None = None
    """Replaces the rule of advance; the model is always fitted again."""

    @model_validator(mode="after")
    def _something(self) -> Self:
        if all(
            getattr(self, key) is None for key in type(self).model_fields if key not in ("factor", "name")
        ):
            raise ValueError(f"variation `{self.name}` changes nothing: give one of its keys")
        given = [key for key in ("constraint_switch", "tangent_part") if getattr(self, key) is not None]
        if self.advance and given:
            raise ValueError(f'variation `{self.name}`: leave out `{given[0]}` with advance = "path_angle"')
        return self


class SensitivityRecord(AnalysisRecord):
    """`kind = "sensitivity"`: studies under variations of the model, fitted again and with the parameters
    kept.
    """

    kind: Literal["sensitivity"]
    studies: tuple[str, ...] = Field(min_length=1)
    """Studies that are run under every variation."""
    fits: tuple[str, ...] = ()
    """Fits that are run under every variation."""
    starts: int = Field(default=4, ge=1, le=MAX_STARTS)
    """Random starting points beside the unvaried fit."""
    variations: tuple[VariationRecord, ...] = Field(min_length=1)
    """The variations."""


KIND = StudyKind("sensitivity", SensitivityRecord, __name__)

BASE_VARIATION = "as decided"  #: the variation that changes nothing

_WHERE = ("aspect", "variation", "tuned")
FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": (*_WHERE, *paper_cells.ERROR_COLUMNS),  # and the columns of metrics
    "parameters": (*_WHERE, "study", "parameter", "value", "at_bound", "comparable"),
}
"""`tuned`: "again" under the variation, or "kept" as they stood. `comparable` is false where b means another
thing."""

CHANGE_COLUMNS = (
    *(*_WHERE, *paper_cells.CELL_KEYS, "metric", "unit", "value"),
    *("baseline_value", "change", "floor", "change_in_floors"),
)

_MEDIUM_KEYS = (
    *("constraint_switch", "tangent_part", "constraint_spacing_mm"),
    *("first_cell_mm", "thickness_mm"),
)


def apply_variation(job: Job, variation: VariationRecord) -> Job:
    changes = {key: getattr(variation, key) for key in _MEDIUM_KEYS}
    medium = job.medium.model_copy(update={key: new for key, new in changes.items() if new is not None})
    needle, factor = job.dataset.needle, variation.rigidity_factor or 1.0
    inner, outer = variation.inner_diameter_mm, job.dataset.outer_diameter
    if inner is not None and outer is not None:  # a tube as wide as the dataset's needle
        factor *= 1 - (inner / outer) ** 4
    dataset = replace(job.dataset, needle=Needle(needle.length, needle.flexural_rigidity * factor))
    shift = variation.boundary_shift_sd or 0.0
    moved = paper_cells.with_insertions(
        job, lambda one: replace(one, boundaries=one.boundaries + shift * one.boundary_sd)
    )
    if variation.advance is None:
        return replace(moved, medium=medium, dataset=dataset)
    medium = use_path_angle(medium)
    parameters = adapt_parameters(Parameters.from_record(medium), job.recipe)
    return replace(moved, medium=medium, dataset=dataset, parameters=parameters)


def refit(job: Job, before: Fit, starts: int, settings: Settings) -> Fit:
    """Return the best fit from a few random starts and from the end of the fit before."""
    problem = job.problem(job.folds[0])
    found = paper_cells.run_search(paper_cells.with_starts(job, starts), "fitted", settings)
    goal = make_objective(problem, job.recipe.minimize)
    begin = before.theta if set(job.parameters.free) <= set(before.values) else found.theta
    near = search(goal, job.recipe, StartPoint(starts, begin), settings.stop)
    if not near.objective < found.objective:
        return found
    values, tried = problem.values(np.array(near.theta)), (*found.starts, near)
    return replace(found, theta=near.theta, values=values, objective=near.objective, starts=tried)


@dataclass(frozen=True)
class BaseFits:
    """Studies and fits as they stand, and the noise floors of their insertions."""

    jobs: Mapping[str, Job]
    floors: Mapping[str, NoiseFloor]
    fits: Mapping[str, Fit]


def _find_base(jobs: Mapping[str, Job], settings: Settings) -> BaseFits:
    """Fit everything as it stands: needed by every variation, found by whichever task needs it first."""
    fits = {name: paper_cells.run_search(job, "fitted", settings) for name, job in jobs.items()}
    return BaseFits(jobs, paper_cells.compute_floors(jobs.values()), fits)


def run(name: str, record: SensitivityRecord, settings: Settings) -> Run:
    """Run studies and fits as they are and under every variation."""
    with add_study_context(name, "studies, fits"):
        jobs = paper_cells.prepare_jobs(record.studies, record.fits, settings)
    base = runner.Shared(partial(_find_base, jobs, settings))
    variations = {f"{one.factor}: {one.name}": one for one in record.variations}
    tasks: dict[str, runner.AnalysisTask] = {
        key: partial(_run_variation, base, one, record.starts, settings)
        for key, one in {BASE_VARIATION: None, **variations}.items()
    }
    first = next(iter(jobs.values()))
    options = {
        key: describe_model_options(apply_variation(first, one).medium) for key, one in variations.items()
    }
    frames = {**FRAMES, "errors": (*FRAMES["errors"], *list_score_columns())}
    conclude = partial(_conclude, paper_cells.find_paper_numbers(jobs))
    plan = runner.AnalysisPlan(
        list(jobs.values()), tasks, frames, conclude, {"variations": options}, shared=[base]
    )
    return runner.run_analysis(name, record, settings, plan)


def _run_variation(
    find: runner.Shared[BaseFits], variation: VariationRecord | None, starts: int, settings: Settings
) -> runner.FrameRows:
    """Score everything as it stands (None), or tuned under one variation.

    That with parameters kept too, where b stays what it is.
    """
    base, parts = find(), []
    for name, job in base.jobs.items():
        if variation is None:
            head: Row = dict(zip(_WHERE, (BASE_VARIATION, BASE_VARIATION, "again"), strict=True))
            parts.append(_score_fit(job, base, base.fits[name], head))
            continue
        changed = apply_variation(job, variation)
        fits = {"again": refit(changed, base.fits[name], starts, settings)}
        if variation.constraint_spacing_mm is None and variation.advance is None:
            fits["kept"] = base.fits[name]
        for tuned, fit in fits.items():
            head = dict(zip(_WHERE, (variation.factor, variation.name, tuned), strict=True))
            parts.append(_score_fit(changed, base, fit, head))
    return runner.join_rows(parts)


def _score_fit(job: Job, base: BaseFits, fit: Fit, where: Row) -> runner.FrameRows:
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
        "errors": [
            {**where, **row} for row in paper_cells.score_methods(job, {"fitted": method}, base.floors)
        ],
        "parameters": parameters,
    }


def tabulate_study_changes(errors: pd.DataFrame) -> pd.DataFrame:
    """Return one row per variation, study and headline metric: the error, and its change."""
    studies = paper_cells.tabulate_generalisation(errors, _WHERE)
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


def _conclude(numbers: Mapping[str, int], frames: Frames) -> tuple[str, ...]:
    """Add the changes of cells, of studies, and of parameters against those as decided."""
    errors, parameters = frames["errors"], frames["parameters"]
    every = _join_base(
        paper_cells.tabulate_cells(errors, numbers, _WHERE), [*paper_cells.CELL_KEYS, "metric"]
    )
    change = every["value"] - every["baseline_value"]
    cells = every.assign(change=change, change_in_floors=change / every["floor"])
    frames["cells"] = cells[list(CHANGE_COLUMNS)]
    frames["studies"] = tabulate_study_changes(errors)
    again = _join_base(parameters, ["study", "parameter"])
    again = again[again["tuned"] == "again"]
    # as multiples; none where b means another thing
    ratio = (again["value"] / again["baseline_value"]).where(again["comparable"].astype(bool))
    frames["parameter_changes"] = again.assign(ratio=ratio).drop(columns="tuned")
    failed = int((~errors["converged"].astype(bool)).sum())
    return runner.list_faults({"simulations did not converge": failed})


def _join_base(every: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """Return rows with the value as decided of the same keys."""
    decided = every[every["aspect"] == BASE_VARIATION].set_index(keys)["value"].rename("baseline_value")
    return every.join(decided, on=keys)


# ---- the report

MIN_CHANGE_FLOORS = 0.1  #: least change that is reported as one, as a fraction of the noise floor
MAX_CHANGE_FLOORS = 20.0  #: noise floors up to which the scale of the figure goes

_GROUPINGS = {"validation": "Held out", "tuning_by_layers": "By layers", "tuning_by_media": "By media"}
_TUNED = {"again": "re-fitted", "kept": "kept"}


def _select_varied(result: Run, frame: str, **values: str) -> pd.DataFrame:
    """Return the rows of a frame under variations whose columns have these values."""
    rows = result.frames[frame]
    kept = rows["aspect"] != BASE_VARIATION
    for column, value in values.items():
        kept &= rows[column] == value
    return rows[kept]


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints."""
    again = _select_varied(result, "studies", tuned="again")
    kept = _select_varied(result, "studies", tuned="kept", metric="te_mm")
    changed = again[again["conclusion_changes"]].drop_duplicates(["aspect", "variation", "study"])
    moduli = result.frames["parameter_changes"].query("aspect == 'rigidity'")
    moduli = moduli[moduli["parameter"].str.startswith("mu")]
    ratios = moduli.groupby("variation", sort=False)["ratio"].agg(["min", "max"]).reset_index()
    # for every kind of variation the largest change of a held-out cell, the largest first
    cells = _select_varied(result, "cells", tuned="again", grouping="validation")
    cells = cells[cells["metric"].isin([metric.name for metric in headline_metrics()])]
    cells = cells.assign(size=cells["change_in_floors"].abs()).sort_values("size", ascending=False)
    aspects = [
        {
            **row,
            "unit": METRICS[row["metric"]].unit,
            "cell": medium_name(row["medium"])
            + (f", {layers_name(int(row['layers']))}" if row["layers"] else ""),
        }
        for row in to_records(cells.drop_duplicates("aspect"))
    ]
    # the parameter that changes most while the errors hardly do: the data do not determine it
    errors, keys = again[again["metric"] == "te_mm"], ["aspect", "variation", "study"]
    still = errors[errors["change_in_floors"].abs() < 1][[*keys, "change"]]
    changes = result.frames["parameter_changes"].dropna(subset="ratio").merge(still, on=keys)
    parameter = None
    if len(changes):
        row = _find_largest(changes.assign(size=np.log(changes["ratio"].astype(float))), "size")
        parameter = {**row, "name": format_bare_symbol(row["parameter"])}
    return {
        "changed": to_records(changed),
        "changed_variations": len(changed.drop_duplicates(["aspect", "variation"])),
        "variations": len(again[["aspect", "variation"]].drop_duplicates()),
        "limit_mm": float(again["limit_mm"].iloc[0]),
        "aspects": aspects,
        "kept": [_find_largest(kept, "change")] if len(kept) else [],
        "crossing": to_records(kept[kept["conclusion_changes"]]),
        "moduli": to_records(ratios),
        "parameter": parameter,
        "synthetic": result.synthetic,
        "options": [": ".join(one) for one in _list_variations(result)],
        "min_change": MIN_CHANGE_FLOORS,
    }


def _find_largest(rows: pd.DataFrame, column: str) -> Row:
    """Return the first row of the largest size in a column."""
    return to_records(rows.iloc[[int(rows[column].abs().fillna(-1.0).to_numpy().argmax())]])[0]


def _list_variations(result: Run) -> list[tuple[str, str]]:
    rows = _select_varied(result, "parameter_changes")[["aspect", "variation"]].drop_duplicates()
    return list(rows.itertuples(index=False, name=None))


def rate(result: Run) -> Status:
    """Return "warn" if a conclusion changes once everything is fitted again."""
    return "warn" if _select_varied(result, "studies", tuned="again")["conclusion_changes"].any() else "pass"


def tabulate(result: Run) -> list[Table]:
    """Return the changes of every study, of all cells, and of the parameters.

    Of cells it is by how much they change, in the middle and at most, by variation and table; parameters are
    multiples of the default ones.
    """
    tables = []
    for tuned in _TUNED:
        varied = _select_varied(result, "studies", tuned=tuned)
        frame = pd.concat([result.frames["studies"].query("aspect == @BASE_VARIATION"), varied])
        marked = pivot(_mark_changes(frame), ["aspect", "variation"], ["metric", "study"])
        names = dict.fromkeys(map(_shorten_study, varied["study"]))
        changes = (
            part("marked_change", metric=one.name, study=name) for one in headline_metrics() for name in names
        )
        columns = ("aspect", "variation", *changes, "changed_studies")
        tables.append(Table(f"studies_{tuned}", marked, columns, groups=("aspect",), heads=1))
    cells = _select_varied(result, "cells", tuned="again", unit="mm").replace({"grouping": _GROUPINGS})
    keys = ["aspect", "variation", "grouping"]
    largest = [
        {
            **dict(zip(keys, key, strict=True)),
            "median_change": group["change"].abs().median(),
            "largest_change": _find_largest(group, "change")["change"],
            "largest_change_in_floors": group["change_in_floors"].abs().max(),
        }
        for key, group in cells.groupby(keys, sort=False)
    ]
    statistics = ("median_change", "largest_change", "largest_change_in_floors")
    sizes = (part(key, grouping=name) for name in _GROUPINGS.values() for key in statistics)
    variations = _list_variations(result)
    ratios = [
        {
            **row,
            "study": medium_name(row["study"]),
            "variation_number": variations.index((row["aspect"], row["variation"])) + 1,
            "mark": "†" if row["at_bound"] else "",
        }
        for row in to_records(_select_varied(result, "parameter_changes"))
    ]
    numbers = (part("marked_ratio", variation_number=number + 1) for number in range(len(variations)))
    pivoted = pivot(largest, keys[:2], keys[2:])
    fitted = pivot(ratios, ["study", "parameter"], ["variation_number"])
    return [
        *tables,
        Table("largest", pivoted, (*keys[:2], *sizes), groups=("aspect",), heads=1),
        Table("parameters", fitted, ("study", "parameter", *numbers), groups=("study",), heads=1),
    ]


def _mark_changes(frame: pd.DataFrame) -> Iterator[Row]:
    for (aspect, variation), group in frame.groupby(["aspect", "variation"], sort=False):
        changed = dict.fromkeys(map(_shorten_study, group.loc[group["conclusion_changes"], "study"]))
        stands = aspect == BASE_VARIATION
        about = {
            "variation": "" if stands else variation,
            "changed_studies": "" if stands else ", ".join(changed) or MISSING,
        }
        for row in to_records(group):
            size = abs(row["change_in_floors"] or 0.0)
            mark = "**" if size > 1 else "*" if size > MIN_CHANGE_FLOORS else ""
            value = format_metric(METRICS[row["metric"]], row["value"])
            cell = {"change": value, "mark": ""} if stands else {"mark": mark}
            yield {**row, **about, **cell, "study": _shorten_study(row["study"])}


def _shorten_study(study: str) -> str:
    return study.removeprefix("study")


def draw(result: Run) -> dict[str, Drawing]:
    """Return the change of every study under every variation, in units of the noise floor."""
    frame = result.frames["studies"].assign(origin=result.origin)
    studies = list(dict.fromkeys(_select_varied(result, "studies")["study"]))
    spread = 0.7 / max(len(studies), 1)
    looks = {
        name: Look(
            medium_name(name),
            SERIES_COLOURS[n % len(SERIES_COLOURS)],
            shift=spread * (n + 0.5) - 0.35,
        )
        for n, name in enumerate(studies)
    }
    panels = {
        f"{metric.name} {tuned}": f"{metric.label}, {words}"
        for tuned, words in _TUNED.items()
        for metric in headline_metrics()
    }
    options = {
        **{"rows": ["aspect", "variation"], "value": "change_in_floors", "by": "study", "looks": looks},
        **{"name_row": ": ".join, "panel": "panel", "panels": panels, "scale": 1.0, "zero": True},
        "x_label": "change of the held-out error (noise floors)",
        "limits": (-MAX_CHANGE_FLOORS, MAX_CHANGE_FLOORS),
        "ringed": "conclusion_changes",
    }

    def name_panels(every: pd.DataFrame) -> pd.DataFrame:
        varied = every[every["aspect"] != BASE_VARIATION]
        return varied.assign(panel=varied["metric"] + " " + varied["tuned"])

    return {"studies": Drawing("dots_with_intervals", frame, options, name_panels)}


REPORT = StudyReport(KindText("sensitivity"), describe, tabulate, draw, rate=rate)
