"""The tables of a fit or cross-validation as data: rows and columns; captions and notes stand in the text."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from needlefit.inference.parameters import HYPERPARAMETERS
from needlefit.inference.sampling.posterior import PERCENTILES
from needlefit.metrics import Metric, headline_metrics, list_metrics
from needlefit.reporting.columns import DIGITS
from needlefit.reporting.labels import SPECIMEN_NAMES, method_name, study_name
from needlefit.reporting.number_format import (
    NO_INTERVAL,
    choose_interval_unit,
    choose_printed_unit,
    format_bare_symbol,
    format_interval,
    format_metric,
    format_number,
    format_quantity,
    format_quantity_range,
    insert_symbols,
    typeset,
    typeset_interval,
)
from needlefit.reporting.table import Table, TableLayout, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.text import KindText
from needlefit.studies.coverage import COVERAGE_COLUMNS, count_covered, tabulate_coverage
from needlefit.studies.fit_warnings import describe_gain
from needlefit.studies.kinds.cross_validation.posterior import tabulate_percentiles
from needlefit.studies.paper.claims import Claim
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import (
    BY_LAYERS,
    BY_MEDIA,
    HELD_OUT,
    TE,
    ScoredGroup,
    compare_parameter_row,
    find_best_baseline,
    list_groups,
    list_held_out_groups,
    select_group,
    study_label,
    tabulate_tuning,
)
from needlefit.studies.summary import compare_methods

TEXT = KindText("cross_validation")


def _lay_out(table: Table, drop_empty: bool = False, **values: object) -> TableLayout:
    return TEXT.lay_out(table, values, drop_empty)


# ---- errors by group: ours above the paper's, one column per quantity


@dataclass(frozen=True)
class _RowKind:
    """A kind of row in a table of errors: its name, and where its numbers stand in a `ScoredGroup`."""

    name: str
    method: str = "fitted"
    boundaries: str = "measured"
    column: str = "value"


_FITTED, _POOLED = _RowKind("posterior-mode fit"), _RowKind("pooled", column="pooled")
_FLOOR, _PAPER = _RowKind("noise floor", column="floor"), _RowKind("paper", column="paper")
_HELD_OUT_KINDS = (
    _FITTED,
    _RowKind("error-minimising fit", method="fitted_metric"),
    _RowKind("planned layer depths", boundaries="planned"),
    _POOLED,
)
_REGROUPED_KINDS = (_FITTED, _POOLED)
"""The kinds of rows given of groups fitted to, and by the alternative count."""

_ALTERNATE_MARK = "‡"
_ROLE_NAMES = {"tune": "tunes", "validate": "validates"}


def lay_out_validation(results: Sequence[Run]) -> TableLayout:
    """Return the validation table by held-out group: ours, with planned depths, noise floor, paper."""
    return _lay_out_groups("validation", list_held_out_groups(*results, with_alternate=True), _HELD_OUT_KINDS)


def lay_out_tuning(results: Sequence[Run], grouping: str) -> TableLayout:
    """Return the in-sample errors by `grouping` ("layers" or "media"), beside the paper's tuned models."""
    table = tabulate_tuning(*results, with_alternate=True)
    groups = list_groups(table[table["grouping"] == grouping])
    return _lay_out_groups(f"tuning_by_{grouping}", groups, _REGROUPED_KINDS)


def lay_out_all_errors(results: Run) -> TableLayout:
    """Return all metrics of held-out and tuning insertions; by media where the paper has a cell."""
    tuned = list_groups(tabulate_tuning(results))
    printed = any(one.printed for one in tuned if one.head["grouping"] == BY_MEDIA)
    shown = [group for group in tuned if printed or group.head["grouping"] == BY_LAYERS]
    kinds = [kind for kind in _HELD_OUT_KINDS if kind is not _POOLED]
    return _lay_out_groups("all_errors", [*list_held_out_groups(results), *shown], kinds, compared=False)


