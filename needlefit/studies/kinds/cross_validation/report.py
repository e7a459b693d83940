"""The report of a fit or cross-validation: the answer, what its text prints, and the files for a paper.

Tables are those of `studies/fit_tables.py`, figures of `studies/fit_figures.py`; the sentences stand in
`reporting/text/cross_validation.md.j2`.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from needlefit.grouping import group_values
from needlefit.inference.identifiability.directions import find_least_determined
from needlefit.metrics import list_metrics
from needlefit.reporting import labels
from needlefit.reporting.figures import Drawing
from needlefit.reporting.figures import fit_forms as forms
from needlefit.reporting.number_format import (
    format_bare_symbol,
    format_metric,
    format_quantity_range,
)
from needlefit.reporting.table import TableLayout
from needlefit.reporting.table_files import Row, format_csv, to_records, to_tidy
from needlefit.studies import fit_figures, fit_tables
from needlefit.studies import scored_groups as scores
from needlefit.studies.answer import Answer, Check, Status, Verdict
from needlefit.studies.fit_frames import COLUMNS as FRAMES
from needlefit.studies.fit_frames import find_scored_role, select_draws, select_free
from needlefit.studies.fit_tables import TEXT
from needlefit.studies.identification_tables import lay_out_identification
from needlefit.studies.judge import STATUS, Judgement, judge, list_checks
from needlefit.studies.report import StudyReport
from needlefit.studies.run import Run, once_per_run

__all__ = ["FRAMES", "REPORT"]

# ---- what the text prints


@once_per_run
def collect_values(results: Run) -> dict[str, Any]:
    """Return what the text prints."""
    run, frames, role = results.run, results.frames, find_scored_role(results.frames["errors"])
    folds = list(run.get("folds", ()))
    counts = sorted(len(fold["tune"]) for fold in folds)
    certified = frames["draws"]["certified"].astype(bool).all()
    by_metric = _minimises_errors(results)
    return {
        "results": results,
        "frames": frames,
        "role": role,
        "dataset": str(run.get("dataset", {}).get("name", results.dataset_title)),
        "media": {one: _list_media(frames["errors"], one) for one in ("tune", "validate")},
        "folds": len(folds),
        "held_out": len({one for fold in folds for one in fold["validate"]}),
        "depths": {
            str(name): [float(found.min()), float(found.max())]
            for name, found in frames["errors"].query("method == 'fitted'").groupby("role")["depth_mm"]
        },
        # the least and the greatest, one if they are equal
        "fitted_counts": list(dict.fromkeys(map(str, (*counts[:1], *counts[-1:])))),
        "floors": _list_floors(results, role),
        "by_metric": by_metric,
        "printed": any(group.printed for group in scores.list_held_out_groups(results)),
        "no_bands": not certified and role == "validate",
        "unconverged": any(posterior.faults for posterior in results.posteriors.values()),
        "draws_of_predictions": int(frames["predictive"]["draws"].max()) if len(frames["predictive"]) else 0,
        "failed": _count_failures(results),
        "starts": len(frames["starts"]),
        "agreeing": int(frames["starts"]["within_tolerance"].astype(bool).sum()),
        "drawn": _describe_draws(frames) if len(frames["draws"]) else {},
        "notes": list(map(str, run.get("dataset", {}).get("notes", ()))),
    }


def _list_media(errors: pd.DataFrame, role: str) -> list[str]:
    return list(dict.fromkeys(errors.loc[errors["role"] == role, "medium"]))


def _minimises_errors(results: Run) -> bool:
    """Return whether the fit minimises errors: by its recipe, or because the data state no noise."""
    starts = results.frames["starts"].query("fit == 'fitted'")
    stated = (results.run.get("recipe") or {}).get("minimize") == "metric"
    return stated or bool((starts["minimized"] == "metric").any())


def _list_floors(results: Run, role: str) -> list[str]:
    """Return each metric's noise floor; none where no noise is stated."""
    group = scores.pool_insertions(results, role)
    known = {one: None if group is None else group.get(one.name, "floor") for one in list_metrics()}
    return [
        f"{one.label} {format_metric(one, floor, 3 if floor < 0.1 else 2)} {one.unit}"
        for one, floor in known.items()
        if floor is not None and one.has_floor
    ]


def _count_failures(results: Run) -> Row:
    starts, failures = results.frames["starts"], results.frames["failures"]
    reasons = Counter(str(reason).partition(":")[0] for reason in failures["note"]).most_common()
    return {
        "searches": int(starts["failed_solves"].sum()),
        "evaluations": int(starts["evaluations"].sum()),
        "sampled": sum(posterior.failures for posterior in results.posteriors.values()),
        "recorded": len(failures),
        "reasons": ", ".join(f"{count} {reason}" for reason, count in reasons),
    }


