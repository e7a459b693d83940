"""The report of a fit or cross-validation: the answer, what its text prints, and the files for a paper.

Tables are those of `studies/fit_tables.py`, figures of `studies/fit_figures.py`; the sentences stand in
`reporting/text/cross_validation.md.j2`.
"""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from needlefit.inference.baselines import BASELINES
from needlefit.inference.identifiability.stated_direction import DIRECTION_SD_DEG
from needlefit.metrics import list_metrics
from needlefit.reporting.figures import Drawing
from needlefit.reporting.number_format import format_metric
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import select_rows, to_records, to_tidy
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.studies import fit_figures, fit_tables
from needlefit.studies import scored_groups as scores
from needlefit.studies.first_page import (
    Advice,
    Check,
    FirstPage,
    Status,
    Verdict,
    advise,
    classify_doubt,
    find_failures,
    list_doubts,
    name_doubt,
)
from needlefit.studies.fit_tables import TEXT
from needlefit.studies.identification import lay_out_identification
from needlefit.studies.judge import Judgement, find_contradictions, judge, list_checks
from needlefit.studies.kinds.cross_validation.rows import FRAMES
from needlefit.studies.observations import draw_observations
from needlefit.studies.prediction_scores import AFTER_ONE_COLUMN, PREDICTED
from needlefit.studies.report import StudyReport, list_data_notes
from needlefit.studies.run import FitFrames, Run, value_of_run

__all__ = ["FRAMES", "REPORT"]

# ---- what the text prints


