"""Tables of errors and of interval coverage: our rows above the paper's, one column per quantity."""

from collections.abc import Sequence

import pandas as pd

from needlefit.datasets.select import group_independent
from needlefit.reporting.labels import medium_name
from needlefit.reporting.number_format import MISSING, format_mm, format_percent
from needlefit.reporting.table_layout import TableColumn, TableLayout, drop_empty_columns, text_column
from needlefit.reporting.tables import (
    Row,
    divide_by_floor,
    study_label,
    tabulate_tuning,
    tabulate_validation,
    to_records,
)
from needlefit.validation.proportions import Proportion, estimate_proportion
from needlefit.validation.results import Results

_SCORE_COLUMNS = (
    TableColumn("Median", "mm"),
    TableColumn("IPE", "mm"),
    TableColumn("Max IPE", "mm"),
    TableColumn("TE", "mm"),
    TableColumn("EDP", "%"),
    TableColumn("IPE", "÷ floor"),
    TableColumn("TE", "÷ floor"),
)
_ROW_NOTES = {  # what a row means, said under the table where the row stands in it
    "needlefit": "Each cell is the mean over insertions of each one’s value; IPE is mean ± standard "
    "deviation.",
    "by IPE, TE, EDP": "“Needlefit” is the fit of greatest posterior density; “by IPE, TE, EDP” minimises "
    "these errors on the tuning insertions instead, as tuning by hand does.",
    "planned boundaries": "“Planned boundaries” scores the same model with layer depths from the planned "
    "straight path: the measured crossings of a held-out insertion leak its outcome.",
    "pooled": "“Pooled” takes the statistics of all points together; of medians and maxima the noise floor "
    "would then be another.",
    "noise floor": "“Noise floor” is what perfect parameters would still show if measurements err "
    "as the dataset states; “÷ floor”, the error as a multiple of it: about 1 is all that these measurements "
    "can tell. The paper gives no floor of its own.",
}
_ALTERNATE_MARK = "‡"
_ALTERNATE_NOTE = (
    f"{_ALTERNATE_MARK} An insertion that ends at a boundary is counted the other way in these rows: the "
    f"same fit "
    "and the same predictions in other groups."
)
_COUNT_NOTE = (
    "“Alternative count” counts the same insertions by the other reading of those that end at a boundary; "
    "the paper "
    "uses one reading where it lists them and the other where it divides them among its studies. “Tip "
    "deflection” is "
    "the measured deflection of the tip, positive toward the bevel."
)
_ALIGNED_NOTE = "Errors are after rigid alignment of each shape, whose pose in the world is not known."


def lay_out_validation(results: Sequence[Results]) -> TableLayout:
    """Return the validation table, per held-out group: ours, ours with planned layer depths, noise floor,
    paper.
    """
    table = to_records(tabulate_validation(*results, with_alternate=True))
    heads = (
        text_column("Study"),
        text_column("Held out"),
        TableColumn("Layers"),
        TableColumn("n"),
        text_column("Row"),
    )
    row_kinds = [("needlefit", ""), ("planned boundaries", "planned_"), ("pooled", "pooled_")]
    row_kinds.insert(1, ("by IPE, TE, EDP", "fitted_metric_"))
    return _stack_groups(
        TableLayout("validation", "Errors on held-out insertions.", heads, ()),
        [(_group_cells(row, row["validate_medium"], row["validate_layers"]), row) for row in table],
        row_kinds,
    )


def lay_out_tuning(results: Sequence[Results], grouping: str) -> TableLayout:
    """Return the in-sample errors by `grouping` ("layers" or "media"), beside the paper's tuned models."""
    table = [
        row
        for row in to_records(tabulate_tuning(*results, with_alternate=True))
        if row["grouping"] == grouping
    ]
    heads = (
        text_column("Fit of"),
        text_column("Tuned on"),
        TableColumn("Layers"),
        TableColumn("n"),
        text_column("Row"),
    )
    quantity = "number of layers" if grouping == "layers" else "medium"
    return _stack_groups(
        TableLayout(
            f"tuning_by_{grouping}", f"In-sample errors of the tuned models by {quantity}.", heads, ()
        ),
        [(_group_cells(row, row["medium"], row["layers"]), row) for row in table],
        [("needlefit", ""), ("pooled", "pooled_")],
    )


