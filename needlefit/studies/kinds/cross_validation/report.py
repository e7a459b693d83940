"""The report of a fit or cross-validation: the answer, what its text prints, and the files for a paper.

Tables are those of `studies/fit_tables.py`, figures of `studies/fit_figures.py`; the sentences stand in
`reporting/text/cross_validation.md.j2`.
"""

from collections.abc import Sequence
from typing import Any

import pandas as pd

from needlefit.grouping import group_values
from needlefit.inference.baselines import BASELINES
from needlefit.inference.identifiability.directions import find_least_determined
from needlefit.inference.parameter_names import HYPERPARAMETERS
from needlefit.metrics import list_metrics
from needlefit.reporting.figures import Drawing
from needlefit.reporting.figures import fit_forms as forms
from needlefit.reporting.number_format import format_bare_symbol, format_metric, format_quantity_range
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import to_records, to_tidy
from needlefit.schemas.run_metadata import FitMetadata
from needlefit.studies import fit_figures, fit_tables, track_report
from needlefit.studies import scored_groups as scores
from needlefit.studies.advice import (
    advise,
    classify_doubt,
    find_failures,
    list_contradictions,
    list_doubts,
    name_doubt,
)
from needlefit.studies.answer import Advice, Answer, Check, Finding, Status, Verdict
from needlefit.studies.fit_frames import find_scored_role, select_free
from needlefit.studies.fit_tables import TEXT
from needlefit.studies.identification_tables import lay_out_identification
from needlefit.studies.judge import CRPS, judge, limit_status, list_checks
from needlefit.studies.kinds.cross_validation.frames import FRAMES
from needlefit.studies.report import StudyReport, list_data_notes
from needlefit.studies.run import Run
from needlefit.studies.validity import FITTED_METHODS

__all__ = ["FRAMES", "REPORT"]

# ---- what the text prints


def collect_values(run: Run) -> dict[str, Any]:
    """Return what the text prints."""
    frames, stated = run.frames, run.knows(FitMetadata)
    role = find_scored_role(frames["errors"])
    folds, starts, errors = stated.folds, frames["starts"], frames["errors"]
    counts = sorted(len(fold.tune) for fold in folds)
    group = scores.pool_insertions(run, role)
    floors = {one: group.get(one.name, "floor") for one in list_metrics() if group is not None}
    return {
        "run": run,
        "frames": frames,
        "role": role,
        "compared_in": {1: "one plane", 2: "space"}[scores.count_directions(run)],
        "dataset": stated.dataset.name,
        "media": {
            "tune": list(dict.fromkeys(errors.loc[errors["role"] == "tune", "medium"])),
            "validate": list(
                dict.fromkeys(
                    [*errors.loc[errors["role"] == "validate", "medium"], *frames["runs"]["medium"]]
                )
            ),
        },
        "folds": len(folds),
        "held_out": len({one for fold in folds for one in fold.held_out}),
        "depths": {
            # the least and the greatest, one if they are printed alike
            str(name): list(dict.fromkeys(f"{one:.0f}" for one in (found.min(), found.max())))
            for name, found in errors[errors["method"] == "fitted"].groupby("role")["depth_mm"]
        },
        # the least and the greatest, one if they are equal
        "fitted_counts": list(dict.fromkeys(map(str, (*counts[:1], *counts[-1:])))),
        "tips": fit_figures.are_tips(run),
        "tracks": track_report.judge_errors(run) if track_report.holds_tracks(run) else None,
        "floors": [
            f"{one.label} {format_metric(one, floor, 3 if floor < 0.1 else 2)} {one.unit}"
            for one, floor in floors.items()
            if floor is not None and one.has_floor
        ],
        "no_bands": role == "validate" and not frames["draws"]["certified"].astype(bool).all(),
        "starts": len(starts),
        "agreeing": int(starts["within_tolerance"].astype(bool).sum()),
        "evaluations": int(starts["evaluations"].sum()),
        "failed": int(starts["failed_solves"].sum()),
        "computation": describe_computation(run),
        "population": fit_tables.list_spreads(run),
        "chains": fit_tables.tabulate_percentiles(run),
        "notes": list_data_notes(run),
        "rigidity": stated.dataset.rigidity,
        "contradictions": [name_doubt(kind) for kind in list_contradictions(run.warnings)],
    }


