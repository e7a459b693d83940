"""The table of what is identifiable, of a fit and of a design."""

import math

import pandas as pd

from needlefit.inference.identifiability import directions
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.number_format import (
    choose_interval_unit,
    choose_printed_unit,
    format_quantity_range,
    typeset,
    typeset_interval,
)
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row, to_records


def describe_evidence(row: Row) -> str:
    """Return what the data add to a fixed shape parameter: "−2.8 to 4.8 of −3 to 5: the data add nothing".

    `row` is one of the frame "identification": the interval is that of the posterior if it were free.
    """
    low, high = row["interval_low"], row["interval_high"]
    # two digits of the width: a limit of 4.785 of 5 says no more than 4.8
    decimals = max(0, 1 - math.floor(math.log10(high - low))) if high > low else 2
    interval = " to ".join(typeset(f"{end:.{decimals}f}") for end in (low, high))
    prior = format_quantity_range(str(row["parameter"]), row["bound_low"], row["bound_high"])
    adds = row["sd_ratio"] < directions.UNINFORMED_SD_RATIO
    return f"{interval} of {prior}: the data {'narrow it' if adds else 'add nothing'}"


_INTERVAL_NOTE = (
    "The 95 % interval is that of the posterior draws if they are certified, else that of the profile "
    "likelihood, open at a bound. A fixed α is freed for this table only: its interval is that of the "
    "posterior that it would have, of its bounds. All other values are in identify.csv."
)


def lay_out_identification(identification: pd.DataFrame, expected: bool = False) -> TableLayout:
    """Return one row per parameter; for a design also where information and profile disagree."""
    several = identification["fold"].nunique() > 1
    rows = [
        {**row, **_format_cells(row, expected), "fold": row["fold"] if several else ""}
        for row in to_records(identification)
    ]
    known = (
        ("sd", "profile_low", "profile_high", "sd_ratio", "tip_range_mm", "agreement")
        if expected
        else ("interval_95", "note", "tip_range_mm")
    )
    columns = ("fold", "parameter", "determined", *known)
    caption = f"Identifiability of each parameter from the {'design' if expected else 'data'}."
    notes = () if expected else (_INTERVAL_NOTE,)  # what a design has stands in the text of its report
    table = Table("identification", rows, columns, groups=("fold", "status"), caption=caption, notes=notes)
    return table.lay_out(drop_empty=True)


def _format_cells(row: Row, expected: bool) -> Row:
    name, tip, fixed = str(row["parameter"]), row["tip_range_mm"], row["status"] == "fixed"
    closed = {side: row[side] for side in ("low", "high") if row[f"end_{side}"] == "closed"}
    if expected:
        label, unit = choose_printed_unit(name, [row["value"], *closed.values()])
    else:
        label, unit = choose_interval_unit(row, row["value"])
    doubts = () if row["agreement"] == directions.AGREEMENT else (row["agreement"],)
    words = describe_evidence(row) if fixed else "; ".join(filter(None, (*doubts, row["note"])))
    return {
        **{side: closed[side] / unit if side in closed else "open" for side in ("low", "high")},
        "sd": None if row["sd"] is None else directions.format_sd(row["sd"], is_logarithmic(name)),
        "parameter": label + (", fixed" if fixed else ""),
        "agreement": words,
        "tip_range_mm": "" if tip is None else "less than 0.001" if tip < 1e-3 else f"{tip:.2g}",
        "interval_95": words if fixed else typeset_interval(row, unit),
    }