def _lay_out_groups(
    name: str, groups: Sequence[ScoredGroup], kinds: Sequence[_RowKind], compared: bool = True
) -> TableLayout:
    """Return one block of rows per group; only its first row names the group.

    With `compared`, notes say what makes each group comparable to the paper's, or not.
    """
    rows: list[Row] = []
    same: dict[str, list[Row]] = {}
    for number, group in enumerate(groups):
        held_out = group.head["grouping"] == HELD_OUT
        about = {"role": _ROLE_NAMES["validate" if held_out else "tune"], "number": number}
        own = [kind for kind in kinds if held_out or kind in _REGROUPED_KINDS]
        own = [kind for kind in own if not group.head["alternate_count"] or kind in _REGROUPED_KINDS]
        rows += [{**_head(group), **row, **about} for row in _list_rows(group, (*own, _FLOOR, _PAPER))]
        if group.printed:
            same.setdefault(str(group.head["comparable"]), []).append(_head(group))
    several = len({row["role"] for row in rows}) > 1
    heads = ("study", *(("role",) if several else ()), "medium", "layers", "insertions")
    columns = (
        *(*heads, "row"),
        *(part("metric_value", metric=one.name) for one in list_metrics() if not one.spread_of),
        *(part("over_floor", metric=one.name) for one in headline_metrics() if one.has_floor),
    )
    lines = pivot(rows, ["number", "row"], ["metric"])
    table = Table(name, "", lines, columns, groups=("number",), heads=len(heads), strong="groups")
    names = {row["row"] for row in rows}
    values: dict[str, Any] = {
        "compared": compared,
        "comparisons": list(same.items()),
        "groups": list(map(_head, groups)),
    }
    return _lay_out(table, rows=names, **values)


def lay_out_summary(results: Sequence[Run]) -> TableLayout:
    """Return the table of the first page: our fit, the best baseline, noise floor and paper, by group.

    Groups are those held out, or of runs without any those fitted to.
    """
    groups = [group for one in results for group in _groups_of(one)]
    rows: list[Row] = []
    for number, group in enumerate(groups):
        best = find_best_baseline(group)
        kinds = (_FITTED, *([_RowKind(method_name(best), method=best)] if best else []), _FLOOR, _PAPER)
        rows += [{**_head(group), **row, "number": number} for row in _list_rows(group, kinds)]
    shown = [metric for metric in list_metrics() if metric.headline or metric.relative]
    columns = (
        *("study", "medium", "layers", "insertions", "row"),
        *(part("metric_value", metric=one.name) for one in shown),
        *(part("over_floor", metric=one.name) for one in headline_metrics() if one.has_floor),
    )
    lines = pivot(rows, ["number", "row"], ["metric"])
    table = Table("summary", "", lines, columns, groups=("number",), heads=4, strong="groups")
    values: dict[str, Any] = {
        "held_out": any(group.head["grouping"] == HELD_OUT for group in groups),
        "metrics": [f"{one.label}: {one.explanation.partition(': ')[2] or one.explanation}" for one in shown],
        "marked": any(row["mark"] for row in rows),
    }
    return _lay_out(table, groups=list(map(_head, groups)), **values)


def _groups_of(results: Run) -> list[ScoredGroup]:
    tuning = tabulate_tuning(results)
    return list_held_out_groups(results) or list_groups(tuning[tuning["grouping"] == BY_LAYERS])


def _list_rows(group: ScoredGroup, kinds: Sequence[_RowKind]) -> Iterator[Row]:
    """Yield a row per kind and metric, of kinds that have any value."""
    for kind in kinds:
        found = [_describe_score(group, kind, metric) for metric in list_metrics()]
        if any(row["value"] is not None for row in found):
            yield from found


