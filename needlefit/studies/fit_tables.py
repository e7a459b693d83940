"""The tables of fits and cross-validations, of one run or of several; captions stand in the text."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from needlefit.grouping import group_values
from needlefit.inference.identifiability.directions import (
    MAX_LOG_SD,
    UNINFORMED_SD_RATIO,
    find_least_determined,
)
from needlefit.inference.parameters import HYPERPARAMETERS
from needlefit.inference.sampling.posterior import PERCENTILES
from needlefit.metrics import Metric, headline_metrics, list_metrics
from needlefit.reporting import latex
from needlefit.reporting.columns import DIGITS, METRIC_FORMAT, find_column, format_value
from needlefit.reporting.labels import SPECIMEN_NAMES, method_name, study_name
from needlefit.reporting.number_format import (
    choose_interval_unit,
    choose_printed_unit,
    format_bare_symbol,
    format_metric,
    format_number,
    format_plain,
    insert_symbols,
    is_known,
    round_significant,
    typeset,
    typeset_interval,
)
from needlefit.reporting.table import Table, TableLayout, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.text import KindText
from needlefit.studies import scored_groups as scores
from needlefit.studies.coverage import COVERAGE_COLUMNS, tabulate_coverage
from needlefit.studies.fit_frames import (
    MEDIAN_METHOD,
    MODEL_METHODS,
    NEW_SPECIMEN,
    TUNED_SPECIMENS,
    select_fitted,
    select_free,
)
from needlefit.studies.identification_tables import describe_evidence
from needlefit.studies.judge import choose_method, find_closest_curve, judge
from needlefit.studies.run import Run

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


_FITTED = _RowKind("posterior-mode fit")
_FLOOR, _PAPER = _RowKind("noise floor", column="floor"), _RowKind("paper", column="paper")
_HELD_OUT_KINDS = (
    _FITTED,
    _RowKind("predictive median", method=MEDIAN_METHOD),
    _RowKind("error-minimising fit", method="fitted_metric"),
    _RowKind("planned layer depths", boundaries="planned"),
)

_ROLE_NAMES = {"tune": "tunes", "validate": "validates"}


def lay_out_validation(results: Sequence[Run]) -> TableLayout:
    """Return the validation table by held-out group: ours, with planned depths, noise floor, paper."""
    return _lay_out_groups("validation", scores.list_held_out_groups(*results), _HELD_OUT_KINDS)


def lay_out_tuning(results: Sequence[Run]) -> list[TableLayout]:
    """Return the in-sample errors by layers; by media too where the paper has a cell."""
    groups = scores.list_groups(scores.tabulate_tuning(*results))
    by = {
        which: [one for one in groups if one.head["grouping"] == which]
        for which in (scores.BY_LAYERS, scores.BY_MEDIA)
    }
    return [
        _lay_out_groups(f"tuning_by_{which}", some, (_FITTED,))
        for which, some in by.items()
        if some and (which == scores.BY_LAYERS or any(one.printed for one in some))
    ]


def _lay_out_groups(
    name: str, groups: Sequence[scores.ScoredGroup], kinds: Sequence[_RowKind]
) -> TableLayout:
    """Return one block of rows per group; only its first row names the group.

    Notes say what makes each group comparable to the paper's, or not.
    """
    rows: list[Row] = []
    for number, group in enumerate(groups):
        found = _list_rows(group, (*kinds, _FLOOR, _PAPER))
        rows += [{**_head(group), **row, "number": number} for row in found]
    heads = ("study", "medium", "layers", "insertions")
    table = _make_table(name, rows, heads, (one for one in list_metrics() if not one.spread_of))
    same = group_values((str(one.head["comparable"]), _head(one)) for one in groups if one.printed)
    names = {row["row"] for row in rows}
    return _lay_out(table, rows=names, groups=list(map(_head, groups)), comparisons=list(same.items()))


def _make_table(name: str, rows: Sequence[Row], heads: Sequence[str], metrics: Iterable[Metric]) -> Table:
    """Return a table of errors by group, whose `number` each row has; `heads` name the group."""
    columns = (
        *(*heads, "row"),
        *(part("metric_value", metric=one.name) for one in metrics),
        *(part("over_floor", metric=one.name) for one in headline_metrics() if one.has_floor),
    )
    lines = pivot(rows, ["number", "row"], ["metric"])
    return Table(name, lines, columns, groups=("number",), heads=len(heads), strong="groups")


def lay_out_summary(*results: Run) -> TableLayout:
    """Return the table of the first page: our errors, the closest curve's and the paper's, by group.

    Groups are those held out, or of runs without any those fitted to. The paper's parameters are scored on
    our data; its result is of its own needles.
    """
    groups = list[tuple[scores.ScoredGroup, str]]()
    for one in results:
        held_out = scores.list_held_out_groups(one)
        tuning = None if held_out else scores.tabulate_tuning(one)
        found = (
            held_out if tuning is None else scores.list_groups(tuning[tuning["grouping"] == scores.BY_LAYERS])
        )
        groups += [(group, choose_method(one)) for group in found]
    rows: list[Row] = []
    several = len(groups) > 1
    for number, (group, method) in enumerate(groups):
        curve = find_closest_curve(group)
        kinds = (
            _RowKind("our prediction" if method == MEDIAN_METHOD else "our fit", method=method),
            *(
                [_RowKind(f"closest curve{'' if several else f': {method_name(curve)}'}", method=curve)]
                if curve
                else []
            ),
            _RowKind("paper's parameters, these needles", method="hand_tuned"),
            _RowKind("paper's result, its own needles", column="paper"),
        )
        for row in _list_rows(group, kinds):
            floor = group.get(scores.TE, "floor") if row["row"] == kinds[0].name else None
            rows.append({**_head(group), **row, "number": number, "noise_of_te": floor})
    metrics = sorted(
        (one for one in list_metrics() if one.headline or one.relative), key=lambda one: one.name != scores.TE
    )
    heads = ("study", "medium", "layers", "insertions")[len(results) == 1 :] if several else ()
    columns = (*heads, "row", *(part("metric_value", metric=one.name) for one in metrics), "noise_of_te")
    lines = pivot(rows, ["number", "row"], ["metric"])
    table = Table("summary", lines, columns, groups=("number",), heads=len(heads), strong="groups")
    found_table = _lay_out(table, drop_empty=True)
    if several or not groups:
        return found_table
    head = groups[0][0].head
    which = "held-out" if head["grouping"] == scores.HELD_OUT else "fitted"
    words = f"Mean over {head['insertions']} {which} insertion{'s' * (head['insertions'] != 1)}"
    first, *others = found_table.columns
    return replace(found_table, columns=(replace(first, label=words), *others))


def _list_rows(group: scores.ScoredGroup, kinds: Sequence[_RowKind]) -> Iterator[Row]:
    """Yield a row per kind and metric, of kinds that have any value."""
    for kind in kinds:
        found = [_describe_score(group, kind, metric) for metric in list_metrics()]
        if any(row["value"] is not None for row in found):
            yield from found


def _describe_score(group: scores.ScoredGroup, kind: _RowKind, metric: Metric) -> Row:
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


def _head(group: scores.ScoredGroup) -> Row:
    about = {"layers": str(group.head["layers"] or "all"), "printed": group.printed}
    return {**group.head, **about, "unflagged_edp": group.get("edp_percent", "unflagged")}


def lay_out_matrix(results: Sequence[Run]) -> TableLayout:
    """Return one row per study and held-out group: our errors, what they compare with, and the verdict."""
    rows: list[Row] = []
    for one in results:
        method = choose_method(one)
        for group in scores.list_held_out_groups(one):
            judged, curve = judge(one, group), find_closest_curve(group)
            rows.append(
                {
                    **_head(group),
                    **{name: group.get(name, method=method) for name in ("ipe_mean_mm", "te_mm")},
                    "floor_te_mm": group.get("te_mm", "floor"),
                    "baseline_te_mm": None if curve is None else group.get("te_mm", method=curve),
                    "baseline_method": curve or "",
                    **{f"paper_{name}": group.get(name, "paper") for name in ("ipe_mean_mm", "te_mm")},
                    "verdict": "not scored" if judged is None else judged.outcome,
                }
            )
    columns = (
        *("study", "medium", "layers", "insertions", "ipe_mean_mm", "te_mm", "floor_te_mm"),
        *("baseline_te_mm", "baseline_method", "paper_ipe_mean_mm", "paper_te_mm", "verdict"),
    )
    return _lay_out(Table("matrix", rows, columns, groups=("study",), heads=1), drop_empty=True)


def lay_out_design(results: Sequence[Run]) -> TableLayout:
    """Return which insertions tune and validate: counts, ranges of depth and measured deflection."""
    rows = [
        {**row, "study": scores.study_label(one), "role": _ROLE_NAMES[row["role"]], "origin": one.origin}
        for one in results
        for row in to_records(one.frames["design"])
    ]
    columns = ("study", "role", "medium", "layers", "insertions", "depth_range_mm", "deflection_range_mm")
    errors = pd.concat([one.frames["errors"].assign(study=one.name) for one in results])
    doubtful = errors[errors["layers"] != errors["layers_other"]].drop_duplicates(["study", "insertion"])
    table = Table("design", rows, columns, groups=("study",), heads=1)
    return _lay_out(table, drop_empty=True, at_boundary=len(doubtful))


_COVERAGE_GROUPS = ("study", "medium", "layers", "specimen_treatment")


def lay_out_coverage(*results: Run, named: bool = False) -> TableLayout:
    """Return one row per study (named if wanted), medium, number of layers and specimen, over all folds."""
    frames = [one.frames["predictive"].assign(study=scores.study_label(one)) for one in results]
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
        {
            **{"study": study_name(group["study"].iloc[0]), "medium": str(medium)},
            "width_mm": float(group["tip_95_width_after_one_mm"].median()),
        }
        for (_, medium), group in other.groupby(["study", "medium"], sort=False)
        if other["tip_95_width_after_one_mm"].notna().any()
    ]
    table = Table("coverage", rows, columns, groups=_COVERAGE_GROUPS[:1], heads=named)
    sources = [str(source) for source in pd.unique(predicted["draw_source"])]
    return _lay_out(table, sources=sources, spread=spread if len(other) else None, gains=gains)


def lay_out_baselines(results: Run, role: str) -> TableLayout:
    """Return every method's errors and its paired difference from the fit on the same insertions."""
    digits = 3 if (results.frames["errors"]["comparison"] == "aligned").any() else 2
    about = {"study": scores.study_label(results), "origin": results.origin, DIGITS: digits}
    rows = [
        {
            **{**row, **about, "method": method_name(row["method"], results.origin)},
            **({"difference_mm": None, "better": ""} if row["method"] == "fitted" else {}),
        }
        for row in to_records(scores.compare_methods(results, role))
    ]
    errors = (one.name for one in headline_metrics())
    columns = ("study", "method", "insertions", *errors, "te_difference", "better_of")
    table = Table("baselines", rows, columns, groups=("study",), heads=1, strong="groups")
    return _lay_out(table, role=role)