def describe_computation(run: Run) -> dict[str, Any]:
    """Return by what the parameters were found: searches of nlopt, and draws of the posterior."""
    starts, draws = run.frames["starts"], run.frames["draws"]
    recipe = run.knows(FitMetadata).recipe
    searched = starts[starts["fit"].isin(FITTED_METHODS)]
    weights = [(recipe.weights.ipe, "IPE"), (recipe.weights.te, "TE"), (recipe.weights.edp, "EDP")]
    errors = (f"{weight:g} {name}" if weight != 1 else name for weight, name in weights if weight)
    goals = {"posterior": "the posterior", "metric": " + ".join(errors)}
    source = "" if draws.empty else str(draws["draw_source"].iloc[0])
    return {
        "starts": int((searched["fit"] == "fitted").sum()),
        "evaluations": int(searched["evaluations"].sum()),
        "goals": [goals[name] for name in dict.fromkeys(searched["minimized"])],
        "source": source,
        "walkers": recipe.sample.walkers if source == "posterior" else None,
        "draws": None if draws.empty else int(draws["ess"].min()),
    }


# ---- the answer


def find_answer(run: Run) -> Answer:
    """Return the parts of the first page."""
    role, values = find_scored_role(run.frames["errors"]), collect_values(run)
    if track_report.holds_tracks(run):
        return track_report.find_track_answer(run, values)
    checks, group = list_checks(run, role), scores.pool_insertions(run, role)
    judged = None if group is None else judge(run, group)
    if group is None or judged is None:
        return Answer([Verdict(TEXT.sentence("nothing_scored", values), "fail")], checks=checks)
    determined, intervals = _list_determined(run)
    words = {
        **values,
        "judged": judged,
        "insertions": group.head["insertions"],
        "determined": determined,
        "intervals": intervals,
        "bevel": _name_free_bevel(run),
        "opening": "",
    }
    numbers: dict[str, float | str | None] = {
        "outcome": judged.outcome,
        scores.TE: judged.error_mm,
        f"floor_{scores.TE}": group.get(scores.TE, "floor"),
        "te_over_floor": judged.noise_ratio,
        "baseline": judged.curve or None,
        "baseline_te_mm": judged.curve_mm,
        "trials": judged.trials,
        "insertions": group.head["insertions"],
    }
    if role == "tune":
        words["opening"], status = _open_fit(run, [word for word, _ in determined])
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
    about, known = (TEXT.sentence(block, words) for block in ("about", "determined"))
    advice = find_advice(run, checks, [word for word, _ in determined])
    return Answer([Verdict(sentence, status, "", numbers)], [table], about, checks, advice, known)


def find_advice(run: Run, checks: Sequence[Finding], determined: Sequence[str]) -> Advice | None:
    """Return what to do: it follows from faults, checks and what the fit determined."""
    role, media = find_scored_role(run.frames["errors"]), collect_values(run)["media"]
    by_check = {one.check: one for one in checks}
    other = [name for name in media["validate"] if name not in media["tune"]]
    gain = run.frames["predictive"]["tip_95_width_after_one_mm"].astype(float).median()
    intervals, curves = by_check.get(Check.INTERVALS), by_check.get(Check.CURVES)
    doubts = list_doubts(run.warnings)[:1]
    found = ["predictable", *find_failures(by_check, other_medium=bool(other))]
    if role == "tune" and "curve_as_good" in found:
        found.remove("curve_as_good")  # curves were fitted to the same needles
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
        "curve": BASELINES[curves.named].description if curves and curves.named else "",
        "width": None if intervals is None else intervals.width_mm,
        "gain": None if pd.isna(gain) or intervals is None else float(gain),
    }
    return advise(found, values, run.name)


def _open_fit(run: Run, determined: Sequence[str]) -> tuple[str, Status]:
    """Return how the verdict on a fit begins, and its status."""
    checks = {one.check: one for one in list_checks(run, "tune")}
    if Check.CURVES in checks and checks[Check.CURVES].passed is False:
        return "Does not fit", "fail"
    if "parameter_at_bound" in checks[Check.DATA].named.split(", "):
        return "Fitted, but at a bound", "warn"
    if not run.reliable:
        return "Fitted, but not reliable", "warn"
    return (
        ("Fitted, but not all parameters are determined", "warn")
        if set(determined) - {"yes"}
        else ("Fitted", "pass")
    )


MAX_PRINTED_INTERVALS = 2  #: more determined parameters than these stand without their intervals