def _describe_draws(frames: Mapping[str, pd.DataFrame]) -> Row:
    """Return source and convergence of the draws of the first fold."""
    draws = select_draws(frames["draws"])
    return {
        "count": len(draws),
        "source": str(draws["draw_source"].iloc[0]),
        "pareto_k": float(draws["pareto_k"].iloc[0]),
        "certified": bool(draws["certified"].iloc[0]),
        "folds": int(frames["draws"]["fold"].nunique()),
        "fold": str(draws["fold"].iloc[0]),
        # beside the mean and a new specimen each has draws of its own
        "separate": frames["draws"]["specimen"].nunique() > 2,
    }


# ---- the answer


def find_answer(results: Run) -> Answer:
    """Return the parts of the first page; of a study the verdict on each held-out group follows the first."""
    role, values = find_scored_role(results.frames["errors"]), collect_values(results)
    checks, group = list_checks(results, role), scores.pool_insertions(results, role)
    judged = None if group is None else judge(results, group)
    if group is None or judged is None:
        return Answer([Verdict(TEXT.sentence("nothing_scored", values), "fail")], checks=checks)
    words = {**values, "judged": judged, "checks": {str(one.check): one for one in checks}}
    gain = results.frames["predictive"]["tip_95_width_after_one_mm"].astype(float).median()
    words["gain"] = None if pd.isna(gain) else float(gain)
    words["determined"] = _list_determined(results)
    numbers = _collect_numbers(group, judged)
    if role == "tune":
        opening, status = _open_fit(results, [name for name, found in words["determined"] if found])
        words |= {"opening": opening, "insertions": group.head["insertions"]}
        numbers["not_determined"] = ", ".join(
            name for word, names in words["determined"] if word != "yes" for name in names
        )
        verdicts = [Verdict(TEXT.sentence("fitted", words), status, "", numbers)]
        tables = [fit_tables.lay_out_parameters(results)]
    else:
        groups = scores.list_held_out_groups(results)
        if len(groups) == 1:  # all insertions are those of the paper's row
            numbers["paper_te_mm"] = groups[0].get(scores.TE, "paper")
        verdicts = [Verdict(TEXT.sentence("predicted", words), STATUS[judged.outcome], "", numbers)]
        verdicts += _judge_groups(results, words)
        tables = [fit_tables.lay_out_summary(results)]
    return Answer(
        verdicts,
        tables,
        TEXT.sentence("about", words),
        checks,
        TEXT.sentence("advice", words),
        TEXT.sentence("determined", words),
    )


def _judge_groups(results: Run, values: Mapping[str, Any]) -> Iterator[Verdict]:
    """Yield the verdict on each held-out group, where there are several."""
    groups = scores.list_held_out_groups(results)
    media = [group.head["medium"] for group in groups]
    for group in groups if len(groups) > 1 else ():
        medium, layers = group.head["medium"], group.head["layers"]
        several = media.count(medium) > 1
        name = labels.group_name(medium, layers) if several else labels.medium_name(medium)
        if (judged := judge(results, group)) is None:
            yield Verdict(TEXT.sentence("nothing_scored", values), "fail", name)
            continue
        words = {**values, "judged": judged, "media": {**values["media"], "validate": [name]}}
        numbers = _collect_numbers(group, judged)
        yield Verdict(TEXT.sentence("predicted", words), STATUS[judged.outcome], name, numbers)


def _collect_numbers(group: scores.ScoredGroup, judged: Judgement) -> dict[str, float | str | None]:
    return {
        "outcome": judged.outcome,
        scores.TE: judged.error_mm,
        "floor_te_mm": group.get(scores.TE, "floor"),
        "te_over_floor": judged.noise_ratio,
        "baseline": judged.curve or None,
        "baseline_te_mm": judged.curve_mm,
        "paper_te_mm": group.get(scores.TE, "paper"),
        "insertions": group.head["insertions"],
    }


def _open_fit(results: Run, determined: Sequence[str]) -> tuple[str, Status]:
    """Return how the verdict on a fit begins, and its status."""
    checks = {one.check: one for one in list_checks(results, "tune")}
    if Check.CURVES in checks and checks[Check.CURVES].passed is False:
        return "Does not fit", "fail"
    if "parameter_at_bound" in checks[Check.DATA].named.split(", "):
        return "Fitted, but at a bound", "warn"
    if not results.reliable:
        return "Fitted, but not reliable", "warn"
    return ("Fitted in part", "warn") if set(determined) - {"yes"} else ("Fitted", "pass")