def lay_out_insertions(results: Run, role: str) -> TableLayout:
    """Return the fitted model's errors on single insertions beside their noise floor."""
    columns = (
        *("insertion", "medium", "layers", "depth_mm", "deflection_mm", "predicted_deflection_mm"),
        *(one.name for one in list_metrics() if not one.spread_of),
        *(f"floor_{one.name}" for one in headline_metrics() if one.has_floor),
    )
    rows = [
        {
            **{**dict.fromkeys(columns), **row, "origin": results.origin},
            DIGITS: 3 if row["comparison"] == "aligned" else 2,
            "insertion": str(row["insertion"]) + ("" if row["converged"] else " (did not converge)"),
            **{
                one.name: f"{format_metric(one, row.get(one.name))}†"
                for one in list_metrics()
                if one.relative and row["edp_flagged"]
            },
        }
        for row in to_records(select_fitted(results.frames["errors"], role))
    ]
    return _lay_out(Table("insertions", rows, columns))


# ---- parameters: posterior and error-minimising fit, beside the paper's

_PARAMETER_COLUMNS = (
    *("study", "medium", "fold", "parameter", "method", "value", "median"),
    *("determined", "condition", "status"),
    *("sd", "interval_low", "interval_high", "draw_source"),
    *("low", "high", "bound_low", "bound_high", "note", "origin"),
)


