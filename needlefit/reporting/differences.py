"""Present the differences of two runs as a sentence, a table, and JSON."""

from collections.abc import Sequence
from dataclasses import asdict

from needlefit.project.json_values import to_json_values
from needlefit.reporting.number_format import format_number
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.validation.table_differences import Difference

MAX_CELL_LETTERS = 40
"""Characters of a value that a table shows."""


def summarize_differences(found: Sequence[Difference]) -> str:
    """Return one sentence: whether any difference matters."""
    results = [one for one in found if one.matters is not None]
    if not found:
        return "The runs do not differ."
    if not results:
        return f"The inputs differ in {_count_words(len(found), 'key')}, and no result does."
    mattering = sum(bool(one.matters) for one in results)
    inputs = len(found) - len(results)
    because = (
        f" The inputs differ in {_count_words(inputs, 'key')}." if inputs else " The inputs are the same."
    )
    if not mattering:
        return f"{_count_words(len(results), 'result')} changed, none in a way that matters.{because}"
    verb = "matters" if mattering == 1 else "matter"
    return f"{_count_words(len(results), 'result')} changed, {mattering} of which {verb}.{because}"


def lay_out_differences(found: Sequence[Difference]) -> TableLayout:
    """Return one row per difference that is not negligible: those that matter first, inputs last."""
    order = {True: 0, False: 1, None: 2}
    rows = sorted((one for one in found if not one.slight), key=lambda one: order[one.matters])
    slight = len(found) - len(rows)
    cells = tuple(
        (
            one.what,
            one.where,
            _format_value(one.before),
            _format_value(one.after),
            one.why,
            _MARKS[one.matters],
        )
        for one in rows
    )
    breaks = tuple(k for k in range(1, len(rows)) if rows[k].matters is not rows[k - 1].matters)
    strong = tuple(k for k, one in enumerate(rows) if one.matters)
    heads = (
        text_column("What"),
        text_column("Where", wide=True),
        TableColumn("A"),
        TableColumn("B"),
        text_column("Change"),
        text_column("Matters"),
    )
    note = (
        "What matters: a parameter that is determined and moved by more than half its standard deviation; an "
        "error that changed by more than 0.005 mm, or a CRPS by more than a tenth, and by two standard "
        "errors on the same insertions; any verdict or state."
    )
    left = (f"Not shown: {_count_words(slight, 'change')} of the size of rounding.",) if slight else ()
    return TableLayout("differences", "What B changed from A.", heads, cells, breaks, strong, (note, *left))


def differences_to_json(found: Sequence[Difference]) -> list[object]:
    """Return the differences as JSON values."""
    return [to_json_values(asdict(one)) for one in found]


_MARKS = {True: "yes", False: "no", None: ""}


def _count_words(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return format_number(value)
    shown = str(value)
    return shown if len(shown) <= MAX_CELL_LETTERS else shown[: MAX_CELL_LETTERS - 1] + "…"
