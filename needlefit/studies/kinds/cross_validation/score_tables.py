"""Tables of errors and of interval coverage: our rows above the paper's, one column per quantity."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import pandas as pd

from needlefit.metrics import Metric, headline_metrics, list_metrics
from needlefit.reporting.columns import DIGITS
from needlefit.reporting.labels import SPECIMEN_NAMES, medium_name, method_name, study_name
from needlefit.reporting.number_format import MISSING, format_percent
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.coverage import COVERAGE_COLUMNS, tabulate_coverage
from needlefit.studies.fit_warnings import describe_gain
from needlefit.studies.kinds.cross_validation.verdict import judge
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import (
    BY_LAYERS,
    BY_MEDIA,
    HELD_OUT,
    ScoredGroup,
    find_best_baseline,
    list_groups,
    list_held_out_groups,
    study_label,
    tabulate_tuning,
)

_ROW_NOTES = {  # what a row means; it stands under the table where the row does
    "posterior-mode fit": "Each cell is the mean over insertions; IPE is mean ± standard deviation along the "
    "needle.",
    "error-minimising fit": "Error-minimising fit: minimises IPE, TE and EDP on the tuning insertions.",
    "planned layer depths": "Planned layer depths: layers begin where the predicted needle crosses the "
    "surfaces; the measured crossings depend on the outcome that is predicted.",
    "pooled": "Pooled: statistics of all points together.",
    "noise floor": "Noise floor: mean error that perfect parameters would still show, from the measurement "
    "noise stated with the dataset. “÷ floor”: the error as a multiple of it.",
}
_FLAGGED_NOTE = "† Some of these insertions are deflected less than the noise floor: EDP means little."
_ALTERNATE_MARK = "‡"
_ALTERNATE_NOTE = (
    f"{_ALTERNATE_MARK} An insertion that ends at a boundary is counted the other way in these rows: the "
    f"same fit "
    "and the same predictions in other groups."
)
_COUNT_NOTE = (
    "“Alternative count” counts the same insertions by the other reading of those that end at a boundary. "
    "“Tip "
    "deflection” is "
    "the measured deflection of the tip, positive toward the bevel."
)
_ALIGNED_NOTE = "Errors are after rigid alignment of each shape, whose pose in the world is not known."


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
"""The kinds of rows given of groups by the alternative count."""


def lay_out_validation(results: Sequence[Run]) -> TableLayout:
    """Return the validation table by held-out group: ours, with planned depths, noise floor, paper."""
    groups = list_held_out_groups(*results, with_alternate=True)
    return _lay_out_groups("validation", "Errors on held-out insertions", groups, _HELD_OUT_KINDS)


def lay_out_summary(results: Sequence[Run]) -> TableLayout:
    """Return the table of the first page: our fit, the best baseline, noise floor and paper, by group.

    Groups are those held out, or of runs without any those fitted to.
    """
    rows: list[Row] = []
    for number, group in enumerate(_list_scored_groups(results)):
        head = _describe_group(group.head)
        best = find_best_baseline(group)
        kinds = (_FITTED, *([_RowKind(method_name(best), method=best)] if best else []), _FLOOR, _PAPER)
        for kind in kinds:
            scores = [_describe_score(group, kind, metric) for metric in list_metrics()]
            if any(row["value"] is not None for row in scores):
                rows += [{**head, **row, "number": number} for row in scores]
    columns = (
        *("study", "medium", "layers", "insertions", "row"),
        *(part("metric_value", metric=one.name) for one in list_metrics() if one.headline or one.relative),
        *(part("over_floor", metric=one.name) for one in headline_metrics() if one.has_floor),
    )
    explained = [
        f"{metric.label}: {metric.explanation.partition(': ')[2] or metric.explanation}"
        for metric in list_metrics()
        if metric.headline or metric.relative
    ]
    marked = any(row["mark"] for row in rows)
    notes = (" ".join([*explained, _ROW_NOTES["noise floor"], *([_FLAGGED_NOTE] if marked else [])]),)
    lines = pivot(rows, ["number", "row"], ["metric"])
    held_out = any(group.head["grouping"] == HELD_OUT for group in _list_scored_groups(results))
    caption = f"Mean errors on {'held-out' if held_out else 'tuning'} insertions."
    return Table(
        "summary", caption, lines, columns, groups=("number",), heads=4, strong="groups", notes=notes
    ).lay_out()


def _list_scored_groups(results: Sequence[Run]) -> list[ScoredGroup]:
    return [group for one in results for group in _groups_of(one)]


def _groups_of(results: Run) -> list[ScoredGroup]:
    tuning = tabulate_tuning(results)
    return list_held_out_groups(results) or list_groups(tuning[tuning["grouping"] == BY_LAYERS])


def lay_out_matrix(results: Sequence[Run]) -> TableLayout:
    """Return one row per study and held-out group: its verdict, its tip error and what this compares with."""
    rows: list[Row] = []
    held_out = [one for one in results if list_held_out_groups(one)]
    for one in held_out:
        for group, verdict in zip(list_held_out_groups(one), judge(one), strict=True):
            best = find_best_baseline(group)
            rows.append(
                {
                    **_describe_group(group.head),
                    "verdict": verdict.status,
                    "te_mm": group.get("te_mm"),
                    "floor_te_mm": group.get("te_mm", "floor"),
                    "baseline_te_mm": None if best is None else group.get("te_mm", method=best),
                    "baseline_method": "" if best is None else best,
                    "paper_te_mm": group.get("te_mm", "paper"),
                    "floor_ratio": group.over_floor("te_mm"),
                }
            )
    columns = (
        *("study", "medium", "layers", "insertions", "verdict", "te_mm", "floor_ratio", "floor_te_mm"),
        *("baseline_te_mm", "baseline_method", "paper_te_mm"),
    )
    notes = (
        "TE: mean tip error of held-out insertions. Best baseline: the curve with the smallest tip error.",
    )
    return Table("matrix", "Verdicts.", rows, columns, groups=("study",), heads=1, notes=notes).lay_out()


def lay_out_tuning(results: Sequence[Run], grouping: str) -> TableLayout:
    """Return the in-sample errors by `grouping` ("layers" or "media"), beside the paper's tuned models."""
    table = tabulate_tuning(*results, with_alternate=True)
    caption = f"In-sample errors of the tuned models by {_GROUPING_NAMES[grouping]}"
    groups = list_groups(table[table["grouping"] == grouping])
    return _lay_out_groups(f"tuning_by_{grouping}", caption, groups, _REGROUPED_KINDS)