def tabulate_parameters(*results: Run) -> pd.DataFrame:
    """Return one row per study, fold, parameter and method.

    `value` is what errors and curves of the method are simulated with, `median` that of the posterior's
    draws. `interval_low`, `interval_high` are the 95 % interval of the posterior; of the error-minimising fit
    the range within the tolerance of the errors. `determined` says whether the data determine the parameter:
    "yes", "only together" or "no". `sd` is of ln for moduli and lengths, of the value for alpha.
    """
    rows = [
        {"study": scores.study_label(one), "medium": one.record.medium, "origin": one.origin, **row}
        for one in results
        for row in to_records(one.frames["parameters"])
    ]
    return pd.DataFrame(rows, columns=list(_PARAMETER_COLUMNS))


def arrange_parameters(table: pd.DataFrame) -> list[Row]:
    """Return one row per study, fold and parameter: the posterior's, with each method's row under its name.

    A method that has no such parameter has an empty row.
    """
    rows: dict[tuple[object, ...], Row] = {}
    for row in to_records(table):
        key = (row["study"], row["fold"], row["parameter"])
        if row["method"] == "fitted":
            rows[key] = {**row, **{method: {} for method in MODEL_METHODS}}
        if key in rows:
            rows[key][row["method"]] = row
    return list(rows.values())


