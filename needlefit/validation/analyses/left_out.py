"""Leave out each insertion, or each specimen, in turn, and score it by the fit to the others.

The error in sample flatters a model, for it was made small by the fit itself; the error on what was left
out does not. Their difference is what a reader of a tuning table should add to it. A medium of which there
is only one specimen says nothing of a further specimen, and is told so instead of given a number.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd

from needlefit.inference.baselines import fit_baseline, make_baseline_curve
from needlefit.project.load import load
from needlefit.project.locate import find_file
from needlefit.project.toml_lines import add_file_context
from needlefit.schemas.analyses import LeftOutRecord
from needlefit.schemas.study import FitRecord
from needlefit.validation.analyses.posterior_fit import PosteriorFit, fit_posterior
from needlefit.validation.analyses.runner import (
    AnalysisPlan,
    AnalysisResult,
    AnalysisTask,
    FrameRows,
    Frames,
    error_context,
    run_analysis,
)
from needlefit.validation.folds import Fold, group_insertions, leave_out
from needlefit.validation.held_out_predictions import PREDICTIVE_COLUMNS, tabulate_held_out
from needlefit.validation.job import Job, Settings, prepare
from needlefit.validation.results import COLUMNS
from needlefit.validation.score import Row, Scorer, curve_predictor, model_predictor

BASELINE = "constant_curvature"
"""The empirical curve that stands beside the model."""

_WHERE = ("fit", "left_out")
_ERRORS = tuple(name for name in COLUMNS["errors"] if name not in ("role", "edp_flagged"))

FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": (*_WHERE, *_ERRORS),
    "predictive": (*_WHERE, *PREDICTIVE_COLUMNS),
    "fits": (*_WHERE, "fold", "insertions", "pareto_k", "sampled", "parameter", "value"),
}
"""`left_out` is "insertion", "specimen", or "nothing": the error in sample."""


def run(name: str, record: LeftOutRecord, settings: Settings) -> AnalysisResult:
    """Run a leave-one-out study.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
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
        FRAMES,
        partial(_conclude, record, jobs),
        folds=held_out,
        parameters={fit: job.parameters for fit, job in zip(record.fits, jobs, strict=True)},
    )
    return run_analysis(name, record, settings, plan)


def _prepare_job(name: str, fit: str, settings: Settings) -> Job:
    with error_context(name, "fits"):
        file = find_file("fit", fit)
    with add_file_context(file):
        return prepare(f"{name} {fit}", load(file, FitRecord), settings)


def _run_task(job: Job, fold: Fold, where: tuple[str, str], settings: Settings) -> FrameRows:
    """Fit one fold, score what it holds out, and say how it was predicted."""
    head: Row = dict(zip(_WHERE, where, strict=True))
    learned = fit_posterior(job, job.problem(fold), (fold.name,), settings)
    floors = {insertion.id: job.floor(insertion) for insertion in fold.validate}
    scorer = Scorer(job.dataset, job.record.layer_count_rule, floors)
    curve = fit_baseline(BASELINE, job.dataset.pose, job.dataset.drop_proximal, fold.tune)
    methods = {
        "fitted": model_predictor(learned.fit.values, job.medium, job.dataset),
        BASELINE: curve_predictor(lambda insertion: make_baseline_curve(curve, insertion)),
    }
    errors = [
        {**head, **row}
        for method, curves in methods.items()
        for insertion in fold.validate
        for row in scorer.score({"fold": fold.name, "method": method}, insertion, curves)[0]
    ]
    predicted = (
        []
        if where[1] == "nothing"
        else [{**head, **row} for row in tabulate_held_out(job, fold, learned.draws)]
    )
    return {"errors": errors, "predictive": predicted, "fits": _fit_rows(head, fold, learned)}


def _fit_rows(head: Row, fold: Fold, learned: PosteriorFit) -> list[Row]:
    about = {"fold": fold.name, "insertions": len(fold.tune), "pareto_k": learned.k}
    about["sampled"] = learned.sampled
    values = learned.fit.values.items()
    return [{**head, **about, "parameter": name, "value": value} for name, value in values]