def _list_determined(results: Run) -> list[tuple[str, list[str]]]:
    """Return the free parameters by whether the data determine them; those that they do with intervals."""
    rows = results.frames["parameters"].query("method == 'fitted' and status != 'fixed'")
    several = rows["fold"].nunique() > 1
    pairs = []
    for name, some in rows.groupby("parameter", sort=False):
        word = find_least_determined(map(str, some["determined"]))
        low, high = (float(some[f"interval_{end}"].iloc[0]) for end in ("low", "high"))
        words = format_bare_symbol(str(name))
        if word == "yes" and not several and low == low:
            words = f"{words} {format_quantity_range(str(name), low, high)}"
        pairs.append((word, words))
    return list(group_values(pairs).items())


# ---- tables and figures


def lay_out_tables(results: Run) -> list[TableLayout]:
    """Return every table of a report, each once."""
    role, frames = find_scored_role(results.frames["errors"]), results.frames
    found = [
        fit_tables.lay_out_summary(results),
        fit_tables.lay_out_validation(results),
        *([fit_tables.lay_out_coverage(results)] if len(frames["predictive"]) else []),
        fit_tables.lay_out_baselines(results, role),
        fit_tables.lay_out_insertions(results, role),
        fit_tables.lay_out_parameters(results),
        *([fit_tables.lay_out_population(results)] if len(frames["population"]) else []),
        *([lay_out_identification(frames["identification"])] if len(frames["identification"]) else []),
        *([fit_tables.lay_out_posterior(results)] if results.posteriors else []),
        fit_tables.lay_out_design(results),
        fit_tables.lay_out_tuning(results),
    ]
    return [table for table in found if table.rows]


def list_figures(results: Run) -> dict[str, Drawing]:
    """Return what the tables allow to be drawn."""
    role, frames = find_scored_role(results.frames["errors"]), results.frames
    found: dict[str, Drawing] = {}
    both = [frames[name] for name in ("errors", "shapes")]
    if all(((one["role"] == role) & (one["method"] == "fitted")).any() for one in both):
        found["insertions"] = fit_figures.draw_first_page(results, role)
        found["overlays"] = fit_figures.draw_overlays(results, role)
    if len(frames["predictive"]):
        found["predicted"] = fit_figures.draw_predictive_check(results)
    if len(frames["draws"]) and len(select_free(frames["parameters"])):
        found["corner"] = fit_figures.draw_corner(results)
    if len(frames["profiles"]):
        found["profiles"] = forms.draw_profiles(frames["identification"], frames["profiles"], results.origin)
    return found


# ---- files


def list_files(result: Run) -> dict[str, pd.DataFrame | str]:
    """Return the tables that are written as CSV, by name, and the numbers and methods for a paper."""
    names = ("design", "errors", "shapes", "starts", "directions")
    found: dict[str, pd.DataFrame | str] = {name: result.frames[name] for name in names}
    found |= {
        name: result.frames[name]
        for name in ("predictive", "error_fit", "population")
        if len(result.frames[name])
    }
    written = {
        "validation": scores.tabulate_validation(result),
        "tuning": scores.tabulate_tuning(result),
        "parameters": fit_tables.tabulate_parameters(result),
    }
    found |= {name: frame for name, frame in written.items() if len(frame)}
    if len(result.frames["identification"]):
        found["identify"] = result.frames["identification"]
    if result.posteriors:
        found["posterior"] = fit_tables.tabulate_percentiles(result)
    # with every digit: it is exactly these values that fail again
    found["failures.csv"] = format_csv(result.frames["failures"].assign(origin=result.origin), digits=None)
    return found


def fit_to_json(result: Run) -> dict[str, Any]:
    """Return the errors beside the paper's; of a fit also its parameters, starts and what they determine."""
    frames = {"validation": scores.tabulate_validation(result)}
    if result.kind == "fit":
        names = ("errors", "starts", "failures", "error_fit", "directions", "identification", "profiles")
        frames = {
            "parameters": fit_tables.tabulate_parameters(result),
            **{name: result.frames[name] for name in names},
        }
        if result.posteriors:
            frames["posterior"] = fit_tables.tabulate_percentiles(result)
    return {name: to_records(to_tidy(frame)) for name, frame in frames.items()}


REPORT = StudyReport(TEXT, collect_values, lay_out_tables, list_figures, find_answer, list_files, fit_to_json)