AT_BOUND = "*"  #: marks the end of a range that is a bound
END_DIGITS = 2  #: significant digits of the ends of an interval


def describe_parameter(rows: Sequence[Row], truth: float | None = None) -> Row:
    """Return the cells of one parameter from its rows of `arrange_parameters`, of several folds their range.

    A value stands with its 95 % interval, of the error-minimising fit with its range within the tolerance.
    """
    name, fixed = str(rows[0]["parameter"]), rows[0]["status"] == "fixed"
    ends = [row[end] for row in rows for end in ("interval_low", "interval_high")]
    label, unit = choose_printed_unit(name, ends if any(map(is_known, ends)) else [rows[0]["value"]])
    errors = [] if fixed else [row["fitted_metric"] for row in rows if row["fitted_metric"]]
    estimates = list(map(choose_estimate, rows))
    return {
        "parameter": label,
        "posterior": f"{_join_range(estimates, unit)}, fixed"
        if fixed
        else _format_estimate(rows, estimates, unit),
        "determined": "" if fixed else _join_determined(rows),
        "error_minimising": _format_estimate(errors, [row["value"] for row in errors], unit),
        "errors_determine": _join_determined(errors),
        "hand_tuned": _join_range([row["hand_tuned"]["value"] for row in rows if row["hand_tuned"]], unit),
        "true_value": "" if truth is None else typeset(format_number(truth / unit)),
    }


def choose_estimate(row: Row) -> float | None:
    """Return the estimate of a parameter that is printed: the median of its draws, without any the fit's."""
    estimate: float | None = row["value"] if row["median"] is None else row["median"]
    return estimate


def _join_determined(rows: Sequence[Row]) -> str:
    return find_least_determined(str(row["determined"]) for row in rows)


def _join_range(values: Sequence[float | None], unit: float) -> str:
    """Return "0.196", or "0.19 to 0.21" for several values."""
    known = [value / unit for value in values if value is not None]
    return " to ".join(dict.fromkeys(format_plain(end) for end in (min(known), max(known)))) if known else ""


def _format_estimate(rows: Sequence[Row], values: Sequence[float | None], unit: float) -> str:
    """Return "0.196 (0.12 to 0.28)"; of several folds with the outermost ends, of none ""."""
    estimate = _join_range(values, unit)
    lows, highs = ([row[f"interval_{end}"] for row in rows] for end in ("low", "high"))
    if not rows or not all(map(is_known, [*lows, *highs])):
        return estimate
    ends = []
    for end, found in (("low", min(lows)), ("high", max(highs))):
        bounds = [row[f"bound_{end}"] for row in rows]
        mark = AT_BOUND if any(map(is_known, bounds)) and _is_at(found, bounds) else ""
        ends.append(f"{format_plain(round_significant(found / unit, END_DIGITS))}{mark}")
    return f"{estimate} ({' to '.join(ends)})"


def _is_at(end: float, bounds: Sequence[float | None]) -> bool:
    return any(bound is not None and math.isclose(end, bound, rel_tol=1e-6) for bound in bounds)


#: what the intervals of parameters are from, by `draw_source`
SOURCES = {"posterior": "emcee", "importance": "importance sampling", "profile": "profile likelihood"}


def _describe_search(results: Sequence[Run]) -> Row:
    """Return what the captions state: how draws were made, the tolerances of the errors."""
    tolerances = [value for one in results for value in one.frames["error_fit"]["tolerance_mm"].tolist()]
    free = pd.concat([select_free(one.frames["parameters"]) for one in results])
    specimens = [set(one.frames["draws"]["specimen"]) - {TUNED_SPECIMENS, NEW_SPECIMEN} for one in results]
    return {
        "sources": [words for source, words in SOURCES.items() if (free["draw_source"] == source).any()],
        "of_mean": any(len(names) > 1 for names in specimens),
        "tolerances": [min(tolerances), max(tolerances)] if tolerances else [],
    }


