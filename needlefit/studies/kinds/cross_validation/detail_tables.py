"""Tables for print: parameters, methods, single insertions, directions, contradictions in the paper."""

import re
from collections.abc import Iterator, Mapping, Sequence

from needlefit.metrics import headline_metrics, list_metrics
from needlefit.reporting.columns import DIGITS
from needlefit.reporting.interval_text import (
    NO_INTERVAL,
    choose_interval_unit,
    format_interval,
    typeset_interval,
)
from needlefit.reporting.labels import method_name
from needlefit.reporting.number_format import (
    format_bare_symbol,
    format_metric,
    format_number,
    format_quantity,
    format_quantity_range,
    insert_symbols,
    typeset,
)
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.cross_validation.parameter_table import (
    CONDITIONAL,
    METHODS,
    NOT_DETERMINED,
    arrange_parameters,
    is_conditional,
    tabulate_parameters,
)
from needlefit.studies.paper.claims import Claim
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import TE, study_label
from needlefit.studies.summary import compare_methods

_INTERVAL_NOTE = (
    "Fitted: “not determined” if many values fit equally well, “conditional” if the value is determined only "
    "under the assumption in the note. “95 % interval”: of the posterior draws if they are certified, else "
    "of the profile likelihood; with the ties between parameters, without model error; “not determined” "
    "where it spans more than half of the bounds. μ is an effective foundation modulus of this model, not a "
    "material constant."
)
# the column "Fitted" says it
_NOT_DETERMINED_PREFIX = re.compile(r"^not determined(?:[:;] | \(([^()]*)\)|$)")
_METRIC_FIT_NOTE = (
    "The error-minimising fit is the second fit, which minimises IPE, TE and EDP; what the data do "
    "not determine is no estimate there either."
)
_PUBLISHED_NOTE = (
    "“Paper” is the paper’s parameters, never a start of the search; “Paper, b re-fitted” is that set with b "
    "alone fitted to the same insertions."
)


def lay_out_parameters(results: Sequence[Run]) -> TableLayout:
    """Return both fits beside the paper's parameters, and beside these with b re-fitted."""
    return _lay_out_parameter_rows(arrange_parameters(tabulate_parameters(*results)))


def lay_out_free_parameters(results: Sequence[Run]) -> TableLayout:
    """Return the free parameters of several studies in one table, without notes."""
    table = tabulate_parameters(*results)
    rows = [row for row in arrange_parameters(table) if row["status"] == "free"]
    return _lay_out_parameter_rows(rows, noted=False)


def _lay_out_parameter_rows(table: list[Row], noted: bool = True) -> TableLayout:
    folds = len({row["fold"] for row in table}) > 1
    rows = []
    for number, row in enumerate(table):
        named = not number or row["study"] != table[number - 1]["study"]
        about = {
            "group": (row["study"], row["fold"]),
            "study": row["study"] if named else "",
            "fold": row["fold"] if folds else "",
        }
        rows.append({**row, **_parameter_cells(row), **about})
    columns = (
        *("study", "fold", "parameter", "fitted", "interval_95", *METHODS[1:]),
        *(("note",) if noted else ()),
    )
    printed = any(row["hand_tuned"] for row in table)
    metric = any(row["fitted_metric"] for row in table)
    summary = (
        _INTERVAL_NOTE,
        _METRIC_FIT_NOTE if metric else "",
        _PUBLISHED_NOTE if printed else "",
    )
    compared = dict.fromkeys(str(row["comparable"]) for row in table if row["hand_tuned"])
    notes = (" ".join(sentence for sentence in summary if sentence), *compared)
    caption = "Parameters, beside the paper’s." if printed else "Parameters."
    found = Table("parameters", caption, rows, columns, groups=("group",), heads=2, notes=notes)
    return found.lay_out(drop_empty=True)


def lay_out_values(results: Run) -> TableLayout:
    """Return the fitted parameters, each with one 95 % interval; of several folds their range."""
    rows = [row for row in to_records(results.frames["parameters"]) if row["method"] == "fitted"]
    published = {
        row["parameter"]: row["value"]
        for row in to_records(results.frames["parameters"])
        if row["method"] == "hand_tuned"
    }
    names = list(dict.fromkeys(str(row["parameter"]) for row in rows))
    cells = [
        _describe_parameter(name, [r for r in rows if r["parameter"] == name], published) for name in names
    ]
    columns = ("parameter", "fitted", "interval_95", "hand_tuned", "note")
    folds = results.frames["parameters"]["fold"].nunique()
    of = (
        f": range of {folds} folds, and from the least to the greatest end of their intervals"
        if folds > 1
        else ""
    )
    caption = f"Parameters{of}."
    if any(cell["fitted"] == CONDITIONAL for cell in cells):
        caption += " “conditional”: determined only under the assumption in the note."
    return Table("values", caption, cells, columns).lay_out(drop_empty=True)


