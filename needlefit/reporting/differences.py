"""Differences of two runs, for a person and for a program."""

from collections.abc import Sequence
from dataclasses import asdict

from needlefit.project.json_values import to_json_values
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.numbers import number
from needlefit.validation.table_differences import Difference

LONGEST = 40
"""Characters of a value that a table shows."""


def said(found: Sequence[Difference]) -> str:
    """Return in one sentence whether anything matters."""
    results = [one for one in found if one.matters is not None]
    if not found:
        return "The runs do not differ."
    if not results:
        return f"The inputs differ in {_counted(len(found), 'key')}, and no result does."
    mattering = sum(bool(one.matters) for one in results)
    inputs = len(found) - len(results)
    because = f" The inputs differ in {_counted(inputs, 'key')}." if inputs else " The inputs are the same."
    if not mattering:
        return f"{_counted(len(results), 'result')} changed, none in a way that matters.{because}"
    verb = "matters" if mattering == 1 else "matter"
    return f"{_counted(len(results), 'result')} changed, {mattering} of which {verb}.{because}"


def differences_layout(found: Sequence[Difference]) -> Display:
    """Return one row per difference that is not slight: those that matter first, inputs last."""
    order = {True: 0, False: 1, None: 2}
    rows = sorted((one for one in found if not one.slight), key=lambda one: order[one.matters])
    slight = len(found) - len(rows)
    cells = tuple(
        (one.what, one.where, _cell(one.before), _cell(one.after), one.why, _MARKS[one.matters])
        for one in rows
    )
    breaks = tuple(k for k in range(1, len(rows)) if rows[k].matters is not rows[k - 1].matters)
    strong = tuple(k for k, one in enumerate(rows) if one.matters)
    heads = (
        text("What"),
        text("Where", wide=True),
        Column("A"),
        Column("B"),
        text("Change"),
        text("Matters"),
    )
    note = (
        "What matters: a parameter that is determined and moved by more than half its standard deviation; an "
        "error that changed by more than 0.005 mm, or a CRPS by more than a tenth, and by two standard "
        "errors on the same insertions; any verdict or state."
    )
    left = (f"Not shown: {_counted(slight, 'change')} of the size of rounding.",) if slight else ()
    return Display("differences", "What B changed from A.", heads, cells, breaks, strong, (note, *left))


def as_json(found: Sequence[Difference]) -> list[object]:
    """Return the differences as plain JSON values."""
    return [to_json_values(asdict(one)) for one in found]


_MARKS = {True: "yes", False: "no", None: ""}


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _cell(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return number(value)
    shown = str(value)
    return shown if len(shown) <= LONGEST else shown[: LONGEST - 1] + "…"