def lay_out_parameters(*results: Run) -> TableLayout:
    """Return posterior and error-minimising fit beside the paper's parameters, of several folds their range.

    Parameters with the same cells have one row. Of several studies only free parameters are there.
    """
    rows: list[Row] = []
    for one in results:
        every, truth = arrange_parameters(tabulate_parameters(one)), one.run.get("truth", {})
        pairs = [
            (str(row["parameter"]), row) for row in every if len(results) == 1 or row["status"] == "free"
        ]
        cells: dict[tuple[object, ...], Row] = {}
        for name, members in group_values(pairs).items():
            row = describe_parameter(members, truth.get(name))
            key = tuple(row[key] for key in row if key != "parameter")
            cells.setdefault(key, {**row, "names": []})["names"].append(row["parameter"])
        about = {"study": scores.study_label(one)}
        rows += [{**about, **row, "parameter": ", ".join(row["names"])} for row in cells.values()]
    columns = (
        *("study", "parameter", "posterior", "determined", "error_minimising", "errors_determine"),
        *("hand_tuned", "true_value"),
    )[len(results) == 1 :]
    single = len(results) == 1
    values = {
        "folds": max(int(one.frames["parameters"]["fold"].nunique()) for one in results),
        "bounds": any(AT_BOUND in row["posterior"] + row["error_minimising"] for row in rows),
        "together": find_known_combination(results[0]) if single else "",
        "freed": describe_freed(results[0].frames["identification"]) if single else [],
        "printed": any(row["hand_tuned"] for row in rows),
        "metric": any(row["error_minimising"] for row in rows),
        "truth": any(row["true_value"] for row in rows),
        **_describe_search(results),
    }
    table = Table("parameters", rows, columns, groups=("study",) if not single else (), heads=int(not single))
    return _lay_out(table, drop_empty=True, **values)


def find_known_combination(results: Run) -> str:
    """Return the best known combination of several parameters, with its precision.

    "" if none is known, or if every parameter is determined by itself.
    """
    free = select_free(results.frames["parameters"])
    if (free["determined"][~free["parameter"].isin(HYPERPARAMETERS)] == "yes").all():
        return ""
    rows = to_records(results.frames["directions"])
    known = (row for row in rows if row["sd"] < MAX_LOG_SD and row["sd_ratio"] < UNINFORMED_SD_RATIO)
    return next((str(row["note"]) for row in known if row["parameters"] > 1), "")


def describe_freed(identification: pd.DataFrame) -> list[tuple[list[str], str]]:
    """Return what freeing the fixed parameters does, each sentence once, with the parameters it is about."""
    fixed = identification[identification["status"] == "fixed"].sort_values("parameter", kind="stable")
    pairs = ((describe_evidence(row), str(row["parameter"])) for row in to_records(fixed))
    return [(names, words) for words, names in group_values(pairs).items()]


def lay_out_directions(results: Run) -> TableLayout:
    """Return the combinations of parameters that the data determine, and how well."""
    rows = to_records(results.frames["directions"])
    folds = len({row["fold"] for row in rows}) > 1
    cells = [
        {"fold": row["fold"] if folds else "", "known_combination": insert_symbols(str(row["note"]))}
        for row in rows
    ]
    return _lay_out(Table("directions", cells, ("fold", "known_combination")), drop_empty=True)


def lay_out_population(results: Run) -> TableLayout:
    """Return how much the parameters differ between the specimens that were fitted."""
    rows = to_records(results.frames["population"])
    folds = len({row["fold"] for row in rows}) > 1
    cells = [
        {
            **row,
            "fold": row["fold"] if folds else "",
            "parameter": format_bare_symbol(str(row["parameter"])),
            "between_factor": math.exp(row["between_sd"]),
        }
        for row in rows
    ]
    columns = ("fold", "parameter", "between_sd", "between_factor", "other_specimens")
    return _lay_out(Table("population", cells, columns), drop_empty=True, rows=rows)


def lay_out_posterior(results: Run) -> TableLayout:
    """Return the percentiles of a sampled posterior in printed units."""
    several, rows = len(results.posteriors) > 1, []
    percentiles = [f"p{percentile:g}" for percentile in PERCENTILES]
    for row in to_records(tabulate_percentiles(results)):
        label, unit = choose_printed_unit(str(row["parameter"]), [row[name] for name in percentiles])
        cells = {name: row[name] / unit for name in percentiles}
        state, fold = "" if row["converged"] else "NOT CONVERGED", row["fold"] if several else ""
        rows.append({**row, **cells, "parameter": label, "fold": fold, "state": state})
    columns = ("fold", "parameter", *percentiles, "r_hat", "ess", "state")
    unconverged = any(posterior.faults for posterior in results.posteriors.values())
    return _lay_out(Table("posterior", rows, columns), drop_empty=True, unconverged=unconverged)


