"""Format numbers for print: significant digits, readable exponents, a dash for missing values; intervals."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeGuard

from needlefit.inference.parameter_names import is_logarithmic
from needlefit.mechanics.laws import list_shape_parameters
from needlefit.metrics import METRICS, TE, Metric

MISSING = "–"  # sign in place of a missing value
_PARAMETER_PATTERN = re.compile(
    r"\b(?:mu\d+(?:_pa)?|[a-z_]+[1-9]\d*|bevel_mm|cut_angle_deg|guide_distance_mm|bevel_spread)\b"
)
_POWER_PATTERN = re.compile(r"\b\d(?:\.\d+)?e-?\d+\b")
# pattern of the minus of a number, not of an exponent or a range
_MINUS_PATTERN = re.compile(r"(?<![\w^.-])-(?=\d)")
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_STRESS_UNITS = ((1e6, "MPa"), (1e3, "kPa"))


def format_number(value: float | None) -> str:
    """Return three significant digits in a form that Python reads back: 0.0847, 2.13e5."""
    if not is_known(value):
        return ""
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    power = int(exponent)
    if -3 <= power < 4:
        digits = max(0, 2 - power)
        plain = f"{float(f'{value:.2e}'):z.{digits}f}"
        return plain.rstrip("0").rstrip(".") if digits else plain
    return f"{mantissa.rstrip('0').rstrip('.')}e{power}"


def typeset(text: str) -> str:
    """Return a result of `format_number` as it is printed in books: 2.13 × 10⁵, with a true minus."""
    mantissa, e, exponent = text.partition("e")
    if e and exponent.lstrip("-").isdigit():
        power = f"10{exponent.translate(_RAISED)}"
        return power if mantissa == "1" else f"{mantissa.replace('-', '−')} × {power}"
    return text.replace("-", "−") if text[1:2].isdigit() else text


def format_quantity(parameter: str, value: float | None) -> str:
    """Return a parameter's value with its unit: 196 kPa, 48.3 MPa, 0.0999 mm; empty if it is missing."""
    return format_quantity_range(parameter, value, value)


def format_quantity_range(parameter: str, low: float | None, high: float | None) -> str:
    """Return "124 to 289 kPa", or one value with its unit where both ends are printed alike."""
    if not (is_known(low) and is_known(high)):
        return ""
    scale, unit = choose_unit(parameter, high)
    texts = [format_plain(value / scale) for value in (low, high)]
    return f"{' to '.join(dict.fromkeys(texts))} {unit}".strip()


def choose_unit(parameter: str, value: float) -> tuple[float, str]:
    """Return the unit in which people read a parameter of this size, and that unit in the unit of files."""
    if not parameter.endswith("_pa"):
        return 1.0, {"mm": "mm", "deg": "°"}.get(parameter.rpartition("_")[2], "")
    return next(((scale, unit) for scale, unit in _STRESS_UNITS if value >= scale), _STRESS_UNITS[-1])


def format_plain(value: float) -> str:
    """Return three significant digits without an exponent where that is readable."""
    text = format_number(value)
    return f"{float(text):.0f}" if "e" in text and 1 < abs(value) < 1e6 else typeset(text)


def is_known(value: float | None) -> TypeGuard[float]:
    return value is not None and math.isfinite(value)


def format_mm(value: float | None, digits: int = 2) -> str:
    """Return a length in mm as text, with the paper's precision."""
    return f"{value:z.{digits}f}" if is_known(value) else MISSING


def format_to_error(value: float, error: float | None) -> str:
    """Return a number in the digits that its standard error supports, two decimals at most.

    The error is two units of the last digit at most. Without an error it has two significant digits. Its
    minus is a true one.
    """
    if error is None or not error > 0:
        text = f"{value:.2g}"
    else:
        text = f"{value:z.{min(2, max(0, math.floor(-math.log10(error / 2))))}f}"
    return text.replace("-", "−")


def format_signed_mm(value: float | None, digits: int = 2) -> str:
    """Return a difference in mm as text with its sign (a true minus); a rounded 0 has no sign."""
    if not is_known(value):
        return MISSING
    text = f"{value:+.{digits}f}"
    return text[1:] if float(text) == 0 else text.replace("-", "−")


def format_percent(value: float | None) -> str:
    """Return a percentage with three significant digits, as in the paper: 4.77, 10.3, 254."""
    if not is_known(value):
        return MISSING
    digits = 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0
    return f"{value:z.{digits}f}"