def _describe_score(group: ScoredGroup, kind: _RowKind, metric: Metric) -> Row:
    where = {"column": kind.column, "method": kind.method, "boundaries": kind.boundaries}
    digits = 3 if group.head["comparison"] == "aligned" and kind is not _PAPER else 2
    value = group.get(metric.name, **where)
    spread = next((one for one in list_metrics() if one.spread_of == metric.name), None)
    flagged = metric.relative and group.head["edp_flagged"] and kind is not _PAPER and value is not None
    known = kind not in (_FLOOR, _PAPER)
    return {
        **{"row": kind.name, "metric": metric.name, "value": value, "mark": "†" if flagged else ""},
        "spread": spread and group.get(spread.name, **where),
        "over_floor": group.over_floor(metric.name, **where) if known else None,
        DIGITS: digits,
    }


def _head(group: ScoredGroup) -> Row:
    count = str(group.head["layers"] or "all")
    mark = _ALTERNATE_MARK if group.head["alternate_count"] else ""
    about = {"count": count, "layers": count + mark, "printed": group.printed}
    return {**group.head, **about, "unflagged_edp": group.get("edp_percent", "unflagged")}


def lay_out_matrix(results: Sequence[Run], judge: Callable[[Run], Sequence[Any]]) -> TableLayout:
    """Return one row per study and held-out group: its verdict, its tip error and what this compares with."""
    rows: list[Row] = []
    for one in results:
        for group, verdict in zip(list_held_out_groups(one), judge(one), strict=False):
            best = find_best_baseline(group)
            predictive = select_group(one.frames["predictive"], group)
            covered = count_covered(predictive, "tip_in_95") if len(predictive) else None
            rows.append(
                {
                    **_head(group),
                    "verdict": verdict.status,
                    "te_mm": group.get(TE),
                    "floor_te_mm": group.get(TE, "floor"),
                    "baseline_te_mm": None if best is None else group.get(TE, method=best),
                    "baseline_method": best or "",
                    "paper_te_mm": group.get(TE, "paper"),
                    "floor_ratio": group.over_floor(TE),
                    "tip_in_95": f"{covered.hits} of {covered.trials}" if covered else None,
                }
            )
    columns = (
        *("study", "medium", "layers", "insertions", "te_mm", "floor_te_mm", "floor_ratio"),
        *("baseline_te_mm", "baseline_method", "tip_in_95", "paper_te_mm", "verdict"),
    )
    return _lay_out(Table("matrix", "", rows, columns, groups=("study",), heads=1))


def lay_out_design(results: Sequence[Run]) -> TableLayout:
    """Return which insertions tune and validate: counts, ranges of depth and measured deflection."""
    rows = []
    for one in results:
        for row in to_records(one.frames["design"]):
            other = "" if row["insertions"] == row["insertions_other"] else row["insertions_other"]
            about = {"study": study_label(one), "role": _ROLE_NAMES[row["role"]], "origin": one.origin}
            rows.append({**row, **about, "insertions_other": other})
    columns = (
        *("study", "role", "medium", "layers", "insertions", "insertions_other"),
        *("depth_range_mm", "deflection_range_mm"),
    )
    table = Table("design", "", rows, columns, groups=("study",), heads=1)
    return _lay_out(table, drop_empty=True, both_counts=any(row["insertions_other"] for row in rows))


_COVERAGE_GROUPS = ("study", "medium", "layers", "specimen_treatment")


