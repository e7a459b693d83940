"""Leave out each insertion, or each specimen, in turn, and score it by the fit to the others.

The error in sample flatters a model, for it was made small by the fit itself; the error on what was left
out does not. Their difference is what a reader of a tuning table should add to it. A medium of which there
is only one specimen shows nothing of a further specimen: it gets a message in place of a number.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field
from scipy.stats import t as student

from needlefit.inference.baseline_fit import fit_baselines
from needlefit.inference.baselines import BASELINES
from needlefit.metrics import METRICS, headline_metrics
from needlefit.project.locate import find_file
from needlefit.project.toml import add_file_context, add_study_context, load
from needlefit.reporting.figures import Drawing, Look
from needlefit.reporting.labels import GREEN, INK, METHOD_COLOURS, medium_name, method_name
from needlefit.reporting.number_format import join_metrics, join_words
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, select_records, to_records
from needlefit.reporting.text import KindText
from needlefit.schemas.analyses import AnalysisRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.coverage import COVERAGE_COLUMNS, judge_predictions, tabulate_coverage
from needlefit.studies.fit_frames import COLUMNS, list_score_columns
from needlefit.studies.held_out_predictions import (
    Specimens,
    fit_posterior,
    tabulate_held_out,
)
from needlefit.studies.job import Fold, Job, Settings, group_insertions, leave_out, prepare
from needlefit.studies.kind import StudyKind
from needlefit.studies.report import StudyReport
from needlefit.studies.run import BestBaseline, Frames, Run, Verdict, judge_errors
from needlefit.studies.runner import AnalysisPlan, AnalysisTask, FrameRows, list_faults, run_analysis
from needlefit.studies.score import Scorer, curve_predictor, model_predictor


class LeftOutRecord(AnalysisRecord):
    """`kind = "left_out"`: leave-one-out cross-validation of several fits."""

    kind: Literal["left_out"]
    fits: tuple[str, ...] = Field(min_length=1)
    """Fits in `configs/fits/` whose insertions are left out in turn."""
    groups: tuple[Literal["insertion", "specimen"], ...] = ("insertion", "specimen")
    """What is left out together."""


KIND = StudyKind("left_out", LeftOutRecord, __name__)

BASELINE = "constant_curvature"  #: the empirical curve that stands beside the model in the summary

_WHERE = ("fit", "left_out")
_ERRORS = tuple(name for name in COLUMNS["errors"] if name not in ("role", "edp_flagged"))

#: `left_out` is "insertion", "specimen", or "nothing": the error in sample
FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": (*_WHERE, *_ERRORS),  # and the columns of metrics
    "predictive": (*_WHERE, *COLUMNS["predictive"]),
    "fits": (*_WHERE, "fold", "insertions", "pareto_k", "sampled", "certified", "parameter", "value"),
}


def run(name: str, record: LeftOutRecord, settings: Settings) -> Run:
    """Run a leave-one-out study.

    Raises ConfigError or DataError if anything the record names is missing or wrong.
    """
    jobs = [_prepare_job(name, fit, settings) for fit in record.fits]
    tasks: dict[str, AnalysisTask] = {}
    held_out: list[Fold] = []
    for fit, job in zip(record.fits, jobs, strict=True):
        whole = job.folds[0].tune
        tasks[f"{fit}, all"] = partial(_run_task, job, Fold("all", whole, whole), (fit, "nothing"), settings)
        for what in record.groups:
            if len(group_insertions(whole, what)) > 1:
                divided = leave_out(whole, what)
                held_out += divided
                for fold in divided:
                    key = f"{fit}, {fold.name}"
                    tasks[key] = partial(_run_task, job, fold, (fit, what), settings)
    plan = AnalysisPlan(
        jobs,
        tasks,
        {**FRAMES, "errors": (*FRAMES["errors"], *list_score_columns())},
        partial(_conclude, record, jobs),
        folds=held_out,
        parameters={fit: job.parameters for fit, job in zip(record.fits, jobs, strict=True)},
    )
    return run_analysis(name, record, settings, plan)


def _prepare_job(name: str, fit: str, settings: Settings) -> Job:
    with add_study_context(name, "fits"):
        file = find_file("fit", fit)
    with add_file_context(file):
        return prepare(f"{name} {fit}", load(file, FitRecord), settings)


def _run_task(job: Job, fold: Fold, where: tuple[str, str], settings: Settings) -> FrameRows:
    """Fit one fold, score what it holds out, and say how it was predicted."""
    head: Row = dict(zip(_WHERE, where, strict=True))
    learned = fit_posterior(job, job.problem(fold), (fold.name,), settings)
    floors = {insertion.id: job.floor(insertion) for insertion in fold.validate}
    scorer = Scorer(job.dataset, job.record.layer_count_rule, floors)
    curves = fit_baselines(job.dataset.pose, job.dataset.drop_proximal, fold.tune)
    methods = {
        "fitted": model_predictor(learned.fit.values, job.medium, job.dataset),
        **{name: curve_predictor(one.curve) for name, one in curves.items()},
    }
    errors = [
        {**head, **row}
        for method, predictor in methods.items()
        for insertion in fold.validate
        for row in scorer.score({"fold": fold.name, "method": method}, insertion, predictor)[0]
    ]
    known = Specimens(job, fold, learned.draws, settings.jobs)
    predicts = where[1] != "nothing"
    certified = not (known.faults if predicts else learned.draws.faults)
    rows = tabulate_held_out(job, fold, learned.draws, known) if predicts and certified else ()
    about = {**head, "fold": fold.name, "insertions": len(fold.tune), "pareto_k": learned.k}
    about |= {"sampled": learned.sampled, "certified": certified}
    return {
        "errors": errors,
        "predictive": [{**head, **row} for row in rows],
        "fits": [{**about, "parameter": name, "value": one} for name, one in learned.fit.values.items()],
    }


#: of each headline metric: `value` left out; `difference`, that minus the error in sample, of the same
#: insertions, and `difference_se`, its standard error over groups; `planned`, left out and with layers from
#: the planned path; `baseline_value`, a constant curvature fitted to the same insertions
SUMMARY = (
    *("fit", "left_out", "medium", "groups", "insertions", "metric"),
    *("value", "in_sample", "difference", "difference_se", "planned", "baseline_value", "floor"),
    *("pareto_k", "sampled", "not_converged", "note"),
)


#: `difference`: the method's error minus the fit's, by group, with its 95 % interval (Student) over groups;
#: `better`: insertions on which the fit errs less
PAIRED = (
    *("fit", "left_out", "method", "metric", "groups", "value", "difference"),
    *("low", "high", "better", "insertions"),
)


def pair_by_group(errors: pd.DataFrame) -> pd.DataFrame:
    """Compare every curve with the fit on what was left out, a group being one trial: columns `PAIRED`."""
    held = errors[(errors["left_out"] != "nothing") & (errors["boundaries"] == "measured")]
    rows = []
    for (fit, what), some in held.groupby(["fit", "left_out"], sort=False):
        for metric in headline_metrics():
            keys = ["fold", "insertion"]
            wide = some.pivot_table(index=keys, columns="method", values=metric.name, sort=False)
            for method in [name for name in some["method"].unique() if name in wide]:
                gap = wide[method] - wide["fitted"]
                by_group = gap.groupby(level="fold").mean()
                half = student.ppf(0.975, max(1, len(by_group) - 1)) * by_group.sem()
                mean = by_group.mean()
                about = (str(fit), str(what), method, metric.name, len(by_group), wide[method].mean())
                rows.append((*about, mean, mean - half, mean + half, int((gap > 0).sum()), len(gap)))
    return pd.DataFrame(rows, columns=list(PAIRED))


def _conclude(record: LeftOutRecord, jobs: list[Job], frames: Frames) -> tuple[str, ...]:
    rows = [
        row
        for fit, job in zip(record.fits, jobs, strict=True)
        for what in record.groups
        for row in _summary_rows(fit, what, job, frames)
    ]
    frames["summary"] = pd.DataFrame(rows, columns=list(SUMMARY))
    frames["paired"] = pair_by_group(frames["errors"])
    failed = int(sum({(r["fit"], r["left_out"]): r.get("not_converged", 0) for r in rows}.values()))
    fits = frames["fits"]
    doubtful = fits["fold"][~fits["certified"].astype(bool) & (fits["left_out"] != "nothing")].nunique()
    return (
        *list_faults({"simulations of insertions left out did not converge": failed}),
        *((f"the draws of {doubtful} fits are not certified: they predict nothing",) if doubtful else ()),
    )


def _summary_rows(fit: str, what: str, job: Job, frames: Frames) -> Iterator[Row]:
    """Yield what leaving out one kind of group came to, by metric, or why that is not applicable."""
    whole = job.folds[0].tune
    count = len(group_insertions(whole, what))
    head: Row = {"fit": fit, "left_out": what, "medium": whole[0].medium, "groups": count}
    head["insertions"] = len(whole)
    metrics = [metric.name for metric in headline_metrics()]
    if count < 2:
        yield from ({**head, "metric": one, "note": f"not applicable: one {what}"} for one in metrics)
        return
    errors = frames["errors"][frames["errors"]["fit"] == fit]
    fits = frames["fits"][(frames["fits"]["fit"] == fit) & (frames["fits"]["left_out"] == what)]
    fits = fits.drop_duplicates("fold")
    ours = _select_scores(errors, what, "fitted")
    known = ours[ours["converged"].astype(bool)]
    sample = _select_scores(errors, "nothing", "fitted").loc[known.index]
    curve = _select_scores(errors, what, BASELINE)
    planned = _select_scores(errors, what, "fitted", "planned")
    counts = {
        "pareto_k": fits["pareto_k"].astype(float).max(),
        "sampled": int(fits["sampled"].astype(bool).sum()),
        "not_converged": len(ours) - len(known),
        "note": "",
    }
    for metric in metrics:
        gap = known[metric] - sample[metric]
        by_group = gap.groupby(known["specimen"] if what == "specimen" else known.index).mean()
        yield {
            **head,
            "metric": metric,
            "value": known[metric].mean(),
            "in_sample": sample[metric].mean(),
            "difference": gap.mean(),
            "difference_se": by_group.std(ddof=1) / np.sqrt(len(by_group)),
            "planned": planned[metric].replace(np.inf, np.nan).mean(),
            "baseline_value": curve[metric].mean(),
            "floor": known[f"floor_{metric}"].mean() if f"floor_{metric}" in known else np.nan,
            **counts,
        }


def _select_scores(
    errors: pd.DataFrame, what: str, method: str, boundaries: str = "measured"
) -> pd.DataFrame:
    wanted = (errors["left_out"] == what) & (errors["method"] == method)
    return errors[wanted & (errors["boundaries"] == boundaries)].set_index("insertion")


# ---- the report

TEXT = KindText("left_out")
_TE = "te_mm"


def _list_fits(result: Run) -> list[list[Row]]:
    """Return the rows of every fit and kind of group: one for each metric."""
    return [to_records(rows) for _, rows in result.frames["summary"].groupby(["fit", "left_out"], sort=False)]


def describe(result: Run) -> dict[str, Any]:
    """Return what the text prints: for every fit, how much larger the error of left-out insertions is."""
    columns = ("value", "in_sample", "floor", "baseline_value")
    return {
        "fits": [
            {
                "name": medium_name(rows[0]["fit"]).capitalize(),
                **{key: rows[0][key] for key in ("left_out", "note", "groups")},
                "metrics": join_words([METRICS[row["metric"]].label for row in rows]),
                **{
                    key: "" if rows[0]["note"] else join_metrics({row["metric"]: row[key] for row in rows})
                    for key in columns
                },
            }
            for rows in _list_fits(result)
        ]
    }


def judge(result: Run) -> list[Verdict]:
    """Return a verdict for every fit and kind of group left out, beside the best baseline."""
    return [_judge_fit(result, rows) for rows in _list_fits(result)]


def _judge_fit(result: Run, rows: list[Row]) -> Verdict:
    group = f"{medium_name(rows[0]['fit'])}, each {rows[0]['left_out']} left out"
    if rows[0]["note"]:
        return Verdict(f"{group.capitalize()}: {rows[0]['note']}", "warn", group)
    row = next(row for row in rows if row["metric"] == _TE)
    ratio = row["value"] / row["floor"] if row["floor"] else None
    numbers = {_TE: row["value"], "floor_te_mm": row["floor"], "te_over_floor": ratio}
    numbers |= {"in_sample_te_mm": row["in_sample"], "insertions": row["insertions"]}
    best = _compare_best(result, row)
    numbers |= {"baseline_te_mm": best.error_mm if best else None}
    count = int(row["insertions"])
    found = judge_errors(group, row["value"], ratio, best, count, reliable=result.reliable)
    predictive = result.frames["predictive"]
    own = predictive[(predictive["fit"] == row["fit"]) & (predictive["left_out"] == row["left_out"])]
    return judge_predictions(replace(found, group=group, numbers=numbers), own, best)


def _compare_best(result: Run, row: Row) -> BestBaseline | None:
    """Return the baseline with the smallest error left out, and its paired difference from the fit."""
    match = {key: row[key] for key in ("fit", "left_out", "metric")}
    curves = [one for one in select_records(result.frames["paired"], **match) if one["method"] in BASELINES]
    best = min(curves, key=lambda one: float(one["value"]), default=None)
    if best is None or best["low"] is None:
        return None
    verdict: Literal["better", "worse", "tie"] = (
        "worse" if best["low"] > 0 else "better" if best["high"] < 0 else "tie"
    )
    return BestBaseline(BASELINES[best["method"]].description, best["value"], verdict)


_ERROR_COLUMNS = (
    *("error_left_out", "in_sample", "difference", "difference_se", "planned", "baseline_value", "floor"),
    *("pareto_k", "sampled"),
)


def tabulate(result: Run) -> list[Table]:
    """Return errors left out and in sample, of the fit and of curves, and coverage of what is left out."""
    errors = list[Row]()
    for rows in _list_fits(result):
        about = {"fit": medium_name(rows[0]["fit"])}
        if rows[0]["note"]:  # why there are no errors
            errors.append(
                {**rows[0], **dict.fromkeys(_ERROR_COLUMNS, ""), **about, "metric": rows[0]["note"]}
            )
            continue
        for number, row in enumerate(rows):
            once = {"pareto_k": row["pareto_k"] if not number else "", "sampled": row["sampled"] or None}
            errors.append({**row, **about, **once, "error_left_out": row["value"]})
    columns = (
        *("fit", "left_out", "groups", "insertions", "metric", "error_left_out", "in_sample", "gap_left_out"),
        *("planned", "baseline_value", "floor", "pareto_k_sampled"),
    )
    paired = [
        {
            **row,
            **{"fit": medium_name(row["fit"]), "method": method_name(row["method"])},
            **{"error_left_out": row["value"]},
            **({"low": None, "high": None, "better": ""} if row["method"] == "fitted" else {}),
        }
        for row in to_records(result.frames["paired"])
        if row["metric"] == headline_metrics()[0].name
    ]
    covered = [
        {"fit": medium_name(str(fit)), "left_out": group, **tabulate_coverage(predictions)}
        for (fit, group), predictions in result.frames["predictive"].groupby(["fit", "left_out"], sort=False)
    ]
    of_pairs = ("fit", "left_out", "method", "groups", "metric", "error_left_out", "difference_range")
    return [
        Table("left_out", errors, columns, groups=_WHERE, heads=4),
        Table("paired", paired, of_pairs, groups=_WHERE, heads=4),
        Table("coverage", covered, (*_WHERE, *COVERAGE_COLUMNS)),
    ]


_LOOKS = {
    "in_sample": Look("in sample", METHOD_COLOURS["fitted"], filled=False, size=5),
    "value": Look("left out", METHOD_COLOURS["fitted"], size=5),
    "baseline_value": Look("constant curvature", GREEN, "^", size=4.5),
    "floor": Look("noise floor", INK, "|", dashes=(0, (2, 1.5)), width=0.9),
}


def draw(result: Run) -> dict[str, Drawing]:
    """Return the errors in sample and left out, joined, unless nothing could be left out."""
    summary = result.frames["summary"].assign(origin=result.origin)
    if (summary["note"] != "").all():
        return {}
    titles = {one.name: f"{one.label}, mean over insertions ({one.unit})" for one in headline_metrics()}
    options = {
        **{"rows": ["fit", "left_out", "groups"], "value": "mean", "by": "look", "looks": _LOOKS},
        **{"name_row": lambda row: f"{medium_name(row[0])}, {row[1]}s ({row[2]})", "row_height": 0.36},
        **{"intervals": [("low", "high")], "panel": "metric", "panels": titles},
        "scale": dict.fromkeys(titles, "from 0"),
    }

    def join_ends(every: pd.DataFrame) -> pd.DataFrame:
        shown = every[every["note"] == ""]
        ends = {"value": {"low": shown["in_sample"], "high": shown["value"]}}
        parts = [shown.assign(look=look, mean=shown[look], **ends.get(look, {})) for look in _LOOKS]
        return pd.concat(parts, ignore_index=True)

    return {"summary": Drawing("dots_with_intervals", summary, options, join_ends)}


REPORT = StudyReport(TEXT, describe, tabulate, draw, judge=judge)
