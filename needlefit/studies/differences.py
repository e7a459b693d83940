"""Present the differences of two runs as a sentence, a table, and JSON."""

from collections.abc import Sequence
from dataclasses import asdict

from needlefit.project.json_values import to_json_values
from needlefit.reporting.number_format import format_number
from needlefit.reporting.table import Table
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.run_differences import Difference

MAX_CELL_LETTERS = 40  #: characters of a value that a table shows


def summarize_differences(found: Sequence[Difference]) -> str:
    """Return whether any difference matters, and how many there are."""
    results = [one for one in found if one.matters is not None]
    if not found:
        return "No difference."
    inputs = len(found) - len(results)
    because = f"{count_words(inputs, 'input')} {_differ(inputs)}" if inputs else "the inputs are the same"
    if not results:
        return f"No result differs; {because}."
    relevant = sum(bool(one.matters) for one in results)
    rounding = sum(one.slight and not one.matters for one in results)
    small = len(results) - relevant - rounding
    parts = [
        f"{count_words(count, 'number')} {_differ(count)} {how}"
        for count, how in ((small, "too little to matter"), (rounding, "by rounding"))
        if count
    ]
    head = f"{count_words(relevant, 'relevant change')}." if relevant else "No relevant change."
    return f"{head} {'; '.join([*parts, because])}."


def _differ(count: int) -> str:
    return "differs" if count == 1 else "differ"


def lay_out_differences(found: Sequence[Difference], everything: bool = False) -> TableLayout:
    """Return one row per difference that matters, then the inputs; `everything`: also the other changes."""
    order = {True: 0, False: 1, None: 2}
    shown = [one for one in found if everything or one.matters or one.matters is None]
    rows = sorted(shown, key=lambda one: order[one.matters])
    cells = [
        {
            **{"what": one.what, "found_at": one.where, "changed_by": one.why, "rank": order[one.matters]},
            "before": _format_value(one.before),
            "after": _format_value(one.after),
            "matters": _MARKS[one.matters],
            "strong": bool(one.matters),
        }
        for one in rows
    ]
    columns = ("what", "found_at", "before", "after", "changed_by", *(("matters",) if everything else ()))
    left = len(found) - len(rows)
    note = (
        "A change matters if an identifiable parameter moved by more than half its standard deviation, if a "
        "mean error changed by more than 0.005 mm (a CRPS by more than 10 %) and by more than two standard "
        "errors on the same insertions, if the width of an interval changed by more than 10 %, or if a "
        "verdict (such as that an interval covers too few insertions) or a state changed."
    )
    hidden = (f"Not shown: {left} not relevant (`--all` prints them).",)
    notes = (*((note,) if everything or any(one.matters for one in rows) else ()), *(hidden if left else ()))
    caption = "Changes from A (first run) to B (second run)."
    return Table(
        "differences", caption, cells, columns, groups=("rank",), strong="strong", notes=notes
    ).lay_out()


def differences_to_json(found: Sequence[Difference]) -> list[object]:
    """Return the differences as JSON values."""
    return [to_json_values(asdict(one)) for one in found]


_MARKS = {True: "yes", False: "no", None: ""}


def count_words(count: int, noun: str) -> str:
    """Return "1 key", "2 keys"."""
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _format_value(value: object) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return format_number(value)
    shown = str(value)
    return shown if len(shown) <= MAX_CELL_LETTERS else shown[: MAX_CELL_LETTERS - 1] + "…"