SUMMARY = (
    *("fit", "left_out", "medium", "groups", "insertions"),
    *("ipe_mean_mm", "te_mm", "in_sample_ipe_mean_mm", "in_sample_te_mm"),
    *("ipe_gap_mm", "ipe_gap_se_mm", "te_gap_mm", "te_gap_se_mm"),
    *("planned_ipe_mean_mm", "planned_te_mm", "curve_ipe_mean_mm", "curve_te_mm"),
    *("floor_ipe_mean_mm", "floor_te_mm"),
    *("worst_pareto_k", "folds_sampled", "not_converged", "note"),
)
"""`*_gap_mm` is the error left out minus that in sample, of the same insertions, and `_se_mm` its standard
error over groups; `curve_*` is a constant curvature fitted to the same insertions."""


def _conclude(record: LeftOutRecord, jobs: list[Job], frames: Frames) -> tuple[str, ...]:
    rows = [
        _summary_row(fit, what, job, frames)
        for fit, job in zip(record.fits, jobs, strict=True)
        for what in record.groups
    ]
    frames["summary"] = pd.DataFrame(rows, columns=list(SUMMARY))
    failed = int(sum(row.get("not_converged", 0) for row in rows))
    doubtful = int((~frames["predictive"]["certified"].astype(bool)).sum())
    return (
        *((f"{failed} simulations of insertions left out did not converge",) if failed else ()),
        *((f"the draws behind {doubtful} predictions are not certified",) if doubtful else ()),
    )


def _summary_row(fit: str, what: str, job: Job, frames: Frames) -> Row:
    """Return what leaving out one kind of group came to, or why that is not applicable."""
    whole = job.folds[0].tune
    count = len(group_insertions(whole, what))
    row: Row = {"fit": fit, "left_out": what, "medium": whole[0].medium, "groups": count}
    row["insertions"] = len(whole)
    if count < 2:
        return {**row, "note": f"not applicable: one {what}"}
    errors = frames["errors"][frames["errors"]["fit"] == fit]
    fits = frames["fits"][(frames["fits"]["fit"] == fit) & (frames["fits"]["left_out"] == what)]
    fits = fits.drop_duplicates("fold")
    ours = _select_scores(errors, what, "fitted")
    known = ours[ours["converged"].astype(bool)]
    sample = _select_scores(errors, "nothing", "fitted").loc[known.index]
    curve = _select_scores(errors, what, BASELINE)
    planned = _select_scores(errors, what, "fitted", "planned")
    for metric in ("ipe_mean_mm", "te_mm"):
        row[metric] = known[metric].mean()
        row[f"in_sample_{metric}"] = sample[metric].mean()
        gap = known[metric] - sample[metric]
        by_group = gap.groupby(known["specimen"] if what == "specimen" else known.index).mean()
        stem = metric.removesuffix("_mean_mm").removesuffix("_mm")
        row[f"{stem}_gap_mm"] = gap.mean()
        row[f"{stem}_gap_se_mm"] = by_group.std(ddof=1) / np.sqrt(len(by_group))
        row[f"planned_{metric}"] = planned[metric].replace(np.inf, np.nan).mean()
        row[f"curve_{metric}"] = curve[metric].mean()
        row[f"floor_{metric}"] = known[f"floor_{metric}"].mean()
    ks = fits["pareto_k"].astype(float)
    sampled = int(fits["sampled"].astype(bool).sum())
    return row | {
        "worst_pareto_k": ks.max(),
        "folds_sampled": sampled,
        "not_converged": len(ours) - len(known),
        "note": "",
    }


def _select_scores(
    errors: pd.DataFrame, what: str, method: str, boundaries: str = "measured"
) -> pd.DataFrame:
    """Return the errors of one method by insertion."""
    wanted = (errors["left_out"] == what) & (errors["method"] == method)
    return errors[wanted & (errors["boundaries"] == boundaries)].set_index("insertion")
