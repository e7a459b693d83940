"""Print the one 95 % interval of a parameter, as all tables, figures and macros do."""

import math

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.number_format import choose_printed_unit, format_number, typeset
from needlefit.reporting.table_files import Row

MAX_BOUNDS_SHARE = 0.5
"""Part of the width of its bounds that an interval may have, in ln (alpha: itself), to be printed."""

NO_INTERVAL = "not determined"


def interval_width(name: str, low: float, high: float) -> float:
    """Return the width of an interval of a parameter (Pa, mm): of ln for moduli and lengths."""
    return math.log(high / low) if is_logarithmic(name) else high - low


def format_interval(row: Row, unit: float = 1.0) -> str:
    """Return the printed interval of a row, moduli in `unit` Pa; `NO_INTERVAL` where it spans most bounds."""
    low, high = row.get("interval_low"), row.get("interval_high")
    if low is None or high is None or not math.isfinite(low):
        return ""
    name = str(row["parameter"])
    bounds = [float(row.get(end) or math.nan) for end in ("bound_low", "bound_high")]
    if interval_width(name, low, high) > MAX_BOUNDS_SHARE * interval_width(name, *bounds):  # NaN: no bounds
        return NO_INTERVAL
    return f"{format_number(low / unit)} to {format_number(high / unit)}"


def choose_interval_unit(row: Row, *values: float | None) -> tuple[str, float]:
    """Return symbol and unit as `choose_printed_unit`, for values and, where it is printed, the interval."""
    printed = format_interval(row) not in ("", NO_INTERVAL)
    ends = [row[end] for end in ("interval_low", "interval_high")] if printed else []
    return choose_printed_unit(str(row["parameter"]), [*values, *ends])


def typeset_interval(row: Row, unit: float = 1.0) -> str:
    """Return `format_interval` as it is printed in books."""
    return " to ".join(map(typeset, format_interval(row, unit).split(" to ")))