def lay_out_all_errors(results: Run) -> TableLayout:
    """Return all metrics of held-out and tuning insertions; by media where the paper has a cell."""
    tuned = list_groups(tabulate_tuning(results))
    kinds = [kind for kind in _HELD_OUT_KINDS if kind is not _POOLED]
    shown = [
        group
        for group in tuned
        if group.head["grouping"] == BY_LAYERS
        or any(one.printed for one in tuned if one.head["grouping"] == BY_MEDIA)
    ]
    groups = [*list_held_out_groups(results), *shown]
    return _lay_out_groups("all_errors", "Errors in all metrics", groups, kinds, compared=False)


_GROUPING_NAMES = {BY_LAYERS: "number of layers", BY_MEDIA: "medium"}
_ROLE_NAMES = {"tune": "tunes", "validate": "validates"}


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
    notes = (_COUNT_NOTE,) if any(row["insertions_other"] for row in rows) else ()
    caption = "Fitted and held-out insertions."
    table = Table("design", caption, rows, columns, groups=("study",), heads=1, notes=notes)
    return table.lay_out(drop_empty=True)


def _lay_out_groups(
    name: str, caption: str, groups: Sequence[ScoredGroup], kinds: Sequence[_RowKind], compared: bool = True
) -> TableLayout:
    """Return one block of rows per group; only its first row names the group.

    With `compared`, notes say what makes each group comparable to the paper's, or not.
    """
    rows: list[Row] = []
    caveats: list[str] = []
    same: dict[str, list[str]] = {}
    for number, group in enumerate(groups):
        head = _describe_group(group.head)
        role = _ROLE_NAMES["validate" if group.head["grouping"] == HELD_OUT else "tune"]
        own = [kind for kind in kinds if group.head["grouping"] == HELD_OUT or kind in _REGROUPED_KINDS]
        rows += [{**head, **row, "role": role, "number": number} for row in _list_group_rows(group, own)]
        if group.printed:
            same.setdefault(str(group.head["comparable"]), []).append(_name_group(head))
        caveats += _group_caveats(head, group)
    comparisons = [f"{'; '.join(heads)}: {sentence}" for sentence, heads in same.items() if compared]
    names = {row["row"] for row in rows}
    summary = [sentence for row_kind, sentence in _ROW_NOTES.items() if row_kind in names]
    summary += [_ALTERNATE_NOTE] if any(group.head["alternate_count"] for group in groups) else []
    summary += [_ALIGNED_NOTE] if any(group.head["comparison"] == "aligned" for group in groups) else []
    caption += ", beside the paper’s." if _PAPER.name in names else "."
    notes = (" ".join(summary), *comparisons, *caveats) if summary else ()
    several = len({row["role"] for row in rows}) > 1
    heads = ("study", *(("role",) if several else ()), "medium", "layers", "insertions")
    columns = (
        *(*heads, "row"),
        *(part("metric_value", metric=one.name) for one in list_metrics() if not one.spread_of),
        *(part("over_floor", metric=one.name) for one in headline_metrics() if one.has_floor),
    )
    lines = pivot(rows, ["number", "row"], ["metric"])
    return Table(
        name, caption, lines, columns, groups=("number",), heads=len(heads), strong="groups", notes=notes
    ).lay_out()


