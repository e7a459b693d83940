"""What is identifiable as tables for print and as sentences, and how two runs differ in it."""

import math

import pandas as pd

from needlefit.inference.identifiability import directions
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.number_format import (
    choose_interval_unit,
    choose_printed_unit,
    format_number,
    format_quantity_range,
    typeset,
    typeset_interval,
)
from needlefit.reporting.table import Table, TableLayout
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.fit_frames import COLUMNS


def describe_verdicts(identification: pd.DataFrame) -> list[str]:
    """Return one sentence per parameter: its 95 % interval, and under which assumption it is determined.

    What information, profile and draws give apart, and where they disagree, is in `identify.csv`.
    """
    summary = []
    for row in to_records(identification):
        name, condition = directions.short_name(str(row["parameter"])), row.get("note")
        if row["status"] == "fixed":
            summary.append(f"{name} (fixed at {format_number(row['value'])}): {describe_evidence(row)}.")
        else:
            summary.append(f"{name}: {_describe_interval(row)}{f'; {condition}' if condition else ''}.")
    return summary


NEGLIGIBLE_RISE = 0.1  #: rise of the log posterior by which two ends of a search are equally good


def describe_evidence(row: Row) -> str:
    """Return what the data say of a shape parameter: its 95 % interval of its prior, and what they add to it.

    `row` is one of the frame "identification". Of a fixed parameter it says what freeing it does, and how
    much the log posterior rises by that: "−2.8 to 4.8 of −3 to 5: the data add nothing".
    """
    low, high = row["interval_low"], row["interval_high"]
    # two digits of the width: a limit of 4.785 of 5 says no more than 4.8
    decimals = max(0, 1 - math.floor(math.log10(high - low))) if high > low else 2
    interval = " to ".join(typeset(f"{end:.{decimals}f}") for end in (low, high))
    prior = format_quantity_range(str(row["parameter"]), row["bound_low"], row["bound_high"])
    adds = row["sd_ratio"] < directions.UNINFORMED_SD_RATIO
    text = f"{interval} of {prior}: the data {'narrow it' if adds else 'add nothing'}"
    rise = row.get("log_posterior_rise")
    if rise is None or (not adds and rise < NEGLIGIBLE_RISE):
        return text
    size = f"less than {NEGLIGIBLE_RISE:g}" if rise < NEGLIGIBLE_RISE else format_number(rise)
    return f"{text}; the log posterior rises by {size}"


def _describe_interval(row: Row) -> str:
    """Return the interval of the draws, or what the profile says where there are none."""
    if row.get("draw_source") in (None, "", "profile"):
        return str(row["profile_verdict"])
    text = format_quantity_range(str(row["parameter"]), row["interval_low"], row["interval_high"])
    words = {"yes": "", "only together": "determined only together with others: ", "no": "not determined: "}
    return f"{words[row['determined']]}95 % CI {text}"


def format_small_mm(value: float) -> str:
    """Return a length as text, also one close to 0."""
    return "less than 0.001" if value < 1e-3 else f"{value:.2g}"


_INTERVAL_NOTE = (
    "The 95 % interval is that of the posterior draws if they are certified, else that of the profile "
    "likelihood, open at a bound. A fixed α is freed for this table only: its interval is that of the "
    "posterior that it would have, of its bounds. All other values are in identify.csv."
)


_SD_NOTE = (
    "“SD”: by Fisher information and bounds, relative (in % or as a factor) but for α. “SD ratio”: posterior "
    "SD / prior SD (bounds or a stated prior); 1 where the data add nothing. The interval is that of the "
    "profile likelihood, open at a bound. A fixed α is freed for this table only: the last column has the "
    "interval of the posterior that it would have, of its bounds."
)


def lay_out_identification(identification: pd.DataFrame, expected: bool = False) -> TableLayout:
    """Return one row per parameter; for a design also where information and profile disagree."""
    several = identification["fold"].nunique() > 1
    rows = [
        {**row, **_identification_cells(row, expected), "fold": row["fold"] if several else ""}
        for row in to_records(identification)
    ]
    known = (
        ("sd", "profile_low", "profile_high", "sd_ratio", "tip_range_mm", "agreement")
        if expected
        else ("interval_95", "note", "tip_range_mm")
    )
    columns = ("fold", "parameter", "determined", *known)
    caption = f"Identifiability of each parameter from the {'design' if expected else 'data'}."
    groups, notes = ("fold", "status"), (_SD_NOTE if expected else _INTERVAL_NOTE,)
    table = Table("identification", rows, columns, groups=groups, caption=caption, notes=notes)
    return table.lay_out(drop_empty=True)


def _identification_cells(row: Row, expected: bool) -> Row:
    name = str(row["parameter"])
    closed = {side: row[side] for side in ("low", "high") if row[f"end_{side}"] == "closed"}
    label, unit = (
        choose_printed_unit(name, [row["value"], *closed.values()])
        if expected
        else choose_interval_unit(row, row["value"])
    )
    fixed = row["status"] == "fixed"
    remarks = [row["agreement"], row.get("note") if expected else None]
    remarks = [describe_evidence(row)] if fixed else remarks
    return {
        **{side: closed[side] / unit if side in closed else "open" for side in ("low", "high")},
        "sd": None if row["sd"] is None else directions.format_sd(row["sd"], is_logarithmic(name)),
        "parameter": label + (", fixed" if fixed else ""),
        "agreement": "; ".join(filter(None, remarks)),
        "tip_range_mm": "" if row["tip_range_mm"] is None else format_small_mm(row["tip_range_mm"]),
        "interval_95": describe_evidence(row) if fixed else typeset_interval(row, unit),
    }


def tabulate_identification(identification: pd.DataFrame, origin: str) -> pd.DataFrame:
    """Return the rows of `identify.csv`.

    `value` is where the profile is lowest, or where a design was looked at; without `determined` it is no
    estimate.
    """
    return identification.assign(origin=origin).reindex(columns=[*COLUMNS["identification"], "origin"])