def tabulate_percentiles(results: Run) -> pd.DataFrame:
    """Return one row per fold and free parameter: percentiles (Pa, mm), R-hat, effective sample size.

    `acceptance` is the fold's. `converged` is false where the criteria, which concern more than the
    parameters, are not met: percentiles are then not final.
    """
    names, found = [f"p{percentile:g}" for percentile in PERCENTILES], list[Row]()
    for fold, posterior in results.posteriors.items():
        about: Row = {"acceptance": float(np.mean(posterior.acceptance)), "converged": not posterior.faults}
        about |= {"fold": fold, "origin": results.origin}
        for number, (name, values) in enumerate(posterior.percentiles().items()):
            of_chain = {"r_hat": float(posterior.r_hat[number]), "ess": float(posterior.ess[number])}
            found.append({"parameter": name, **dict(zip(names, values, strict=True)), **about, **of_chain})
    columns = ("fold", "parameter", *names, "r_hat", "ess", "acceptance", "converged", "origin")
    return pd.DataFrame(found, columns=columns)


# ---- the files of one run, or of several together


def lay_out_files(
    studies: Sequence[Run], tunings: Sequence[Run]
) -> Iterator[tuple[str, pd.DataFrame, list[TableLayout]]]:
    """Yield the paper's tables with our rows beside its rows: name, rows, and the tables to print."""
    every = list({one.name: one for one in (*studies, *tunings)}.values())
    validation = scores.tabulate_validation(*studies)
    yield "validation", validation, [lay_out_validation(studies)]
    yield "tuning", scores.tabulate_tuning(*tunings), lay_out_tuning(tunings)
    yield "parameters", tabulate_parameters(*every), [lay_out_parameters(*every)]


# ---- numbers for a paper


def format_macros(results: Sequence[Run]) -> str:
    """Return a LaTeX file of macros of errors and parameters, by readable keys.

    A key is `<run>-<medium>-<layers>-<error>`, with `floor-` or `paper-` before the error for what stands
    beside it or `-over-floor` after it for the multiple of its noise floor; `<run>-<parameter>`, the median
    of the posterior, with `-low`, `-high` and `-interval` of its 95 % interval, all in the unit of the
    tables, `-unit`, and `-determined`.
    """
    return latex.format_macros(
        number
        for one in results
        for numbers in (_list_errors(one), _list_parameters(one))
        for number in numbers
    )


def _list_errors(results: Run) -> Iterator[tuple[str, str]]:
    for group in scores.list_held_out_groups(results):
        head = group.head
        begin = f"{results.name}-{head['medium']}-{head['layers']}"
        yield f"{begin}-n", str(head["insertions"])
        for metric in list_metrics():
            row = {"metric": metric.name, DIGITS: 3 if head["comparison"] == "aligned" else 2}
            for key, column in (("", "value"), ("floor-", "floor"), ("paper-", "paper")):
                value = group.get(metric.name, column)
                if value is not None or not key:
                    yield f"{begin}-{key}{metric.macro_name}", format_value(METRIC_FORMAT, value, row)
            if (times := group.over_floor(metric.name)) is not None:
                words = find_column("over_floor").format_cell({"over_floor": times})
                yield f"{begin}-{metric.macro_name}-over-floor", words


def _list_parameters(results: Run) -> Iterator[tuple[str, str]]:
    table = arrange_parameters(tabulate_parameters(results))
    several = len({row["fold"] for row in table}) > 1
    for row in table:
        name = str(row["parameter"]).removesuffix("_pa").removesuffix("_mm").replace("_", "-")
        where = f"-{row['fold']}" if several else ""
        key = f"{results.name}{where}-{name}"
        estimate = choose_estimate(row)
        assert estimate is not None
        label, scale = choose_interval_unit(row, estimate)
        yield key, typeset(format_number(estimate / scale))
        if unit := label.partition(" (")[2].rstrip(")"):
            yield f"{key}-unit", unit
        if row["determined"]:
            yield f"{key}-determined", str(row["determined"])
        if interval := typeset_interval(row, scale):
            yield f"{key}-interval", interval
            low, _, high = interval.partition(" to ")
            yield from ((f"{key}-low", low), (f"{key}-high", high))