def lay_out_design(results: Sequence[Results]) -> TableLayout:
    """Return which insertions tune and which validate: counts, and ranges of depth and measured
    deflection.
    """
    heads = (
        text_column("Study"),
        text_column("Role"),
        text_column("Medium"),
        TableColumn("Layers"),
        TableColumn("Insertions"),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for one in results:
        breaks += [len(rows)] if rows else []
        for i, row in enumerate(to_records(one.design)):
            cells = ("tunes" if row["role"] == "tune" else "validates", medium_name(row["medium"]))
            other = "" if row["insertions"] == row["insertions_other"] else str(row["insertions_other"])
            counts = (str(row["layers"]), str(row["insertions"]), other)
            spans = [
                format_range(row[f"{quantity}_min_mm"], row[f"{quantity}_max_mm"])
                for quantity in ("depth", "deflection")
            ]
            rows.append((str(study_label(one)) if i == 0 else "", *cells, *counts, *spans, one.origin))
    columns = (
        *heads,
        TableColumn("Alternative count"),
        TableColumn("Depth", "mm"),
        TableColumn("Tip deflection", "mm"),
        text_column("Origin"),
    )
    notes = (_COUNT_NOTE,) if any(row[5] for row in rows) else ()
    table = TableLayout(
        "design", "What tunes and what validates.", columns, tuple(rows), tuple(breaks), notes=notes
    )
    return drop_empty_columns(table)


def format_range(low: float, high: float) -> str:
    """Return a range as text, "19.48 to 54.75", or one number if both ends are printed alike."""
    ends = [format_mm(low).replace("-", "−"), format_mm(high).replace("-", "−")]
    return " to ".join(dict.fromkeys(ends))


def _stack_groups(
    frame: TableLayout, groups: list[tuple[tuple[str, ...], Row]], row_kinds: list[tuple[str, str]]
) -> TableLayout:
    """Return `frame` filled with one block of rows per group; only its first row names the group."""
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    strong: list[int] = []
    caveats: list[str] = []
    same: dict[str, list[str]] = {}
    for head, row in groups:
        breaks += [len(rows)] if rows else []
        strong.append(len(rows))
        for name, cells in _group_rows(row, row_kinds):
            begins = len(rows) == strong[-1]
            origin = "paper, measured" if name == "paper" else str(row["origin"])
            rows.append((*(head if begins else ("",) * len(head)), name, *cells, origin))
        same.setdefault(str(row["comparable"]), []).append(_name_group(head))
        caveats += _group_caveats(head, row)
    columns = (*frame.columns, *_SCORE_COLUMNS, text_column("Origin"))
    compared = [f"{'; '.join(heads)}: {sentence}" for sentence, heads in same.items()]
    names = {row[len(head)] for row in rows for head, _ in groups[:1]}
    summary = [sentence for row_kind, sentence in _ROW_NOTES.items() if row_kind in names]
    summary += [_ALTERNATE_NOTE] if any(row["alternate_count"] for _, row in groups) else []
    summary += [_ALIGNED_NOTE] if any(row["comparison"] == "aligned" for _, row in groups) else []
    caption = frame.caption.removesuffix(".") + (", beside the paper’s." if "paper" in names else ".")
    notes = (" ".join(summary), *compared, *caveats) if summary else ()
    return TableLayout(frame.name, caption, columns, tuple(rows), tuple(breaks), tuple(strong), notes)


def _group_rows(row: Row, row_kinds: list[tuple[str, str]]) -> list[tuple[str, tuple[str, ...]]]:
    digits = 3 if row.get("comparison") == "aligned" else 2
    kinds = [
        row_kind for row_kind in row_kinds if not row["alternate_count"] or row_kind[1] in ("", "pooled_")
    ]
    lines = [(name, _score_cells(row, prefix, digits)) for name, prefix in kinds]
    lines += [("noise floor", _score_cells(row, "floor_", digits)), ("paper", _score_cells(row, "paper_", 2))]
    return [(name, cells) for name, cells in lines if any(cell != MISSING for cell in cells)]


def _score_cells(row: Row, prefix: str, digits: int) -> tuple[str, ...]:
    def cell(name: str) -> str:
        return format_mm(row.get(f"{prefix}{name}_mm"), digits)

    spread = f" ± {cell('ipe_std')}" if cell("ipe_std") != MISSING else ""
    flag = "†" if prefix != "paper_" and row["edp_flagged"] else ""
    edp = format_percent(row.get(f"{prefix}edp_percent"))
    edp = edp if edp == MISSING else edp + flag
    known = [] if prefix in ("floor_", "paper_") else ["ipe_mean", "te"]
    ratios = [format_mm(divide_by_floor(row, f"{prefix}{name}_mm"), 1) for name in known] or [
        MISSING,
        MISSING,
    ]
    return (cell("median_err"), cell("ipe_mean") + spread, cell("ipe_max"), cell("te"), edp, *ratios)


def _group_cells(row: Row, medium: str, layers: int | None) -> tuple[str, ...]:
    count = str(layers or "all") + (_ALTERNATE_MARK if row["alternate_count"] else "")
    return (str(row["study"]), medium_name(medium), count, str(row["insertions"]))


def _group_caveats(head: tuple[str, ...], row: Row) -> list[str]:
    summary = []
    if row["edp_flagged"]:
        rest = format_percent(row["edp_unflagged_percent"])
        without = "" if rest == MISSING else f"; without them EDP is {rest} %"
        summary.append(
            f"† {_name_group(head)}: {row['edp_flagged']} of {row['insertions']} deflect less than the noise "
            f"floor, so their EDP means little{without}."
        )
    if row["not_converged"]:
        summary.append(
            f"{_name_group(head)}: {row['not_converged']} of {row['insertions']} simulations did not "
            f"converge "
            "and are missing from the means."
        )
    return summary


def _name_group(head: tuple[str, ...]) -> str:
    study = f"Study {head[0]}" if head[0].isdigit() else head[0]
    count = head[2].removesuffix(_ALTERNATE_MARK)
    layers = "all layers" if count == "all" else "1 layer" if count == "1" else f"{count} layers"
    layers += _ALTERNATE_MARK if head[2] != count else ""
    return f"{study}, {head[1]}, {layers}"


_COVERAGE_NOTES = (
    "Tips that fell into the interval predicted for them, and shapes of which no point left the band "
    "predicted "
    "for them as a whole; of right predictions half and 95 %. In brackets the 95 % interval of that share, "
    "in which repeats in one specimen count as one trial where there are five specimens or more, and else as "
    "many; how specimens differ is then not in it. CRPS is the mean absolute error of a sure "
    "prediction, less what stating doubt gains; smaller is better.",
    "Foretold are parameters, depths of layers and tip, pose and points as the dataset states their errors, "
    "through the layers of the planned path. What the model misses is not.",
)
_DRAW_SOURCE_NAMES = {
    "posterior": "the sampled posterior",
    "importance": "draws of the posterior about the fit",
}
COVERAGE_COLUMNS = (
    *(TableColumn(f"{quantity} in", f"{level} %") for quantity in ("Tips", "Shapes") for level in (50, 95)),
    *(TableColumn("Tip CRPS", "mm"), TableColumn("Shape CRPS", "mm")),
)
"""Column headings of the coverage table."""


def lay_out_coverage(results: Results) -> TableLayout:
    """Return one row per medium and number of layers, over all folds."""
    rows = []
    for (medium, layers), group in results.predictive.groupby(["medium", "layers"], sort=False):
        rows.append((medium_name(str(medium)), str(layers), *format_coverage(group)))
    columns = (text_column("Held out"), TableColumn("Layers"), *COVERAGE_COLUMNS)
    doubtful = int((~results.predictive["certified"].astype(bool)).sum())
    notes = (
        *_COVERAGE_NOTES,
        *(
            (f"The draws behind {doubtful} of these needles are not certified: sample them (--sample).",)
            if doubtful
            else ()
        ),
    )
    summary = " and ".join(
        _DRAW_SOURCE_NAMES[str(source)] for source in pd.unique(results.predictive["draw_source"])
    )
    return TableLayout(
        "coverage",
        f"How well held-out needles were predicted, by {summary}.",
        columns,
        tuple(rows),
        notes=notes,
    )


def format_coverage(predictions: pd.DataFrame) -> tuple[str, ...]:
    """Return the cells of `COVERAGE_COLUMNS` for some needles: shares within their intervals, and mean
    scores.
    """
    independent_groups = group_independent(list(predictions["insertion"]), list(predictions["specimen"]))
    interval_columns = (f"{quantity}_in_{level}" for quantity in ("tip", "shape") for level in (50, 95))
    shares = (
        format_proportion(estimate_proportion(list(predictions[column]), independent_groups))
        for column in interval_columns
    )
    scores = (format_mm(predictions[f"{quantity}_crps_mm"].mean(), 3) for quantity in ("tip", "shape"))
    return (*shares, *scores)


def format_proportion(found: Proportion) -> str:
    """Return a proportion with its interval as text: "9 of 10 (60–98 %)"."""
    return f"{found.hits} of {found.trials} ({100 * found.low:.0f}–{100 * found.high:.0f} %)"