def lay_out_coverage(*results: Run, named: bool = False) -> TableLayout:
    """Return one row per study (named if wanted), medium, number of layers and specimen, over all folds."""
    frames = [
        one.frames[name].assign(study=study_label(one))
        for one in results
        for name in ("predictive", "predictive_training")
    ]
    predicted = pd.concat([frame for frame in frames if len(frame)])
    rows = [
        {
            **dict(zip(_COVERAGE_GROUPS[:-1], key[:-1], strict=True)),
            "specimen_treatment": SPECIMEN_NAMES[str(key[-1])],
            **tabulate_coverage(group),
        }
        for key, group in predicted.groupby(list(_COVERAGE_GROUPS), sort=False)
    ]
    columns = (*_COVERAGE_GROUPS[not named :], *COVERAGE_COLUMNS)
    other = predicted[predicted["specimen_treatment"] == "others"]
    spread = {
        **{name: math.exp(other[f"between_sd_ln_{name}"].mean()) for name in ("mu", "b")},
        "specimens": int(other["other_specimens"].min()) if len(other) else 0,
    }
    gains = [
        {"study": study_name(group["study"].iloc[0]), "medium": str(medium), "gain": describe_gain(group)}
        for (_, medium), group in other.groupby(["study", "medium"], sort=False)
        if other["tip_95_width_after_one_mm"].notna().any()
    ]
    table = Table("coverage", "", rows, columns, groups=_COVERAGE_GROUPS[:1], heads=named)
    sources = [str(source) for source in pd.unique(predicted["draw_source"])]
    return _lay_out(table, sources=sources, spread=spread if len(other) else None, gains=gains)


def lay_out_baselines(results: Sequence[Run], role: str) -> TableLayout:
    """Return every method's errors and its paired difference from the fit on the same insertions."""
    rows = [row for one in results for row in _describe_methods(one, role)]
    errors = (one.name for one in headline_metrics())
    columns = ("study", "method", "insertions", *errors, "te_difference", "better_of")
    table = Table("baselines", "", rows, columns, groups=("study",), heads=1, strong="groups")
    return _lay_out(table, role=role)


def _describe_methods(results: Run, role: str) -> Iterator[Row]:
    digits = 3 if (results.frames["errors"]["comparison"] == "aligned").any() else 2
    for row in to_records(compare_methods(results, role=role, metric=TE)):
        ours = {"difference_mm": None, "better": ""} if row["method"] == "fitted" else {}
        name = method_name(row["method"], results.origin)
        about = {"study": study_label(results), "method": name, "origin": results.origin, DIGITS: digits}
        yield {**row, **ours, **about}


def lay_out_insertions(results: Run, role: str) -> TableLayout:
    """Return the fitted model's errors on single insertions beside their noise floor."""
    wanted = results.frames["errors"].query(
        "role == @role and method == 'fitted' and boundaries == 'measured'"
    )
    rows = [{**_describe_insertion(row), "origin": results.origin} for row in to_records(wanted)]
    columns = (
        *("insertion", "medium", "layers", "depth_mm", "deflection_mm", "predicted_deflection_mm"),
        *(one.name for one in list_metrics() if not one.spread_of),
        *(f"floor_{one.name}" for one in headline_metrics() if one.has_floor),
    )
    return _lay_out(Table("insertions", "", rows, columns))


def _describe_insertion(row: Row) -> Row:
    digits = 3 if row["comparison"] == "aligned" else 2
    scores = {one.name: row.get(one.name) for one in list_metrics()}
    floors = {f"floor_{one.name}": row.get(f"floor_{one.name}") for one in headline_metrics()}
    flagged = {
        one.name: f"{format_metric(one, scores[one.name])}†"
        for one in list_metrics()
        if one.relative and row["edp_flagged"]
    }
    name = str(row["insertion"]) + ("" if row["converged"] else " (did not converge)")
    return {**row, **scores, **floors, **flagged, "insertion": name, DIGITS: digits}


def lay_out_contradictions(claims: Sequence[Claim]) -> TableLayout:
    """Return the contradictions in the paper, both places side by side."""
    rows = [
        {
            **{"topic": one.topic, "note": one.note, "number": number},
            "statement": f"{one.place}: {one.statement}",
            "other_statement": f"{one.other_place}: {one.other_statement}",
        }
        for number, one in enumerate(claims)
    ]
    columns = ("topic", "statement", "other_statement", "note")
    return _lay_out(Table("contradictions", "", rows, columns, groups=("number",)))


# ---- parameters: ours beside the paper's

NOT_DETERMINED, CONDITIONAL = "not determined", "conditional"
"""In files in place of a value: the data do not determine it, or only under an assumption."""

