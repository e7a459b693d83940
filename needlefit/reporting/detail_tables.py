"""Tables for print: parameters, methods, single insertions, directions, contradictions in the paper."""

import re
from collections.abc import Sequence

from needlefit.reporting.labels import medium_name, method_name
from needlefit.reporting.number_format import (
    MISSING,
    format_mm,
    format_number,
    format_percent,
    format_symbol,
    insert_symbols,
    typeset,
)
from needlefit.reporting.parameter_table import NOT_DETERMINED, tabulate_parameters
from needlefit.reporting.table_layout import (
    TableColumn,
    TableLayout,
    drop_column,
    drop_empty_columns,
    text_column,
)
from needlefit.reporting.tables import Row, study_label, to_records
from needlefit.validation.paper.claims import Claim
from needlefit.validation.results import Results
from needlefit.validation.summary import compare_methods

_TOLERANCE_NOTE = (
    "“Range within tolerance” is the range over starts whose objective is practically the best; it is left "
    "empty for what "
    "is not determined, where starts may agree without the data knowing."
)
_SD_NOTE = (
    "“Sd” is the Cramér-Rao bound, of ln for μ and b, of the value for α: what this model misses, and the "
    "rules that were decided, are not in it. It stands where errors have their noise floor, for of a "
    "parameter there is none. μ is an effective foundation modulus of this model, not a material constant."
)
_NOT_DETERMINED_PREFIX = re.compile(r"^not determined(?:: | \(([^()]*)\))")  # the column "Fitted" says it
_METRIC_FIT_NOTE = (
    "“By errors” is the second fit, which minimises IPE, TE and EDP as tuning by hand does; what the data do "
    "not determine is no estimate there either."
)
_PUBLISHED_NOTE = (
    "“By hand” is the paper’s set, never a start of the search; “b re-tuned” is that set with b alone fitted "
    "to the same insertions."
)


def lay_out_parameters(results: Sequence[Results]) -> TableLayout:
    """Return both fits beside the paper's parameters, and beside these with b re-fitted."""
    return _lay_out_parameter_rows(to_records(tabulate_parameters(*results)))


def lay_out_free_parameters(results: Sequence[Results]) -> TableLayout:
    """Return the free parameters of several studies in one table, without notes."""
    table = tabulate_parameters(*results)
    return drop_column(_lay_out_parameter_rows(to_records(table[table["status"] == "free"])), "Note")


def _lay_out_parameter_rows(table: list[Row]) -> TableLayout:
    folds = len({row["fold"] for row in table}) > 1
    mixed = len({row["origin"] for row in table}) > 1  # else the caption says it, and the notes need room
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    last: tuple[object, object] | None = None
    for row in table:
        begins = (row["study"], row["fold"]) != last
        breaks += [len(rows)] if begins and rows else []
        before, last = last and last[0], (row["study"], row["fold"])
        named = "" if rows and row["study"] == before else str(row["study"])
        head = (named, str(row["fold"]) if folds else "") if begins else ("", "")
        rows.append((*head, *_parameter_cells(row), str(row["origin"]) if mixed else ""))
    columns = (
        *(text_column("Study"), text_column("Fold"), text_column("Parameter"), TableColumn("Fitted")),
        *(
            TableColumn("Range within tolerance"),
            TableColumn("Sd"),
            TableColumn("By errors"),
            TableColumn("By hand"),
            TableColumn("b re-tuned"),
        ),
        *(text_column("Note", wide=True), text_column("Origin")),
    )
    printed = any(row["hand_tuned"] for row in table)
    ranged, metric = any(row[4] for row in rows), any(row["fitted_metric"] for row in table)
    summary = (
        _TOLERANCE_NOTE if ranged else "",
        _SD_NOTE,
        _METRIC_FIT_NOTE if metric else "",
        _PUBLISHED_NOTE if printed else "",
    )
    compared = dict.fromkeys(str(row["comparable"]) for row in table if row["hand_tuned"])
    notes = (" ".join(sentence for sentence in summary if sentence), *compared)
    caption = "Parameters, beside the paper’s." if printed else "Parameters."
    return drop_empty_columns(
        TableLayout("parameters", caption, columns, tuple(rows), tuple(breaks), (), notes)
    )


def lay_out_baselines(results: Sequence[Results], role: str) -> TableLayout:
    """Return every method's errors and its paired difference from the fit on the same insertions."""
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    strong: list[int] = []
    for one in results:
        breaks += [len(rows)] if rows else []
        strong.append(len(rows))
        digits = 3 if (one.errors["comparison"] == "aligned").any() else 2
        for i, row in enumerate(to_records(compare_methods(one, role=role))):
            ours = row["method"] == "fitted"
            cells = (format_mm(row["ipe_mean_mm"], digits), format_mm(row["te_mm"], digits))
            difference = MISSING if ours else _format_difference(row)
            better = "" if ours else f"{row['better']} of {row['insertions']}"
            name = method_name(row["method"], one)
            head = str(study_label(one)) if i == 0 else ""
            rows.append((head, name, str(row["insertions"]), *cells, difference, better, one.origin))
    columns = (
        *(
            text_column("Study"),
            text_column("Method"),
            TableColumn("n"),
            TableColumn("IPE", "mm"),
            TableColumn("TE", "mm"),
        ),
        *(TableColumn("IPE − fitted", "mm"), TableColumn("Fit better on"), text_column("Origin")),
    )
    notes = (
        "Means over the insertions that both could be scored on, measured boundaries. The difference is "
        "paired over insertions, ± its standard error; a negative one means that the method does better.",
    )
    where = "held-out" if role == "validate" else "tuning"
    caption = f"Methods on the same {where} insertions and points."
    return TableLayout("baselines", caption, columns, tuple(rows), tuple(breaks), tuple(strong), notes)


