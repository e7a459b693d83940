"""The report of a fit or cross-validation: the answer, what its text prints, and the files for a paper.

Tables are those of `studies/fit_tables.py`, figures of `studies/fit_figures.py`; the sentences stand in
`reporting/text/cross_validation.md.j2`.
"""

from typing import Any

import pandas as pd

from needlefit.metrics import list_metrics
from needlefit.reporting.figures import Drawing
from needlefit.reporting.number_format import format_metric
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import Row, select_rows, to_records, to_tidy
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.studies import fit_figures, fit_tables
from needlefit.studies import scored_groups as scores
from needlefit.studies.advice import name_doubt
from needlefit.studies.first_page import FirstPage
from needlefit.studies.fit_frames import FitFrames
from needlefit.studies.fit_tables import TEXT
from needlefit.studies.identification import lay_out_identification
from needlefit.studies.judge import find_contradictions
from needlefit.studies.kinds.cross_validation.first_page import judge_errors
from needlefit.studies.kinds.cross_validation.frames import FRAMES, OPTIONAL
from needlefit.studies.observations import draw_observations
from needlefit.studies.odd_needles import draw_odd_needles
from needlefit.studies.report import StudyReport, list_data_notes
from needlefit.studies.run import Run, value_of_run

__all__ = ["FRAMES", "OPTIONAL", "REPORT"]

# ---- what the text prints


@value_of_run
def collect_values(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    frames, stated = FitFrames.of(run), run.knows(FitMetadata)
    role, folds, starts, errors = frames.role, stated.folds, frames.starts, frames.errors
    counts = sorted(len(fold.tune) for fold in folds)
    group = scores.pool_insertions(run)
    floors = {metric: group.get(metric.name, "floor") for metric in list_metrics() if group is not None}
    return {
        "run": run,
        "frames": frames,
        "role": role,
        "compared_in": {1: "one plane", 2: "space"}[scores.count_directions(run)],
        "dataset": stated.dataset.name,
        "media": {
            part: list(dict.fromkeys(select_rows(errors, role=part)["medium"]))
            for part in ("tune", "validate")
        },
        "folds": len(folds),
        "several_folds": len(folds) > 1,
        "held_out": len({insertion for fold in folds for insertion in fold.held_out}),
        "depths": {
            # the least and the greatest, one if they are printed alike
            str(name): list(dict.fromkeys(f"{depth:.0f}" for depth in (depths.min(), depths.max())))
            for name, depths in select_rows(errors, method="fitted").groupby("role")["depth_mm"]
        },
        # the least and the greatest, one if they are equal
        "fitted_counts": list(dict.fromkeys(map(str, (*counts[:1], *counts[-1:])))),
        "floors": [
            f"{metric.label} {format_metric(metric, floor, 3 if floor < 0.1 else 2)} {metric.unit}"
            for metric, floor in floors.items()
            if floor is not None and metric.has_floor
        ],
        "no_bands": role == "validate" and not frames.draws["certified"].astype(bool).all(),
        "starts": len(starts),
        "agreeing": int(starts["within_tolerance"].astype(bool).sum()),
        "evaluations": int(starts["evaluations"].sum()),
        "failed": int(starts["failed_solves"].sum()),
        "computation": describe_computation(run),
        "population": fit_tables.list_spreads(run),
        "metric": len(frames.error_fit) > 0,
        "printed": (frames.parameters["method"] == "hand_tuned").any(),
        "curved": frames.curved,
        "chains": fit_tables.tabulate_percentiles(run),
        "notes": list_data_notes(run),
        "rigidity": stated.dataset.rigidity,
        "contradictions": [name_doubt(kind) for kind in find_contradictions(run)],
    }


def describe_computation(run: Run) -> Row:
    """Return by what the parameters were found: searches of nlopt, and independent draws of the posterior."""
    frames, recipe = FitFrames.of(run), run.knows(FitMetadata).recipe
    draws = frames.draws
    source = "" if draws.empty else str(draws["draw_source"].iloc[0])
    return {
        "starts": int((frames.starts["fit"] == "fitted").sum()),
        "source": source,
        "sampler": recipe.sample.sampler,
        "walkers": recipe.sample.walkers if source == "posterior" else None,
        "draws": None if draws.empty else round(draws["ess"].min()),
    }


# ---- tables and figures


@value_of_run
def lay_out_tables(run: Run) -> list[TableLayout]:
    """Return every table of a report, each once."""
    frames = FitFrames.of(run)
    # the parameters of which more is to say than their interval
    identified = frames.identification
    explained = identified[(identified["note"] != "") | identified["tip_shift_mm"].notna()]
    tables = [
        fit_tables.lay_out_summary(run),
        fit_tables.lay_out_errors("validation", run),
        *([fit_tables.lay_out_coverage(run)] if len(frames.predictive) else []),
        fit_tables.lay_out_baselines(run),
        fit_tables.lay_out_insertions(run),
        fit_tables.lay_out_parameters(run),
        *([lay_out_identification(explained)] if len(explained) else []),
        fit_tables.lay_out_chains(run),
        fit_tables.lay_out_errors("tuning", run),
    ]
    return [table for table in tables if table.rows]


def list_figures(run: Run) -> dict[str, Drawing]:
    """Return what the tables allow to be drawn."""
    frames = FitFrames.of(run)
    figures = draw_observations(run, frames.role)
    if len(frames.predictive):
        figures["predicted"] = fit_figures.draw_predictive_check(run)
    if odd := run.knows(FitMetadata).odd_needles:
        figures["odd_needles"] = draw_odd_needles(odd)
    if len(frames.profiles):
        figures["profiles"] = fit_figures.draw_profiles(frames.identification, frames.profiles)
    return figures


# ---- files


def list_files(run: Run) -> dict[str, pd.DataFrame]:
    """Return the tables that are written as CSV, by name."""
    written = {
        **{name: scores.tabulate_errors(name, run) for name in scores.GROUPINGS},
        "parameters": run.frames["parameters"].assign(origin=run.origin),
        "identify": run.frames["identification"],
        "posterior": fit_tables.tabulate_percentiles(run),
    }
    names = ("predictive", "readings", "curvature", "error_fit", "population", "draws")
    written |= {name: run.frames[name] for name in names}
    files = {name: run.frames[name] for name in ("errors", "shapes", "starts", "directions")}
    return files | {name: frame for name, frame in written.items() if len(frame)}


def fit_to_json(run: Run) -> dict[str, Any]:
    """Return the tables that are written as CSV, but for points and draws."""
    left_out = ("shapes", "draws", "readings")
    return {
        name: to_records(to_tidy(frame)) for name, frame in list_files(run).items() if name not in left_out
    }


def describe_fit(run: Run) -> FirstPage:
    return judge_errors(run, collect_values(run))


REPORT = StudyReport(
    TEXT, collect_values, lay_out_tables, list_figures, describe_fit, list_files, fit_to_json
)
