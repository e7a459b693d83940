"""The first page of a fit or cross-validation: the verdict on the errors of what was measured, and advice."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from needlefit.inference.baselines import BASELINES
from needlefit.inference.identifiability.known_direction import DIRECTION_SD_DEG
from needlefit.reporting.table import TableLayout
from needlefit.studies import fit_tables
from needlefit.studies import scored_groups as scores
from needlefit.studies.advice import advise, classify_doubt, find_failures, list_doubts, name_doubt
from needlefit.studies.answer import Advice, Check, Finding, Status, Verdict
from needlefit.studies.coverage import AFTER_ONE_COLUMN
from needlefit.studies.first_page import FirstPage
from needlefit.studies.fit_frames import FitFrames
from needlefit.studies.fit_tables import TEXT
from needlefit.studies.judge import Judgement, judge, limit_status, list_checks
from needlefit.studies.prediction_scores import PREDICTED
from needlefit.studies.run import Run


def judge_errors(run: Run, values: Mapping[str, Any]) -> FirstPage:
    """Return the first page: the verdict is on the errors of tips, or of what was read."""
    role = FitFrames.of(run).role
    checks, group = list_checks(run), scores.pool_insertions(run)
    judged = None if group is None else judge(run)
    if group is None or judged is None:
        return FirstPage(Verdict(TEXT.sentence("nothing_scored", values), "fail"), checks=checks)
    undetermined, score = fit_tables.list_undetermined(run), judged.score
    words = {**values, "judged": judged, "insertions": group.insertions, "undetermined": undetermined}
    words |= {"gains": fit_tables.list_gains_of_direction(run), "direction_sd": DIRECTION_SD_DEG}
    wide = fit_tables.list_wide(run)
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
        words["verdict"], status = _open_fit(run, undetermined, wide)
        words["factor"] = fit_tables.describe_largest_factor(run)
        status = "warn" if judged.turned_by else limit_status(run, status)
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
        [*tables, fit_tables.lay_out_estimates(run.frames["parameters"], values["rigidity"])],
        checks=checks,
        advice=find_advice(run, judged, checks, wide, values["media"]),
        method=TEXT.sentence("method", words),
    )


def find_advice(
    run: Run,
    judged: Judgement,
    checks: Sequence[Finding],
    wide: Sequence[str],
    media: Mapping[str, Sequence[str]],
) -> Advice | None:
    """Return what to do: it follows from faults, the judgement, checks and `wide` intervals of parameters.

    `media`: by role, into which insertions went.
    """
    frames = FitFrames.of(run)
    role = frames.role
    by_check = {check.check: check for check in checks}
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
    if role == "tune" and wide:
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


def _open_fit(run: Run, undetermined: Sequence[str], wide: Sequence[str]) -> tuple[str, Status]:
    """Return the block with which the verdict on a fit begins, and its status."""
    checks = {check.check: check for check in list_checks(run)}
    if Check.CURVES in checks and checks[Check.CURVES].passed is False:
        return "fit_fails", "fail"
    if "parameter_at_bound" in checks[Check.DATA].named.split(", "):
        return "fit_at_bound", "warn"
    if not run.reliable:
        return "fit_unreliable", "warn"
    return "fit_undetermined" if undetermined else "fit_done", "warn" if undetermined or wide else "pass"