def _list_group_rows(group: ScoredGroup, kinds: Sequence[_RowKind]) -> Iterator[Row]:
    """Yield a row per kind and metric, of kinds that have any value."""
    own = [kind for kind in kinds if not group.head["alternate_count"] or kind in _REGROUPED_KINDS]
    for kind in (*own, _FLOOR, _PAPER):
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


def _describe_group(head: Row) -> Row:
    count = str(head["layers"] or "all") + (_ALTERNATE_MARK if head["alternate_count"] else "")
    return {**head, "layers": count}


def _group_caveats(head: Row, group: ScoredGroup) -> list[str]:
    summary = []
    counts = group.head
    if counts["edp_flagged"]:
        rest = format_percent(group.get("edp_percent", "unflagged"))
        without = "" if rest == MISSING else f"; without them EDP is {rest} %"
        summary.append(
            f"† {_name_group(head)}: {counts['edp_flagged']} of {counts['insertions']} deflect less than the "
            f"noise floor, so their EDP means little{without}."
        )
    if counts["not_converged"]:
        summary.append(
            f"{_name_group(head)}: {counts['not_converged']} of {counts['insertions']} simulations did not "
            "converge and are missing from the means."
        )
    return summary


def _name_group(head: Row) -> str:
    study = f"Study {head['study']}" if str(head["study"]).isdigit() else head["study"]
    count = head["layers"].removesuffix(_ALTERNATE_MARK)
    layers = "all layers" if count == "all" else "1 layer" if count == "1" else f"{count} layers"
    layers += _ALTERNATE_MARK if head["layers"] != count else ""
    return f"{study}, {medium_name(head['medium'])}, {layers}"


_COVERAGE_NOTES = (
    "Number of insertions whose tip (whole shape) lies inside its predicted interval (band), with the 95 % "
    "confidence interval of the share. Width: median width of the 95 % intervals of tips. Median off: mean "
    "distance of the predicted medians from the measured tips; TE elsewhere is of the posterior mode, which "
    "differs from the median where the posterior is skewed. Well-calibrated "
    "predictions give 50 % and 95 %. With five specimens or more, all insertions into one specimen count as "
    "one trial; with fewer, the confidence interval does not include differences between specimens. CRPS: "
    "mean score of the whole predictive distribution of the tip; lower is better.",
    "The intervals include the uncertainty of the parameters and the stated errors of layer depths, tip "
    "depth, pose and points, not model error. Layers begin where each simulated needle crosses the surfaces.",
)
_DRAW_SOURCE_NAMES = {
    "posterior": "the sampled posterior",
    "importance": "importance-weighted draws of the posterior",
}


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
    notes = (*_COVERAGE_NOTES, *describe_spread(predicted))
    sources = (_DRAW_SOURCE_NAMES[str(source)] for source in pd.unique(predicted["draw_source"]))
    caption = f"Coverage of the predictive intervals on held-out insertions, by {' and '.join(sources)}."
    heads = _COVERAGE_GROUPS[not named :]
    columns = (*heads, *COVERAGE_COLUMNS)
    groups = _COVERAGE_GROUPS[:1]
    return Table("coverage", caption, rows, columns, groups=groups, heads=named, notes=notes).lay_out()


def describe_spread(predicted: pd.DataFrame) -> Iterator[str]:
    """Yield what the spread between specimens does to predictions, where it is in them."""
    other = predicted[predicted["specimen_treatment"] == "others"]
    if other.empty:
        return
    mu, b = (math.exp(other[f"between_sd_ln_{name}"].mean()) for name in ("mu", "b"))
    count = int(other["other_specimens"].min())
    yield (
        f"“New specimen”: a specimen that the model was not tuned on. One standard deviation between "
        f"specimens is a factor of {mu:.2g} in the moduli and of {b:.2g} in the bevel parameter. It is "
        f"estimated from {count} other specimens and the prior in the recipe; with two or three it is "
        "mostly the prior. “Training only” uses the parameters of the tuned specimens unchanged."
    )
    if other["tip_95_width_after_one_mm"].notna().any():
        groups = list(other.groupby(["study", "medium"], sort=False))
        for _, rows in groups:
            study, medium = rows["study"].iloc[0], str(rows["medium"].iloc[0])
            where = f" ({study_name(study)}, {medium_name(medium)})" if len(groups) > 1 else ""
            yield f"New specimen{where}, 95 % intervals of tips: {describe_gain(rows)}."


_COVERAGE_GROUPS = ("study", "medium", "layers", "specimen_treatment")
