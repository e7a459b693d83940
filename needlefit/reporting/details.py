"""More tables for print: parameters, rivals, single insertions, directions, the paper's contradictions."""

import re
from collections.abc import Sequence

from needlefit.reporting.display import Column, Display, text, without, without_empty
from needlefit.reporting.names import medium_name, method_name
from needlefit.reporting.numbers import MISSING, fixed, in_symbols, number, percent, symbol, typeset
from needlefit.reporting.parameters import NOT_DETERMINED, parameters_table
from needlefit.reporting.tables import Row, records, study_label
from needlefit.validation.paper.claims import Claim
from needlefit.validation.results import Results
from needlefit.validation.summary import compare_methods

_AS_GOOD = (
    "“As good” is the range over starts whose objective is practically the best; it is left empty for what "
    "is not determined, where starts may agree without the data knowing."
)
_ESTIMATES = (
    "“Sd” is the Cramér-Rao bound, of ln for μ and b, of the value for α: what this model misses, and the "
    "rules that were decided, are not in it. It stands where errors have their noise floor, for of a "
    "parameter there is none. μ is an effective foundation modulus of this model, not a material constant."
)
_NOT_SAID_TWICE = re.compile(r"^not determined(?:: | \(([^()]*)\))")  # the column "Fitted" says it
_BY_ERRORS = (
    "“By errors” is the second fit, which minimises IPE, TE and EDP as tuning by hand does; what the data do "
    "not determine is no estimate there either."
)
_BY_HAND = (
    "“By hand” is the paper’s set, never a start of the search; “b re-tuned” is that set with b alone fitted "
    "to the same insertions."
)


def parameters_layout(results: Sequence[Results]) -> Display:
    """Return both fits beside the paper's hand-tuned set and that set with b alone re-tuned."""
    return _parameters_display(records(parameters_table(*results)))


def free_parameters_layout(results: Sequence[Results]) -> Display:
    """Return the same for the free parameters alone, without notes: several studies on one page."""
    table = parameters_table(*results)
    return without(_parameters_display(records(table[table["status"] == "free"])), "Note")


def _parameters_display(table: list[Row]) -> Display:
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
        rows.append((*head, *_parameter(row), str(row["origin"]) if mixed else ""))
    columns = (
        *(text("Study"), text("Fold"), text("Parameter"), Column("Fitted")),
        *(Column("As good"), Column("Sd"), Column("By errors"), Column("By hand"), Column("b re-tuned")),
        *(text("Note", wide=True), text("Origin")),
    )
    printed = any(row["hand_tuned"] for row in table)
    ranged, metric = any(row[4] for row in rows), any(row["fitted_metric"] for row in table)
    said = (_AS_GOOD if ranged else "", _ESTIMATES, _BY_ERRORS if metric else "", _BY_HAND if printed else "")
    compared = dict.fromkeys(str(row["comparable"]) for row in table if row["hand_tuned"])
    notes = (" ".join(sentence for sentence in said if sentence), *compared)
    caption = "Parameters, beside the paper’s." if printed else "Parameters."
    return without_empty(Display("parameters", caption, columns, tuple(rows), tuple(breaks), (), notes))


def rivals_layout(results: Sequence[Results], role: str) -> Display:
    """Return every method's errors and its paired difference from the fit on the same insertions."""
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    strong: list[int] = []
    for one in results:
        breaks += [len(rows)] if rows else []
        strong.append(len(rows))
        digits = 3 if (one.errors["comparison"] == "aligned").any() else 2
        for i, row in enumerate(records(compare_methods(one, role=role))):
            ours = row["method"] == "fitted"
            cells = (fixed(row["ipe_mean_mm"], digits), fixed(row["te_mm"], digits))
            gap = MISSING if ours else _difference(row)
            better = "" if ours else f"{row['better']} of {row['insertions']}"
            name = method_name(row["method"], one)
            head = str(study_label(one)) if i == 0 else ""
            rows.append((head, name, str(row["insertions"]), *cells, gap, better, one.origin))
    columns = (
        *(text("Study"), text("Method"), Column("n"), Column("IPE", "mm"), Column("TE", "mm")),
        *(Column("IPE − fitted", "mm"), Column("Fit better on"), text("Origin")),
    )
    notes = (
        "Means over the insertions that both could be scored on, measured boundaries. The difference is "
        "paired over insertions, ± its standard error; a negative one means that the method does better.",
    )
    where = "held-out" if role == "validate" else "tuning"
    caption = f"What the model has to beat, on the same {where} insertions and points."
    return Display("rivals", caption, columns, tuple(rows), tuple(breaks), tuple(strong), notes)


