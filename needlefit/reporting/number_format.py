"""Format numbers for print: significant digits, readable exponents, a dash for missing values."""

import math
import re

MISSING = "–"
_PARAMETER_PATTERN = re.compile(r"\b(?:mu\d+(?:_pa)?|alpha\d+|bevel_mm|guide_distance_mm)\b")
_POWER_PATTERN = re.compile(r"\b\d(?:\.\d+)?e-?\d+\b")
_MINUS_PATTERN = re.compile(r"(?<![\w^.-])-(?=\d)")  # of a number of its own, not of an exponent or a range
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def format_mm(value: float | None, digits: int = 2) -> str:
    """Return a length in mm as text, with the paper's precision."""
    return f"{value:.{digits}f}" if _is_known(value) else MISSING


def format_signed_mm(value: float | None, digits: int = 2) -> str:
    """Return a difference in mm as text with its sign (a true minus); a rounded 0 has no sign."""
    if not _is_known(value):
        return MISSING
    text = f"{value:+.{digits}f}"
    return text[1:] if float(text) == 0 else text.replace("-", "−")


def format_percent(value: float | None) -> str:
    """Return a percentage with three significant digits, as in the paper: 4.77, 10.3, 254."""
    if not _is_known(value):
        return MISSING
    assert value is not None
    digits = 2 if abs(value) < 9.995 else 1 if abs(value) < 99.95 else 0
    return f"{value:.{digits}f}"


def format_number(value: float | None) -> str:
    """Return three significant digits in a form that Python reads back: 0.0847, 2.13e5."""
    if not _is_known(value):
        return ""
    assert value is not None
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    power = int(exponent)
    if -3 <= power < 4:
        digits = max(0, 2 - power)
        plain = f"{float(f'{value:.2e}'):.{digits}f}"
        return plain.rstrip("0").rstrip(".") if digits else plain
    return f"{mantissa.rstrip('0').rstrip('.')}e{power}"


def typeset(text: str) -> str:
    """Return a result of `format_number` as it is printed in books: 2.13 × 10⁵, with a true minus."""
    mantissa, e, exponent = text.partition("e")
    if e and exponent.lstrip("-").isdigit():
        power = f"10{exponent.translate(_RAISED)}"
        return power if mantissa == "1" else f"{mantissa.replace('-', '−')} × {power}"
    return text.replace("-", "−") if text[1:2].isdigit() else text


def format_symbol(parameter: str) -> str:
    """Return the symbol and unit of a parameter: `mu1_pa` is μ₁ (Pa)."""
    for name, sign, unit in (("mu", "μ", " (Pa)"), ("alpha", "α", "")):
        index = parameter.removeprefix(name).removesuffix("_pa")
        if parameter.startswith(name) and index.isdigit():
            return sign + index.translate(_LOWERED) + unit
    return {
        "bevel_mm": "b (mm)",
        "guide_distance_mm": "guide to entry (mm)",
        "noise_scale": "noise scale",
    }.get(parameter, parameter)


def insert_symbols(words: str) -> str:
    """Return a sentence with its parameters and powers typeset: `mu1_pa * bevel_mm` becomes μ₁ · b.

    Exponents stay `^0.28`: what sets the sentence raises them, because Unicode has no raised point.
    """
    named = _PARAMETER_PATTERN.sub(lambda found: format_symbol(found[0]).split(" (")[0], words)
    true = _MINUS_PATTERN.sub("−", named)
    return _POWER_PATTERN.sub(lambda found: typeset(found[0]), true).replace(" * ", " · ")


def _is_known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