SEE_INTERVAL, WIDE_INTERVAL = "see interval", "most of the bounds"
"""Printed for these: the data are compatible with the whole interval; it spans most of the bounds."""

_SEARCHED_STATUSES = ("free", "tied")
_PARAMETER_COLUMNS = (
    *("study", "medium", "fold", "parameter", "method", "value", "value_used"),
    *("determined", "condition", "status"),
    *("sd", "interval_low", "interval_high", "draw_source"),
    *("low", "high", "bound_low", "bound_high", "note", "comparable", "origin"),
)
METHODS = ("fitted", "fitted_metric", "hand_tuned", "hand_tuned_b")
"""The fit, the second fit to IPE, TE and EDP, the paper's set, and that set with b alone re-tuned."""


def tabulate_parameters(*results: Run) -> pd.DataFrame:
    """Return one row per study, fold, parameter and method.

    `value` is as printed: a parameter that the data cannot determine reads "not determined", one that they
    determine only under an assumption "conditional", in both fits alike. `value_used` is the number that the
    predictions were made with; where `determined` is false it is one of many that do as well, and no
    estimate. `sd` is of ln for moduli and lengths, of the value for alpha; it stands where errors have their
    noise floor, for of a parameter there is none. `comparable` says what makes ours and the paper's
    comparable or not.
    """
    rows = [row for one in results for row in _parameter_rows(one)]
    return pd.DataFrame(rows, columns=list(_PARAMETER_COLUMNS))


def _parameter_rows(results: Run) -> Iterator[Row]:
    rows = to_records(results.frames["parameters"])
    fitted = {(row["fold"], row["parameter"]): row for row in rows if row["method"] == "fitted"}
    published = {(r["fold"], r["parameter"]) for r in rows if r["method"] == "hand_tuned"}
    about = {"study": study_label(results), "medium": results.record.medium, "origin": results.origin}
    for row in rows:
        key = (row["fold"], row["parameter"])
        if row["method"] == "fitted_metric" and row["parameter"] in HYPERPARAMETERS:
            continue  # of the likelihood: errors do not depend on them
        judge = fitted[key] if row["method"] in ("fitted", "fitted_metric") else row
        judged = {**row, "determined": bool(judge["determined"]), "condition": judge["condition"]}
        loose = row["status"] in _SEARCHED_STATUSES and not judged["determined"]
        word = CONDITIONAL if is_conditional(judged) else NOT_DETERMINED
        value = word if loose else format_number(row["value"])
        comparable = compare_parameter_row(results, key in published)
        yield {**about, **judged, "value": value, "value_used": row["value"], "comparable": comparable}


def arrange_parameters(table: pd.DataFrame) -> list[Row]:
    """Return one row per study, fold and parameter: the fit's, with the printed value of each method."""
    rows: dict[tuple[object, ...], Row] = {}
    for row in to_records(table):
        key = (row["study"], row["fold"], row["parameter"])
        if row["method"] == "fitted":
            rows[key] = {**row, **dict.fromkeys(METHODS, "")}
        if key in rows:
            rows[key][row["method"]] = row["value"]
    return list(rows.values())


def find_undetermined(results: Run) -> list[str]:
    """Return the estimated parameters that some fold could not determine, in the order of the model."""
    return _find_parameters(
        results, lambda row: row["status"] in _SEARCHED_STATUSES and not row["determined"]
    )


def find_conditional(results: Run) -> list[str]:
    """Return those of `find_undetermined` that are determined under an assumption, in every fold."""
    loose = _find_parameters(results, lambda row: not row["determined"] and not is_conditional(row))
    return [name for name in find_undetermined(results) if name not in loose]


def is_conditional(row: Row) -> bool:
    """Return whether a parameter is determined only under an assumption."""
    return bool(row["condition"])


def find_fixed(results: Run) -> list[str]:
    """Return the parameters that were given, not estimated, in the order of the model."""
    return _find_parameters(results, lambda row: row["status"] == "fixed")