def lay_out_insertions(results: Results, role: str) -> TableLayout:
    """Return the fitted model's errors on single insertions beside their noise floor."""
    rows: list[tuple[str, ...]] = []
    for row in to_records(results.errors):
        if (row["role"], row["method"], row["boundaries"]) == (role, "fitted", "measured"):
            rows.append((*_insertion_cells(row), results.origin))
    columns = (
        *(text_column("Insertion"), text_column("Medium"), TableColumn("Layers"), TableColumn("Depth", "mm")),
        *(
            TableColumn("Tip deflection", "mm"),
            TableColumn("Model", "mm"),
            TableColumn("Median", "mm"),
            TableColumn("IPE", "mm"),
        ),
        *(
            TableColumn("Max", "mm"),
            TableColumn("TE", "mm"),
            TableColumn("EDP", "%"),
            TableColumn("Floor IPE", "mm"),
        ),
        *(TableColumn("Floor TE", "mm"), text_column("Origin")),
    )
    notes = (
        "“Tip deflection” is the measured deflection of the tip, positive toward the bevel; “Model” is the "
        "predicted "
        "one. † bends less than the noise floor.",
    )
    return TableLayout("insertions", "Errors of single insertions.", columns, tuple(rows), (), (), notes)


def lay_out_directions(results: Results) -> TableLayout:
    """Return the combinations of parameters that the data determine, and how well."""
    rows = to_records(results.directions)
    folds = len({row["fold"] for row in rows}) > 1
    cells = tuple(
        (
            str(row["fold"]) if folds else "",
            format_number(row["sd"]),
            insert_symbols(str(row["words"])),
            results.origin,
        )
        for row in rows
    )
    columns = (
        text_column("Fold"),
        TableColumn("Sd"),
        text_column("Combination", wide=True),
        text_column("Origin"),
    )
    caption = "What the data know of the parameters: the best and the worst known combinations."
    notes = (
        "Linear about the fitted point, and only as far as the model and the stated noise hold: along a "
        "curved ridge the combination turns, so a point far along it may lie many of these deviations away.",
    )
    return drop_empty_columns(TableLayout("directions", caption, columns, cells, (), (), notes))


def lay_out_contradictions(claims: Sequence[Claim]) -> TableLayout:
    """Return the contradictions in the paper, both places side by side."""
    columns = (
        text_column("What", wide=True),
        text_column("One place", wide=True),
        text_column("The other", wide=True),
        text_column("Note", wide=True),
    )
    rows = tuple(
        (c.topic, f"{c.place}: {c.statement}", f"{c.other_place}: {c.other_statement}", c.note)
        for c in claims
    )
    breaks = tuple(range(1, len(rows)))
    return TableLayout(
        "contradictions",
        "Statements of the paper that it does not bear out elsewhere.",
        columns,
        rows,
        breaks,
    )


def _parameter_cells(row: Row) -> tuple[str, ...]:
    known = bool(row["determined"])
    spread = [typeset(format_number(row[key])) if known else "" for key in ("spread_low", "spread_high")]
    note = _NOT_DETERMINED_PREFIX.sub(r"\1", str(row["note"] or ""))
    return (
        format_symbol(row["parameter"]),
        _value_cell(row["fitted"]),
        " to ".join(dict.fromkeys(spread)) if all(spread) else "",
        format_number(row["sd"]),
        _value_cell(row["fitted_metric"]),
        _value_cell(row["hand_tuned"]),
        _value_cell(row["hand_tuned_b"]),
        "; ".join(part for part in (_format_status(row), insert_symbols(note)) if part),
    )


def _value_cell(printed: str) -> str:
    return printed if printed == NOT_DETERMINED else typeset(printed)


def _format_status(row: Row) -> str:
    """Return "tied" or "fixed" where the note does not say so already."""
    status = str(row["status"])
    return "" if status == "free" or status in str(row["note"]) else status


def _format_difference(row: Row) -> str:
    if row["difference_mm"] is None:
        return MISSING
    error = "" if row["difference_se_mm"] is None else f" ± {row['difference_se_mm']:.3f}"
    return f"{row['difference_mm']:+.3f}{error}".replace("-", "−")


def _insertion_cells(row: Row) -> tuple[str, ...]:
    digits = 3 if row["comparison"] == "aligned" else 2
    scores = [format_mm(row[f"{m}_mm"], digits) for m in ("median_err", "ipe_mean", "ipe_max", "te")]
    bends = [format_mm(row[m]).replace("-", "−") for m in ("deflection_mm", "predicted_deflection_mm")]
    floors = [format_mm(row[f"floor_{m}_mm"], digits) for m in ("ipe_mean", "te")]
    edp = format_percent(row["edp_percent"]) + ("†" if row["edp_flagged"] else "")
    name = str(row["insertion"]) + ("" if row["converged"] else " (did not converge)")
    head = (name, medium_name(row["medium"]), str(row["layers"]), format_mm(row["depth_mm"]))
    return (*head, *bends, *scores, edp, *floors)
