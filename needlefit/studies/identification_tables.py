"""The table of what is identifiable, of a fit and of a design."""

import math

import pandas as pd

from needlefit.inference.identifiability import directions
from needlefit.inference.parameter_names import is_logarithmic
from needlefit.reporting.number_format import choose_interval_unit, choose_printed_unit, typeset_interval
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row, to_records

_INTERVAL_NOTE = (
    "The 95 % interval is that of the posterior draws if they are certified, else that of the profile "
    "likelihood, open at a bound. All other values are in identify.csv."
)


def lay_out_identification(identification: pd.DataFrame, expected: bool = False) -> TableLayout:
    """Return one row per parameter."""
    several = identification["fold"].nunique() > 1
    rows = [
        {**row, **_format_cells(row, expected), "fold": row["fold"] if several else ""}
        for row in to_records(identification)
    ]
    columns_shown = ("sd", "profile_low", "profile_high", "sd_ratio") if expected else ("interval_95",)
    columns = ("fold", "parameter", "determined", *columns_shown, "note")
    caption = f"Identifiability of each parameter from the {'design' if expected else 'data'}."
    notes = () if expected else (_INTERVAL_NOTE,)  # what a design has stands in the text of its report
    table = Table("identification", rows, columns, groups=("fold",), caption=caption, notes=notes)
    return table.lay_out(drop_empty=True)


def _format_cells(row: Row, expected: bool) -> Row:
    name = str(row["parameter"])
    closed = {side: row[side] for side in ("low", "high") if row[f"end_{side}"] in ("closed", "prior")}
    if expected:
        label, unit = choose_printed_unit(name, [row["value"], *closed.values()])
    else:
        label, unit = choose_interval_unit(row, row["value"])
    return {
        **{side: closed[side] / unit if side in closed else "open" for side in ("low", "high")},
        "sd": None if row["sd"] is None else directions.format_sd(row["sd"], is_logarithmic(name)),
        "parameter": label,
        "interval_95": typeset_interval(row, unit),
        **({} if row["tip_shift_mm"] is None else {"note": describe_prior(row["tip_shift_mm"])}),
    }


def describe_prior(tip_shift_mm: float | None) -> str:
    """Return in words that a parameter is known by its prior alone, which moves a tip by so much at most."""
    if tip_shift_mm is None:
        return "the prior"
    return f"the prior: moves tips by at most {max(1, math.ceil(1000 * tip_shift_mm)) / 1000:g} mm"