def format_metric(metric: Metric, value: float | None, digits: int = 2) -> str:
    """Return an error as text, lengths with this number of digits."""
    if metric.unit == "mm":
        return format_mm(value, digits)
    return format_percent(value) if metric.unit == "%" else format_number(value) or MISSING


def format_error(value: float, metric: str = TE.name) -> str:
    """Return an error by a metric with its unit; lengths below 0.1 mm have a third decimal."""
    error_metric = METRICS[metric]
    return f"{format_metric(error_metric, value, 3 if value < 0.1 else 2)} {error_metric.unit}"


NO_BREAK = "\u00a0"  #: no-break space, at which no line is broken
_UNITS = "mm²|mm|1/m|cm|%|kPa|MPa|GPa|Pa|N|HU|°|degrees|SD|nats|times"
_BOUND_PATTERN = re.compile(rf"(?<=[\d⁰¹²³⁴⁵⁶⁷⁸⁹]) (?=(?:{_UNITS})(?!\w)|[±×] \d)|(?<=[±×]) (?=\d)")


def bind_numbers(words: str) -> str:
    """Return words in which no line is broken between a number and its unit, or about ± and ×."""
    return _BOUND_PATTERN.sub(NO_BREAK, words)


def join_words(words: Sequence[str]) -> str:
    """Return words as text: "a", "a and b", "a, b and c"."""
    return " and ".join(part for part in (", ".join(words[:-1]), *words[-1:]) if part)


def format_symbol(parameter: str) -> str:
    """Return the symbol and unit of a parameter: `mu1_pa` is μ₁ (Pa)."""
    shape = (
        (shape_parameter.name, shape_parameter.symbol, shape_parameter.unit and f" ({shape_parameter.unit})")
        for shape_parameter in list_shape_parameters()
    )
    for name, sign, unit in (("mu", "μ", " (Pa)"), *shape):
        index = parameter.removeprefix(name).removesuffix("_pa")
        if parameter.startswith(name) and index.isdigit():
            return sign + index.translate(_LOWERED) + unit
    return {
        "bevel_mm": "b (mm)",
        "cut_angle_deg": "θ (°)",
        "guide_distance_mm": "guide to entry (mm)",
        "noise_scale": "noise scale",
        "bevel_spread": "bevel CV",
    }.get(parameter, parameter)


def format_bare_symbol(parameter: str) -> str:
    """Return the symbol of a parameter without its unit: `mu1_pa` is μ₁."""
    return format_symbol(parameter).split(" (")[0]


def choose_printed_unit(parameter: str, values: Iterable[float | None]) -> tuple[str, float]:
    """Return the symbol of a parameter with the unit that fits the largest known value, and that unit in Pa.

    Of a parameter that is no stress the second is 1.
    """
    sizes = [*filter(is_known, values)]
    if not sizes or not parameter.endswith("_pa"):
        return format_symbol(parameter), 1.0
    scale, unit = choose_unit(parameter, max(sizes))
    return format_symbol(parameter).replace("(Pa)", f"({unit})"), scale


def insert_symbols(words: str) -> str:
    """Return a sentence with its parameters and powers typeset: `mu1_pa * bevel_mm` becomes μ₁ · b.

    Exponents stay `^0.28`: what sets the sentence raises them, because Unicode has no raised point.
    """
    named = _PARAMETER_PATTERN.sub(lambda match: format_bare_symbol(match[0]), words)
    true = _MINUS_PATTERN.sub("−", named)
    return _POWER_PATTERN.sub(lambda match: typeset(match[0]), true).replace(" * ", " · ")


# ---- the one 95 % interval of a parameter


def interval_width(name: str, low: float, high: float) -> float:
    """Return the width of an interval of a parameter (Pa, mm): of ln for moduli and lengths."""
    return math.log(high / low) if is_logarithmic(name) else high - low


def typeset_interval(row: Mapping[str, Any], unit: float = 1.0) -> str:
    """Return the printed interval of a row, moduli in `unit` Pa; empty where there is none."""
    ends = [*filter(is_known, (row.get("interval_low"), row.get("interval_high")))]
    return " to ".join(typeset(format_number(end / unit)) for end in ends) if len(ends) == 2 else ""


def choose_interval_unit(row: Mapping[str, Any], *values: float | None) -> tuple[str, float]:
    """Return symbol and unit as `choose_printed_unit`, for values and the interval."""
    return choose_printed_unit(
        str(row["parameter"]), [*values, row.get("interval_low"), row.get("interval_high")]
    )


def round_significant(value: float, digits: int) -> float:
    """Return a number rounded to significant digits."""
    return float(f"{value:.{digits - 1}e}")
