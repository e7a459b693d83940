"""The columns of all tables: each is declared once, with its heading, unit, format and explanation.

`columns.csv` beside this module holds them, a line for each; metrics bring their own. A column that
only a plugin has is printed under its name.
"""

import csv
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Any

from needlefit.inference.baselines import BASELINES
from needlefit.mechanics.laws import list_shape_parameters
from needlefit.metrics import METRICS, list_metrics
from needlefit.reporting.labels import medium_name, method_name
from needlefit.reporting.number_format import (
    MISSING,
    format_metric,
    format_mm,
    format_number,
    format_percent,
    format_signed_mm,
    format_symbol,
    typeset,
)

FORMATS: Mapping[str, Callable[[Any], str]] = {
    "text": str,
    "prose": str,
    "count": lambda value: f"{value:.0f}",
    "plain": lambda value: f"{value:g}".replace("-", "−"),
    "number": lambda value: typeset(format_number(value)) or MISSING,
    "digits": format_number,
    "mm": lambda value: format_mm(value).replace("-", "−"),
    "mm1": lambda value: format_mm(value, 1).replace("-", "−"),
    "mm3": lambda value: format_mm(value, 3).replace("-", "−"),
    "signed": format_signed_mm,
    "signed3": lambda value: format_signed_mm(value, 3),
    "percent0": lambda value: f"{100 * value:.0f}",
    "percent": lambda value: f"{100 * value:.0f} %",
    "relative": format_percent,
    "flag": lambda value: value if isinstance(value, str) else "yes" if value else "no",
    "medium": medium_name,
    "method": method_name,
    "baseline": lambda name: BASELINES[name].description,
    "metric": lambda name: METRICS[name].label if name in METRICS else name,
    "symbol": format_symbol,
}
"""How the cells of a column are printed, by the name of the format."""

TEXT_FORMATS = ("text", "prose", "flag", "medium", "method", "metric", "symbol")
"""Of columns that stand at the left; "prose" takes the remaining width."""

# Of values in the unit of the metric that the row names.
METRIC_FORMAT = "error"
METRIC_UNIT = "{metric}"
LENGTH_ERROR_FORMAT = "error_mm"  # of metrics that are lengths
DIGITS = "digits"  # key of a row's decimals of errors that are lengths; two without it
_NO_ROW: Mapping[str, Any] = MappingProxyType({})
_OPTIONAL_PATTERN = re.compile(r"\[([^]]*)\]")
_VALUE_PATTERN = re.compile(r"\{(\w+):(\w+)\}")


@dataclass(frozen=True)
class Column:
    """A column of tables."""

    key: str  # its name in files; `{k}` stands for a number
    unit: str = ""  # `METRIC_UNIT` is that of the metric that the row names
    # One of `FORMATS`, `METRIC_FORMAT`, or a template: "{low:mm} to {high:mm}" is composed of two columns;
    # what stands in [] is left out where a value in it is missing
    format: str = "text"
    heading: str = ""  # in printed tables; the key in words if empty
    explanation: str = ""  # one sentence for the glossary
    where: str = ""  # "print": made for printed tables; empty: in files too

    @property
    def label(self) -> str:
        """The heading of printed tables."""
        return self.heading or self.key.removesuffix("_mm").replace("_", " ").capitalize()

    @property
    def is_text(self) -> bool:
        return self.format in TEXT_FORMATS

    def format_cell(self, row: Mapping[str, Any]) -> str:
        """Return the cell of a row; a dash if its value is missing."""
        if "{" in self.format:
            return _fill_template(self.format, row)
        return format_value(self.format, row[self.key], row)


def format_value(form: str, value: Any, row: Mapping[str, Any] = _NO_ROW) -> str:  # noqa: ANN401
    """Return a value as text; what is a text already, in place of a number, stays as it is."""
    if value is None:
        return MISSING
    if isinstance(value, str) and form not in TEXT_FORMATS:
        return value
    if form == METRIC_FORMAT:
        return format_metric(METRICS[row["metric"]], value, row.get(DIGITS, 2))
    if form == LENGTH_ERROR_FORMAT:
        return format_mm(value, row.get(DIGITS, 2))
    return FORMATS[form](value)


def _fill_template(template: str, row: Mapping[str, Any]) -> str:
    """Return a template with the values of a row; a range whose ends are printed alike is one number."""
    text = _OPTIONAL_PATTERN.sub(lambda part: _fill_values(part[1], row).removeprefix(MISSING), template)
    text = _fill_values(text, row)
    low, _, high = text.partition(" to ")
    return low if low == high else text


def _fill_values(words: str, row: Mapping[str, Any]) -> str:
    """Return words with the values of a row; a value that is missing or empty is all that is left."""
    values = {key: format_value(form, row[key], row) for key, form in _VALUE_PATTERN.findall(words)}
    for text in values.values():
        if text in ("", MISSING):
            return text
    return _VALUE_PATTERN.sub(lambda match: values[match[1]], words)


def list_columns() -> dict[str, Column]:
    """Return all columns by key, those of metrics among them."""
    columns = {**_read_columns()}
    for metric in list_metrics():
        form = {"%": "relative", "mm": LENGTH_ERROR_FORMAT}.get(metric.unit, "number")
        columns[metric.name] = Column(metric.name, metric.unit, form, metric.label, metric.explanation)
        if metric.has_floor:
            floor = f"Noise floor of {metric.name}: the error of perfect parameters."
            columns[f"floor_{metric.name}"] = Column(
                f"floor_{metric.name}", metric.unit, form, f"{metric.label} floor", floor
            )
    shape: dict[str, Column] = {}
    for column in list_shape_parameters():  # several laws may have one of the same name
        key = f"{column.name}{{k}}"
        words = f"{shape[key].explanation}; {column.explanation}" if key in shape else column.explanation
        shape[key] = Column(key, column.unit, "number", f"{column.symbol}{{k}}", words)
    columns |= {
        key: replace(column, explanation=f"Of layer k: {column.explanation}.")
        for key, column in shape.items()
    }
    return dict(sorted(columns.items()))


def find_column(name: str) -> Column:
    """Return the column of a name in a table; one that is not declared has no explanation."""
    columns = list_columns()
    number = re.search(r"\d+(?:[._]\d+)?", name)
    general = name.replace(number[0], "{k}", 1) if number else name
    if name in columns or number is None or general not in columns:
        return columns.get(name, Column(name))
    column = columns[general]
    words = f"{float(number[0].replace('_', '.')):g}"
    texts = {part: getattr(column, part).replace("{k}", words) for part in ("unit", "format", "heading")}
    return replace(column, key=name, **texts)


@cache
def _read_columns() -> Mapping[str, Column]:
    text = files(__package__).joinpath("columns.csv").read_text(encoding="utf-8")
    return {row["key"]: Column(**row) for row in csv.DictReader(text.splitlines())}