@value_of_run
def collect_values(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    frames, stated = FitFrames.of(run), run.knows(FitMetadata)
    role, folds, starts, errors = frames.role, stated.folds, frames.starts, frames.errors
    draws, sampling = frames.draws, stated.recipe.sample
    source = "" if draws.empty else str(draws["draw_source"].iloc[0])
    counts = sorted(len(fold.tune) for fold in folds)
    group = scores.pool_insertions(run)
    floors = {metric: group.get(metric.name, "floor") for metric in list_metrics() if group is not None}
    return {
        "run": run,
        "frames": frames,
        "role": role,
        "insertions": 0 if group is None else group.insertions,
        "max_panels": fit_figures.MAX_PANELS,
        "compared_in": {1: "one plane", 2: "space"}[scores.count_directions(run)],
        "media": {
            part: list(dict.fromkeys(select_rows(errors, role=part)["medium"]))
            for part in ("tune", "validate")
        },
        "folds": len(folds),
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
        "no_bands": role == "validate" and not draws["certified"].astype(bool).all(),
        "starts": len(starts),
        "agreeing": int(starts["within_tolerance"].astype(bool).sum()),
        "evaluations": int(starts["evaluations"].sum()),
        "failed": int(starts["failed_solves"].sum()),
        "computation": {  # searches of the mode, and independent draws of the posterior
            "starts": int((starts["fit"] == "fitted").sum()),
            "source": source,
            "sampler": sampling.sampler,
            "walkers": sampling.walkers if source == "posterior" else None,
            "draws": None if draws.empty else round(draws["ess"].min()),
        },
        "population": fit_tables.list_spreads(run),
        "metric": len(frames.error_fit) > 0,
        "printed": (frames.parameters["method"] == "hand_tuned").any(),
        "curved": frames.curved,
        "chains": fit_tables.tabulate_percentiles(run),
        "notes": list_data_notes(run),
        "rigidity": stated.dataset.rigidity,
        "contradictions": [name_doubt(kind) for kind in find_contradictions(run)],
    }


# ---- the first page


def judge_errors(run: Run) -> FirstPage:
    """Return the first page: the verdict is on the errors of tips, or of what was read."""
    values, role = collect_values(run), FitFrames.of(run).role
    checks, group = list_checks(run), scores.pool_insertions(run)
    judged = None if group is None else judge(run)
    if group is None or judged is None:
        return FirstPage(Verdict(TEXT.sentence("nothing_scored", values), "fail"), checks=checks)
    undetermined, score = fit_tables.list_undetermined(run), judged.score
    words = {**values, "judged": judged, "undetermined": undetermined}
    words |= {"gains": fit_tables.list_gains_of_direction(run), "direction_sd": DIRECTION_SD_DEG}
    numbers: dict[str, float | str | None] = {
        "outcome": judged.outcome,
        score: judged.error,
        f"floor_{score}": group.get(score, "floor"),
        f"{score.removesuffix('_mm')}_over_floor": judged.noise_ratio,
        "baseline": judged.curve or None,
        f"baseline_{score}": judged.curve_error,
        "trials": judged.trials,
        "insertions": group.insertions,
    }
    if role == "tune":
        words["verdict"], status = _open_fit(run, undetermined)
        words["factor"] = fit_tables.describe_largest_factor(run)
        status = "warn" if judged.turned_by or find_contradictions(run) else status
        numbers["not_determined"] = ", ".join(undetermined)
        sentence, tables = TEXT.sentence("fitted", words), list[TableLayout]()
    else:
        groups = scores.list_groups(run)
        # where there is one group, all insertions are those of the paper's row
        crps = run.frames["predictive"].reindex(columns=[PREDICTED[score].crps]).mean().item()
        numbers[PREDICTED[score].crps] = None if pd.isna(crps) else float(crps)
        numbers["paper_te_mm"] = groups[0].get(scores.TE, "paper") if len(groups) == 1 else None
        sentence, status = TEXT.sentence("predicted", words), judged.status
        tables = [fit_tables.lay_out_summary(run)]
    return FirstPage(
        Verdict(sentence, status, numbers, judged.outcome),
        TEXT.sentence("about", words),
        [*tables, fit_tables.lay_out_estimates(run, values["rigidity"])],
        checks=checks,
        advice=find_advice(run, judged),
        method=TEXT.sentence("method", words),
    )


def find_advice(run: Run, judged: Judgement) -> Advice | None:
    """Return what to do: it follows from faults, the judgement, checks and wide intervals of parameters."""
    frames, media = FitFrames.of(run), collect_values(run)["media"]
    role, by_check = frames.role, {check.check: check for check in list_checks(run)}
    other = [name for name in media["validate"] if name not in media["tune"]]
    gain = frames.predictive[AFTER_ONE_COLUMN].astype(float).median()
    width = by_check.get(Check.WIDTH)
    doubts = [doubt for doubt in list_doubts(run.warnings) if classify_doubt(doubt)][:1]
    # curves were fitted to the needles of a fit, too: only one that is closer is advised about
    comparison = judged.advice if role == "validate" or judged.outcome.passed is False else ""
    advice = ["predictable", *find_failures(by_check, comparison, other_medium=bool(other))]
    if run.faults or run.interrupted:
        advice.append("not_converged")
    advice += map(classify_doubt, doubts)
    if role == "tune" and fit_tables.list_wide(run):
        advice.append("parameters_undetermined")
    values = {
        "dataset": str(run.record.dataset),
        "doubt": "".join(doubt.help_key for doubt in doubts),
        "doubt_title": "".join(name_doubt(doubt.kind) for doubt in doubts),
        "other_medium": other[0] if other else "",
        "curve": BASELINES[judged.curve].description if judged.curve else "",
        "width": None if width is None else width.value,
        "gain": None if pd.isna(gain) or width is None else float(gain),
    }
    return advise(advice, values, run.name)


def _open_fit(run: Run, undetermined: Sequence[str]) -> tuple[str, Status]:
    """Return the block with which the verdict on a fit begins, and its status."""
    checks = {check.check: check for check in list_checks(run)}
    if Check.CURVES in checks and checks[Check.CURVES].passed is False:
        return "fit_fails", "fail"
    if "parameter_at_bound" in checks[Check.DATA].named.split(", "):
        return "fit_at_bound", "warn"
    if not run.reliable:
        return "fit_unreliable", "warn"
    if undetermined:
        return "fit_undetermined", "warn"
    return "fit_done", "warn" if fit_tables.list_wide(run) else "pass"


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
        figures["odd_needles"] = fit_figures.draw_odd_needles(odd)
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
    names = ("predictive", "readings", "ends", "curvature", "error_fit", "population", "draws")
    written |= {name: run.frames[name] for name in names}
    files = {name: run.frames[name] for name in ("errors", "shapes", "starts", "directions")}
    return files | {name: frame for name, frame in written.items() if len(frame)}


def fit_to_json(run: Run) -> dict[str, Any]:
    """Return the tables that are written as CSV, but for points and draws."""
    left_out = ("shapes", "draws", "readings", "ends")
    return {
        name: to_records(to_tidy(frame)) for name, frame in list_files(run).items() if name not in left_out
    }


REPORT = StudyReport(
    TEXT, collect_values, lay_out_tables, list_figures, judge_errors, list_files, fit_to_json
)
