"""Points along the needle: the verdict is on the errors of tips, and every needle is drawn."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from needlefit.grouping import group_values
from needlefit.inference.baselines import BASELINES
from needlefit.inference.identifiability.directions import find_least_determined
from needlefit.inference.parameter_names import HYPERPARAMETERS
from needlefit.reporting.figures import Drawing
from needlefit.reporting.number_format import format_bare_symbol, format_quantity_range, is_known
from needlefit.reporting.table_files import select_rows
from needlefit.studies import fit_figures, fit_tables
from needlefit.studies import scored_groups as scores
from needlefit.studies.advice import advise, classify_doubt, find_failures, list_doubts, name_doubt
from needlefit.studies.answer import Advice, Answer, Check, Finding, Status, Verdict
from needlefit.studies.coverage import AFTER_ONE_COLUMN
from needlefit.studies.fit_frames import FitFrames
from needlefit.studies.fit_sentences import TEXT
from needlefit.studies.identification import ParameterRow
from needlefit.studies.judge import CRPS, Judgement, judge, limit_status, list_checks
from needlefit.studies.kinds.cross_validation.observed import ObservationReport
from needlefit.studies.run import Run


def answer_by_tips(run: Run, values: Mapping[str, Any]) -> Answer:
    """Return the parts of the first page: the verdict is on the errors of tips."""
    role = FitFrames.of(run).role
    checks, group = list_checks(run, role), scores.pool_insertions(run, role)
    judged = None if group is None else judge(run, group)
    if group is None or judged is None:
        return Answer([Verdict(TEXT.sentence("nothing_scored", values), "fail")], checks=checks)
    determined, intervals = _list_determined(run)
    words = {
        **values,
        "judged": judged,
        "insertions": group.head.insertions,
        "listed": determined,
        "intervals": intervals,
        "bevel": _name_free_bevel(run),
    }
    numbers: dict[str, float | str | None] = {
        "outcome": judged.outcome,
        scores.TE: judged.error_mm,
        f"floor_{scores.TE}": group.get(scores.TE, "floor"),
        "te_over_floor": judged.noise_ratio,
        "baseline": judged.curve or None,
        "baseline_te_mm": judged.curve_mm,
        "trials": judged.trials,
        "insertions": group.head.insertions,
    }
    if role == "tune":
        words["verdict"], status = _open_fit(run, [word for word, _ in determined])
        status = limit_status(run, status)
        rest = (name for word, names in determined if word != "yes" for name in names)
        numbers["not_determined"] = ", ".join(rest)
        sentence, table = TEXT.sentence("fitted", words), fit_tables.lay_out_parameters(run)
    else:
        groups = scores.list_held_out_groups(run)
        # where there is one group, all insertions are those of the paper's row
        crps = run.frames["predictive"][CRPS].mean()
        numbers[CRPS] = None if pd.isna(crps) else float(crps)
        numbers["paper_te_mm"] = groups[0].get(scores.TE, "paper") if len(groups) == 1 else None
        sentence, status = TEXT.sentence("predicted", words), judged.status
        table = fit_tables.lay_out_summary(run)
    about, known = (TEXT.sentence(block, words) for block in ("about", "what_fit_determined"))
    advice = find_advice(run, judged, checks, [word for word, _ in determined], values["media"])
    return Answer([Verdict(sentence, status, "", numbers)], [table], about, checks, advice, known)


def find_advice(
    run: Run,
    judged: Judgement,
    checks: Sequence[Finding],
    determined: Sequence[str],
    media: Mapping[str, Sequence[str]],
) -> Advice | None:
    """Return what to do: it follows from faults, the judgement, checks and what the fit determined.

    `media`: by role, into which insertions went.
    """
    frames = FitFrames.of(run)
    role = frames.role
    by_check = {one.check: one for one in checks}
    other = [name for name in media["validate"] if name not in media["tune"]]
    gain = frames.predictive[AFTER_ONE_COLUMN].astype(float).median()
    intervals = by_check.get(Check.INTERVALS)
    doubts = list_doubts(run.warnings)[:1]
    # curves were fitted to the needles of a fit, too: only one that is closer is advised about
    comparison = judged.advice if role == "validate" or judged.outcome.passed is False else ""
    found = ["predictable", *find_failures(by_check, comparison, other_medium=bool(other))]
    if run.faults or run.interrupted:
        found.append("not_converged")
    found += map(classify_doubt, doubts)
    if role == "tune" and set(determined) - {"yes"}:
        found.append("parameters_undetermined")
    values = {
        "dataset": str(run.record.dataset),
        "doubt": "".join(one.help_key for one in doubts),
        "doubt_title": "".join(name_doubt(one.kind) for one in doubts),
        "other_medium": other[0] if other else "",
        "curve": BASELINES[judged.curve].description if judged.curve else "",
        "width": None if intervals is None else intervals.width_mm,
        "gain": None if pd.isna(gain) or intervals is None else float(gain),
    }
    return advise(found, values, run.name)


def _open_fit(run: Run, determined: Sequence[str]) -> tuple[str, Status]:
    """Return the block with which the verdict on a fit begins, and its status."""
    checks = {one.check: one for one in list_checks(run, "tune")}
    if Check.CURVES in checks and checks[Check.CURVES].passed is False:
        return "fit_fails", "fail"
    if "parameter_at_bound" in checks[Check.DATA].named.split(", "):
        return "fit_at_bound", "warn"
    if not run.reliable:
        return "fit_unreliable", "warn"
    return ("fit_undetermined", "warn") if set(determined) - {"yes"} else ("fit_done", "pass")


MAX_PRINTED_INTERVALS = 2  #: more determined parameters than these stand without their intervals


def _list_determined(run: Run) -> tuple[list[tuple[str, list[str]]], bool]:
    """Return the free parameters by whether the data determine them, and whether those have intervals."""
    rows = [
        row
        for row in ParameterRow.read(select_rows(run.frames["parameters"], method="fitted"))
        if row.status in ("free", "tied") and row.parameter not in HYPERPARAMETERS
    ]
    words = {
        name: find_least_determined(row.determined for row in some)
        for name, some in group_values((row.parameter, row) for row in rows).items()
    }
    names = {name: format_bare_symbol(name) for name in words}
    known = [row for row in rows if words[row.parameter] == "yes" and all(map(is_known, row.interval))]
    if shown := len({row.fold for row in rows}) == 1 and len(known) <= MAX_PRINTED_INTERVALS:
        for row in known:
            names[row.parameter] += f" {format_quantity_range(row.parameter, *row.interval)}"
    return list(group_values((words[name], label) for name, label in names.items()).items()), shown


def _name_free_bevel(run: Run) -> str:
    """Return the symbol of the bevel's parameter where it is free, else ""."""
    free = set(FitFrames.of(run).free_parameters["parameter"])
    return next((format_bare_symbol(one) for one in ("bevel_mm", "cut_angle_deg") if one in free), "")


def draw_needles(run: Run, role: str) -> dict[str, Drawing]:
    """Return the insertions with the smallest, middle and largest tip error, and all of them."""
    frames = FitFrames.of(run)
    if any(select_rows(one, role=role, method="fitted").empty for one in (frames.errors, frames.shapes)):
        return {}
    return {"insertions": fit_figures.draw_first_page(run, role), **list_overlays(run, role)}


def list_overlays(run: Run, role: str) -> dict[str, Drawing]:
    """Return all insertions of a role, in space also from above."""
    names = ("overlays", "overlays_above")[: scores.count_directions(run)]
    return {name: fit_figures.draw_overlays(run, role, from_above=name != names[0]) for name in names}


POINTS = ObservationReport("points", lambda run: True, answer_by_tips, draw_needles)