def _find_parameters(results: Run, wanted: Callable[[Row], bool]) -> list[str]:
    rows = to_records(results.frames["parameters"])
    found = (row for row in rows if row["method"] == "fitted" and wanted(row))
    return list(dict.fromkeys(str(row["parameter"]) for row in found))


def lay_out_parameters(results: Sequence[Run]) -> TableLayout:
    """Return both fits beside the paper's parameters, and beside these with b re-fitted."""
    return _lay_out_parameter_rows(results, arrange_parameters(tabulate_parameters(*results)))


def lay_out_free_parameters(results: Sequence[Run]) -> TableLayout:
    """Return the free parameters of several studies in one table, without notes."""
    rows = arrange_parameters(tabulate_parameters(*results))
    return _lay_out_parameter_rows(results, [row for row in rows if row["status"] == "free"], noted=False)


def _lay_out_parameter_rows(results: Sequence[Run], table: list[Row], noted: bool = True) -> TableLayout:
    folds = len({row["fold"] for row in table}) > 1
    truths = {study_label(one): one.run.get("truth", {}) for one in results}
    rows = []
    for number, row in enumerate(table):
        named = not number or row["study"] != table[number - 1]["study"]
        about = {
            "group": (row["study"], row["fold"]),
            "study": row["study"] if named else "",
            "fold": row["fold"] if folds else "",
        }
        truth = truths[row["study"]].get(row["parameter"])
        rows.append({**row, **_parameter_cells(row, truth), **about})
    columns = (
        *("study", "fold", "parameter", "fitted", "interval_95", "true_value", *METHODS[1:]),
        *(("note",) if noted else ()),
    )
    printed = any(row["hand_tuned"] for row in table)
    compared = list(dict.fromkeys(str(row["comparable"]) for row in table if row["hand_tuned"]))
    values = {
        "printed": printed,
        "metric": any(row["fitted_metric"] for row in table),
        "truth": any(row["true_value"] for row in rows),
        "comparable": compared,
    }
    found = Table("parameters", "", rows, columns, groups=("group",), heads=2)
    return _lay_out(found, drop_empty=True, **values)


_NOT_DETERMINED_PREFIX = re.compile(r"^not determined(?:[:;] | \(([^()]*)\)|$)")
"""Of notes: the column "Fitted" says it."""


def _parameter_cells(row: Row, truth: float | None) -> Row:
    label, unit = choose_interval_unit(row, row["value_used"])
    interval = typeset_interval(row, unit)
    note = _NOT_DETERMINED_PREFIX.sub(lambda found: found[1] or "", str(row["note"] or ""))
    status = "" if row["status"] == "free" or str(row["status"]) in str(row["note"]) else str(row["status"])
    return {
        "parameter": label,
        "interval_95": WIDE_INTERVAL if interval == NO_INTERVAL else interval,
        "true_value": "" if truth is None else typeset(format_number(truth / unit)),
        **{method: format_in_unit(row[method], unit) for method in METHODS},
        "note": "; ".join(words for words in (status, insert_symbols(note)) if words),
    }


def format_in_unit(text: str, unit: float) -> str:
    """Return a value of the files in another unit; of what is not determined the interval says more."""
    if text == NOT_DETERMINED:
        return SEE_INTERVAL
    return typeset(text if unit == 1 or text in ("", CONDITIONAL) else format_number(float(text) / unit))


def lay_out_values(results: Run) -> TableLayout:
    """Return the fitted parameters, each with one 95 % interval; of several folds their range."""
    every = to_records(results.frames["parameters"])
    rows = [row for row in every if row["method"] == "fitted"]
    published = {row["parameter"]: row["value"] for row in every if row["method"] == "hand_tuned"}
    names = list(dict.fromkeys(str(row["parameter"]) for row in rows))
    cells = [
        {
            **_describe_parameter(name, [row for row in rows if row["parameter"] == name]),
            "true_value": format_quantity(name, results.run.get("truth", {}).get(name)),
            "hand_tuned": format_quantity(name, published.get(name)),
        }
        for name in names
    ]
    columns = ("parameter", "fitted", "interval_95", "true_value", "hand_tuned", "note")
    fitted = {cell["fitted"] for cell in cells}
    values = {"conditional": CONDITIONAL in fitted, "loose": SEE_INTERVAL in fitted}
    folds = int(results.frames["parameters"]["fold"].nunique())
    return _lay_out(Table("values", "", cells, columns), drop_empty=True, folds=folds, **values)