def _list_determined(run: Run) -> tuple[list[tuple[str, list[str]]], bool]:
    """Return the free parameters by whether the data determine them, and whether those have intervals."""
    rows = run.frames["parameters"]
    rows = rows[(rows["method"] == "fitted") & rows["status"].isin(["free", "tied"])]
    rows = rows[~rows["parameter"].isin(HYPERPARAMETERS)]
    words = {
        str(name): find_least_determined(map(str, some["determined"]))
        for name, some in rows.groupby("parameter", sort=False)
    }
    names = {name: format_bare_symbol(name) for name in words}
    known = rows[rows["parameter"].map(words) == "yes"].dropna(subset=["interval_low", "interval_high"])
    if shown := rows["fold"].nunique() == 1 and len(known) <= MAX_PRINTED_INTERVALS:
        for row in to_records(known):
            interval = format_quantity_range(row["parameter"], row["interval_low"], row["interval_high"])
            names[row["parameter"]] += f" {interval}"
    return list(group_values((words[name], label) for name, label in names.items()).items()), shown


def _name_free_bevel(run: Run) -> str:
    """Return the symbol of the bevel's parameter where it is free, else ""."""
    free = set(select_free(run.frames["parameters"])["parameter"])
    return next((format_bare_symbol(one) for one in ("bevel_mm", "cut_angle_deg") if one in free), "")


# ---- tables and figures


def lay_out_tables(run: Run) -> list[TableLayout]:
    """Return every table of a report, each once."""
    role, frames = find_scored_role(run.frames["errors"]), run.frames
    # the parameters of which more is to say than their interval
    known = frames["identification"]
    explained = known[(known["note"] != "") | known["tip_shift_mm"].notna()]
    found = [
        *([track_report.lay_out_tracks(run)] if track_report.holds_tracks(run) else []),
        fit_tables.lay_out_summary(run),
        fit_tables.lay_out_validation(run),
        *([fit_tables.lay_out_coverage(run)] if len(frames["predictive"]) else []),
        fit_tables.lay_out_baselines(run, role),
        fit_tables.lay_out_insertions(run, role),
        fit_tables.lay_out_parameters(run),
        *([lay_out_identification(explained)] if len(explained) else []),
        fit_tables.lay_out_chains(run),
        fit_tables.lay_out_tuning(run),
    ]
    return [table for table in found if table.rows]


def list_figures(run: Run) -> dict[str, Drawing]:
    """Return what the tables allow to be drawn."""
    role, frames = find_scored_role(run.frames["errors"]), run.frames
    found: dict[str, Drawing] = {}
    both = [frames[name] for name in ("errors", "shapes")]
    if fit_figures.are_tips(run):
        found["insertions"] = fit_figures.draw_tips(run, role)
    elif all(((one["role"] == role) & (one["method"] == "fitted")).any() for one in both):
        found["insertions"] = fit_figures.draw_first_page(run, role)
        for name in ("overlays", "overlays_above")[: scores.count_directions(run)]:
            found[name] = fit_figures.draw_overlays(run, role, from_above=name == "overlays_above")
    if len(frames["readings"]):
        found["readings"] = track_report.draw_tracks(run)
    if len(frames["predictive"]):
        found["predicted"] = fit_figures.draw_predictive_check(run)
    if len(frames["profiles"]):
        found["profiles"] = forms.draw_profiles(frames["identification"], frames["profiles"], run.origin)
    return found


# ---- files


def list_files(run: Run) -> dict[str, pd.DataFrame | str]:
    """Return the tables that are written as CSV, by name."""
    written: dict[str, pd.DataFrame] = {
        "validation": scores.tabulate_validation(run),
        "tuning": scores.tabulate_tuning(run),
        "parameters": run.frames["parameters"].assign(origin=run.origin),
        "identify": run.frames["identification"],
        "posterior": fit_tables.tabulate_percentiles(run),
    }
    if track_report.holds_tracks(run):
        written["methods"] = track_report.compare_methods_by_run(run.frames["runs"])
    names = ("predictive", "runs", "readings", "curvature", "error_fit", "population", "draws")
    written |= {name: run.frames[name] for name in names}
    found: dict[str, pd.DataFrame | str] = {
        name: run.frames[name] for name in ("errors", "shapes", "starts", "directions")
    }
    return found | {name: frame for name, frame in written.items() if len(frame)}


def fit_to_json(run: Run) -> dict[str, Any]:
    """Return the tables that are written as CSV, but for points and draws."""
    frames = {
        name: frame for name, frame in list_files(run).items() if name not in ("shapes", "draws", "readings")
    }
    return {name: to_records(to_tidy(one)) for name, one in frames.items() if isinstance(one, pd.DataFrame)}


REPORT = StudyReport(TEXT, collect_values, lay_out_tables, list_figures, find_answer, list_files, fit_to_json)
