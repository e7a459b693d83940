"""Each insertion, and each specimen, left out in turn: what a fit to the others makes of it.

The error in sample flatters a model, for it was made small by the fit itself; the error on what was left
out does not. Their difference is what a reader of a tuning table should add to it. A medium of which there
is only one specimen says nothing of a further specimen, and is told so instead of given a number.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np
import pandas as pd

from needlefit.inference.baselines import curve_for, fit_baseline
from needlefit.project.load import load
from needlefit.project.places import find
from needlefit.project.records.fit import FitRecord
from needlefit.project.records.left_out import LeftOutRecord
from needlefit.project.toml_lines import in_file
from needlefit.validation.folds import Fold, groups, leave_out
from needlefit.validation.heldout import PREDICTIVE, foretold
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.answered import Frames, Plan, answered
from needlefit.validation.inquiries.blamed import blamed
from needlefit.validation.inquiries.learned import Learned, learn
from needlefit.validation.inquiries.pieces import Piece, Rows
from needlefit.validation.job import Job, Settings, prepare
from needlefit.validation.results import COLUMNS
from needlefit.validation.score import Row, Scorer, curve_rival, model_rival

BASELINE = "constant_curvature"
"""The empirical curve that stands beside the model."""

_WHERE = ("fit", "left_out")
_ERRORS = tuple(name for name in COLUMNS["errors"] if name not in ("role", "edp_flagged"))

FRAMES: Mapping[str, tuple[str, ...]] = {
    "errors": (*_WHERE, *_ERRORS),
    "predictive": (*_WHERE, *PREDICTIVE),
    "fits": (*_WHERE, "fold", "insertions", "pareto_k", "sampled", "parameter", "value"),
}
"""`left_out` is "insertion", "specimen", or "nothing": the error in sample."""


def ask(name: str, record: LeftOutRecord, settings: Settings) -> Answer:
    """Leave out in turn what the record says, and score it.

    Raises
    ------
    ConfigError, DataError
        If anything the record names is missing or wrong.
    """
    jobs = [_job(name, fit, settings) for fit in record.fits]
    pieces: dict[str, Piece] = {}
    held_out: list[Fold] = []
    for fit, job in zip(record.fits, jobs, strict=True):
        whole = job.folds[0].tune
        pieces[f"{fit}, all"] = partial(_piece, job, Fold("all", whole, whole), (fit, "nothing"), settings)
        for what in record.groups:
            if len(groups(whole, what)) > 1:
                divided = leave_out(whole, what)
                held_out += divided
                for fold in divided:
                    key = f"{fit}, {fold.name}"
                    pieces[key] = partial(_piece, job, fold, (fit, what), settings)
    plan = Plan(
        jobs,
        pieces,
        FRAMES,
        partial(_conclude, record, jobs),
        folds=held_out,
        parameters={fit: job.parameters for fit, job in zip(record.fits, jobs, strict=True)},
    )
    return answered(name, record, settings, plan)


def _job(name: str, fit: str, settings: Settings) -> Job:
    with blamed(name, "fits"):
        file = find("fit", fit)
    with in_file(file):
        return prepare(f"{name} {fit}", load(file, FitRecord), settings)


def _piece(job: Job, fold: Fold, where: tuple[str, str], settings: Settings) -> Rows:
    """Fit one fold, score what it holds out, and say how it was foretold."""
    head: Row = dict(zip(_WHERE, where, strict=True))
    learned = learn(job, job.problem(fold), (fold.name,), settings)
    floors = {insertion.id: job.floor(insertion) for insertion in fold.validate}
    scorer = Scorer(job.dataset, job.record.reading, floors)
    curve = fit_baseline(BASELINE, job.dataset.pose, job.dataset.drop_proximal, fold.tune)
    rivals = {
        "fitted": model_rival(learned.fit.values, job.medium, job.dataset),
        BASELINE: curve_rival(lambda insertion: curve_for(curve, insertion)),
    }
    errors = [
        {**head, **row}
        for rival, curves in rivals.items()
        for insertion in fold.validate
        for row in scorer.score({"fold": fold.name, "rival": rival}, insertion, curves)[0]
    ]
    told = [] if where[1] == "nothing" else [{**head, **row} for row in foretold(job, fold, learned.draws)]
    return {"errors": errors, "predictive": told, "fits": _fit_rows(head, fold, learned)}


def _fit_rows(head: Row, fold: Fold, learned: Learned) -> list[Row]:
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
        _summary(fit, what, job, frames)
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


def _summary(fit: str, what: str, job: Job, frames: Frames) -> Row:
    """Return what leaving out one kind of group came to, or why that is not applicable."""
    whole = job.folds[0].tune
    count = len(groups(whole, what))
    row: Row = {"fit": fit, "left_out": what, "medium": whole[0].medium, "groups": count}
    row["insertions"] = len(whole)
    if count < 2:
        return {**row, "note": f"not applicable: one {what}"}
    errors = frames["errors"][frames["errors"]["fit"] == fit]
    fits = frames["fits"][(frames["fits"]["fit"] == fit) & (frames["fits"]["left_out"] == what)]
    fits = fits.drop_duplicates("fold")
    ours = _scores(errors, what, "fitted")
    known = ours[ours["converged"].astype(bool)]
    sample = _scores(errors, "nothing", "fitted").loc[known.index]
    curve = _scores(errors, what, BASELINE)
    planned = _scores(errors, what, "fitted", "planned")
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


def _scores(errors: pd.DataFrame, what: str, rival: str, boundaries: str = "measured") -> pd.DataFrame:
    """Return the errors of one rival by insertion."""
    wanted = (errors["left_out"] == what) & (errors["rival"] == rival)
    return errors[wanted & (errors["boundaries"] == boundaries)].set_index("insertion")