def _describe_parameter(name: str, rows: list[Row]) -> Row:
    """Return the cells of a parameter; a value that the data do not determine is none."""
    fixed, values = rows[0]["status"] == "fixed", [row["value"] for row in rows if row["value"] is not None]
    fitted = format_quantity_range(name, min(values), max(values)) if values else ""
    loose = [] if fixed else [one for one in rows if not one["determined"]]
    conditions = {}
    if loose and all(map(is_conditional, loose)):
        conditions = dict.fromkeys(str(one["condition"]) for one in loose)
    interval, texts = "", [] if fixed else [format_interval(one) for one in rows]
    if NO_INTERVAL in texts:
        interval = WIDE_INTERVAL
    elif texts and "" not in texts:
        lows, highs = ([one[f"interval_{end}"] for one in rows] for end in ("low", "high"))
        interval = format_quantity_range(name, min(lows), max(highs))
    return {
        "parameter": format_bare_symbol(name),
        "fitted": fitted if not loose else CONDITIONAL if conditions else SEE_INTERVAL,
        "interval_95": interval,
        "note": "fixed" if fixed else "; ".join(conditions),
    }


def lay_out_directions(results: Run) -> TableLayout:
    """Return the combinations of parameters that the data determine, and how well."""
    rows = to_records(results.frames["directions"])
    folds = len({row["fold"] for row in rows}) > 1
    cells = [
        {"fold": row["fold"] if folds else "", "known_combination": insert_symbols(str(row["note"]))}
        for row in rows
    ]
    return _lay_out(Table("directions", "", cells, ("fold", "known_combination")), drop_empty=True)


def lay_out_posterior(results: Run) -> TableLayout:
    """Return the percentiles beside the fitted value."""
    parameters = to_records(results.frames["parameters"])
    fitted = {(str(r["fold"]), str(r["parameter"])): r for r in parameters if r["method"] == "fitted"}
    several = len(results.posteriors) > 1
    rows = [
        {
            **_scale_percentiles(row),
            **_mark_fit(row, fitted),
            "fold": row["fold"] if several else "",
            "state": "" if row["converged"] else "NOT CONVERGED",
        }
        for row in to_records(tabulate_percentiles(results))
    ]
    percentiles = (f"p{percentile:g}" for percentile in PERCENTILES)
    columns = ("fold", "parameter", *percentiles, "fit_value", "r_hat", "state")
    unconverged = any(posterior.faults for posterior in results.posteriors.values())
    values = {"unconverged": unconverged, "marked": any(row["mark"] for row in rows)}
    return _lay_out(Table("posterior", "", rows, columns), drop_empty=True, **values)


def _scale_percentiles(row: Row) -> Row:
    """Return a row with its label and values in the unit in which they are printed."""
    columns = [*(f"p{percentile:g}" for percentile in PERCENTILES), "fit_value_used"]
    label, unit = choose_printed_unit(str(row["parameter"]), [row[name] for name in columns[:-1]])
    scaled = {name: None if row[name] is None else row[name] / unit for name in columns}
    return {**row, **scaled, "parameter": label}


def _mark_fit(row: Row, fitted: Mapping[tuple[str, str], Row]) -> Row:
    if row["determined"] is False:
        conditional = is_conditional(fitted[str(row["fold"]), str(row["parameter"])])
        return {"fit_value_used": CONDITIONAL if conditional else SEE_INTERVAL, "mark": ""}
    return {"mark": "‡" if row["fit_in_central_95"] is False else ""}