def insertions_layout(results: Results, role: str) -> Display:
    """Return the fitted model's errors on single insertions beside their noise floor."""
    rows: list[tuple[str, ...]] = []
    for row in records(results.errors):
        if (row["role"], row["method"], row["boundaries"]) == (role, "fitted", "measured"):
            rows.append((*_insertion(row), results.origin))
    columns = (
        *(text("Insertion"), text("Medium"), Column("Layers"), Column("Depth", "mm")),
        *(Column("Bends", "mm"), Column("Model", "mm"), Column("Median", "mm"), Column("IPE", "mm")),
        *(Column("Max", "mm"), Column("TE", "mm"), Column("EDP", "%"), Column("Floor IPE", "mm")),
        *(Column("Floor TE", "mm"), text("Origin")),
    )
    notes = (
        "“Bends” is the measured deflection of the tip, positive toward the bevel; “Model” is the predicted "
        "one. † bends less than the noise floor.",
    )
    return Display("insertions", "Errors of single insertions.", columns, tuple(rows), (), (), notes)


def directions_layout(results: Results) -> Display:
    """Return which combinations of parameters the data know, and how well."""
    rows = records(results.directions)
    folds = len({row["fold"] for row in rows}) > 1
    cells = tuple(
        (str(row["fold"]) if folds else "", number(row["sd"]), in_symbols(str(row["words"])), results.origin)
        for row in rows
    )
    columns = (text("Fold"), Column("Sd"), text("Combination", wide=True), text("Origin"))
    caption = "What the data know of the parameters: the best and the worst known combinations."
    notes = (
        "Linear about the fitted point, and only as far as the model and the stated noise hold: along a "
        "curved ridge the combination turns, so a point far along it may lie many of these deviations away.",
    )
    return without_empty(Display("directions", caption, columns, cells, (), (), notes))


def contradictions_layout(claims: Sequence[Claim]) -> Display:
    """Return the paper's contradictions, both places side by side."""
    columns = (
        text("What", wide=True),
        text("One place", wide=True),
        text("The other", wide=True),
        text("Note", wide=True),
    )
    rows = tuple(
        (c.topic, f"{c.place}: {c.statement}", f"{c.other_place}: {c.other_statement}", c.note)
        for c in claims
    )
    breaks = tuple(range(1, len(rows)))
    return Display(
        "contradictions",
        "Statements of the paper that it does not bear out elsewhere.",
        columns,
        rows,
        breaks,
    )


def _parameter(row: Row) -> tuple[str, ...]:
    known = bool(row["determined"])
    spread = [typeset(number(row[key])) if known else "" for key in ("spread_low", "spread_high")]
    note = _NOT_SAID_TWICE.sub(r"\1", str(row["note"] or ""))
    return (
        symbol(row["parameter"]),
        _cell(row["fitted"]),
        " to ".join(dict.fromkeys(spread)) if all(spread) else "",
        number(row["sd"]),
        _cell(row["fitted_metric"]),
        _cell(row["hand_tuned"]),
        _cell(row["hand_tuned_b"]),
        "; ".join(part for part in (_status(row), in_symbols(note)) if part),
    )


def _cell(printed: str) -> str:
    return printed if printed == NOT_DETERMINED else typeset(printed)


def _status(row: Row) -> str:
    """Return "tied" or "fixed" where the note does not say so already."""
    status = str(row["status"])
    return "" if status == "free" or status in str(row["note"]) else status


def _difference(row: Row) -> str:
    if row["difference_mm"] is None:
        return MISSING
    error = "" if row["difference_se_mm"] is None else f" ± {row['difference_se_mm']:.3f}"
    return f"{row['difference_mm']:+.3f}{error}".replace("-", "−")


def _insertion(row: Row) -> tuple[str, ...]:
    digits = 3 if row["comparison"] == "aligned" else 2
    scores = [fixed(row[f"{m}_mm"], digits) for m in ("median_err", "ipe_mean", "ipe_max", "te")]
    bends = [fixed(row[m]).replace("-", "−") for m in ("deflection_mm", "predicted_deflection_mm")]
    floors = [fixed(row[f"floor_{m}_mm"], digits) for m in ("ipe_mean", "te")]
    edp = percent(row["edp_percent"]) + ("†" if row["edp_flagged"] else "")
    name = str(row["insertion"]) + ("" if row["converged"] else " (did not converge)")
    head = (name, medium_name(row["medium"]), str(row["layers"]), fixed(row["depth_mm"]))
    return (*head, *bends, *scores, edp, *floors)