def _describe_parameter(name: str, rows: list[Row], published: Mapping[str, float]) -> Row:
    """Return the cells of a parameter; a value that the data do not determine is none."""
    row, values = rows[0], [row["value"] for row in rows if row["value"] is not None]
    fixed = row["status"] == "fixed"
    fitted = format_quantity_range(name, min(values), max(values)) if values else ""
    interval = ""
    loose = [] if fixed else [one for one in rows if not one["determined"]]
    conditional = all(map(is_conditional, loose))
    conditions = dict.fromkeys(str(one["condition"]) for one in loose) if conditional else {}
    if not fixed:
        texts = [format_interval(one) for one in rows]
        lows, highs = ([one[f"interval_{end}"] for one in rows] for end in ("low", "high"))
        if all(text not in ("", NO_INTERVAL) for text in texts):
            interval = format_quantity_range(name, min(lows), max(highs))
        else:
            interval = NO_INTERVAL if NO_INTERVAL in texts else ""
    return {
        "parameter": format_bare_symbol(name),
        "fitted": fitted if not loose else CONDITIONAL if conditions else NOT_DETERMINED,
        "interval_95": interval,
        "hand_tuned": format_quantity(name, published.get(name)),
        "note": "fixed" if fixed else "; ".join(conditions),
    }


def lay_out_baselines(results: Sequence[Run], role: str) -> TableLayout:
    """Return every method's errors and its paired difference from the fit on the same insertions."""
    rows = [row for one in results for row in _describe_methods(one, role)]
    errors = (one.name for one in headline_metrics())
    columns = ("study", "method", "insertions", *errors, "te_difference", "better_of")
    notes = (
        "Means over the insertions that both could be scored on, measured boundaries. The difference is "
        "paired over insertions, ± its standard error; a negative one means that the method does better.",
    )
    where = "held-out" if role == "validate" else "tuning"
    caption = f"Methods on the same {where} insertions and points."
    return Table(
        "baselines", caption, rows, columns, groups=("study",), heads=1, strong="groups", notes=notes
    ).lay_out()


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
    notes = (
        "“Tip deflection” is the measured deflection of the tip, positive toward the bevel; “Model” is the "
        "predicted "
        "one. † bends less than the noise floor.",
    )
    return Table("insertions", "Errors of single insertions.", rows, columns, notes=notes).lay_out()


def lay_out_directions(results: Run) -> TableLayout:
    """Return the combinations of parameters that the data determine, and how well."""
    rows = to_records(results.frames["directions"])
    folds = len({row["fold"] for row in rows}) > 1
    cells = [
        {
            "fold": row["fold"] if folds else "",
            "known_combination": insert_symbols(str(row["note"])),
            "origin": results.origin,
        }
        for row in rows
    ]
    columns = ("fold", "known_combination")
    caption = "Best- and worst-determined combinations of parameters."
    notes = (
        "Linear about the fitted point, and only as far as the model and the stated noise hold: along a "
        "curved ridge the combination turns, so these figures hold near the fit only.",
    )
    return Table("directions", caption, cells, columns, notes=notes).lay_out(drop_empty=True)


def lay_out_contradictions(claims: Sequence[Claim]) -> TableLayout:
    """Return the contradictions in the paper, both places side by side."""
    rows = [
        {
            "topic": one.topic,
            "statement": f"{one.place}: {one.statement}",
            "other_statement": f"{one.other_place}: {one.other_statement}",
            "note": one.note,
            "number": number,
        }
        for number, one in enumerate(claims)
    ]
    caption = "Statements of the paper that other parts of it contradict."
    columns = ("topic", "statement", "other_statement", "note")
    return Table("contradictions", caption, rows, columns, groups=("number",)).lay_out()


def _parameter_cells(row: Row) -> Row:
    note = _NOT_DETERMINED_PREFIX.sub(lambda found: found[1] or "", str(row["note"] or ""))
    label, unit = choose_interval_unit(row, row["value_used"])
    return {
        "parameter": label,
        "interval_95": typeset_interval(row, unit),
        **{method: format_in_unit(row[method], unit) for method in METHODS},
        "note": "; ".join(part for part in (_format_status(row), insert_symbols(note)) if part),
    }


def format_in_unit(text: str, unit: float) -> str:
    """Return a value of the files in another unit; words stay."""
    return typeset(
        text if unit == 1 or text in ("", NOT_DETERMINED, CONDITIONAL) else format_number(float(text) / unit)
    )


def _format_status(row: Row) -> str:
    """Return "tied" or "fixed" where the note does not say so already."""
    status = str(row["status"])
    return "" if status == "free" or status in str(row["note"]) else status


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
