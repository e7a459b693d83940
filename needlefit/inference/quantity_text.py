"""Print numbers and parameters: three digits, readable exponents, one unit for each interval."""

import math

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def format_number(value: float | None) -> str:
    """Return three significant digits in a form that Python reads back: 0.0847, 2.13e5."""
    if not is_known(value):
        return ""
    assert value is not None
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


_STRESS_UNITS = ((1e6, "MPa"), (1e3, "kPa"))


def format_quantity(parameter: str, value: float | None) -> str:
    """Return a parameter's value with its unit: 196 kPa, 48.3 MPa, 0.0999 mm; empty if it is missing."""
    return format_quantity_range(parameter, value, value)


def format_quantity_range(parameter: str, low: float | None, high: float | None) -> str:
    """Return "124 to 289 kPa", or one value with its unit where both ends are printed alike."""
    if not (is_known(low) and is_known(high)):
        return ""
    assert low is not None and high is not None
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
    return (
        (f"{float(text):.0f}" if abs(value) < 1e6 else typeset(text))
        if "e" in text and abs(value) > 1
        else typeset(text)
    )


def is_known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
