"""Tables of reports, as text and LaTeX: rows and keys of columns, whose registry has heads and units."""

import csv
import re
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from jinja2 import Environment, StrictUndefined, Template

from needlefit.inference.baselines import BASELINES
from needlefit.mechanics.laws import list_shape_parameters
from needlefit.metrics import METRICS, list_metrics
from needlefit.reporting.labels import medium_name, method_name
from needlefit.reporting.number_format import (
    MISSING,
    NO_BREAK,
    bind_numbers,
    format_metric,
    format_mm,
    format_number,
    format_percent,
    format_signed_mm,
    format_symbol,
    typeset,
)

if TYPE_CHECKING:
    from needlefit.reporting.table_files import Row

# ---- the columns of all tables: each is declared once, with its heading, unit, format and explanation
#
# `columns.csv` beside this module holds them, a line for each; metrics bring their own. A column that only a
# plugin has is printed under its name.


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
"""Functions that print the cells of a column, by the name of the format."""

TEXT_FORMATS = ("text", "prose", "flag", "medium", "method", "metric", "symbol")
"""Formats of columns that stand at the left; "prose" takes the remaining width."""

# name of the format of values in the unit of the metric that the row names
METRIC_FORMAT = "error"
METRIC_UNIT = "{metric}"  # unit of these values
LENGTH_ERROR_FORMAT = "error_mm"  # name of the format of metrics that are lengths
DIGITS = "digits"  # key of a row: decimals of its errors that are lengths; two without it
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


# ---- tables

_PARTS = "parts"  # key of the rows that were merged into one


@dataclass(frozen=True)
class TableColumn:
    """A column: heading, unit (below the heading), alignment, and whether it takes the remaining width."""

    label: str
    unit: str = ""
    align: Literal["left", "right"] = "right"
    wide: bool = False


@dataclass(frozen=True)
class TableLayout:
    """A table of text."""

    name: str  # of its file and label
    caption: str  # what it shows
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[str, ...], ...]  # cells, as many as there are columns
    breaks: tuple[int, ...] = ()  # rows before which a thin rule stands
    strong: tuple[int, ...] = ()  # rows that hold our answer; the others stand beside it
    notes: tuple[str, ...] = ()  # sentences under the table


_SENTENCE_END = re.compile(r"(?<=\.) ")


def drop_repeated(tables: Iterable[TableLayout]) -> Iterator[TableLayout]:
    """Yield tables that are printed below each other, each sentence of their notes once.

    Not those that differ from one before in their layers alone: by medium, if each has one number of layers.
    """
    seen, sentences = set[tuple[tuple[str, ...], ...]](), set[str]()
    for table in tables:
        kept = [n for n, column in enumerate(table.columns) if column.label != "Layers"]
        cells = tuple(tuple(row[n] for n in kept) for row in table.rows)
        if cells in seen:
            continue
        seen.add(cells)
        split = [_SENTENCE_END.split(note) for note in table.notes]
        notes = [" ".join(sentence for sentence in note if sentence not in sentences) for note in split]
        sentences.update(sentence for note in split for sentence in note)
        yield replace(table, notes=tuple(filter(None, notes)))


@dataclass(frozen=True)
class Cells:
    """A printed column: its head, and the cell of a row."""

    head: TableColumn
    cell: "Callable[[Row], str]"


def _find_unit(column: Column, metrics: Iterable[object]) -> str:
    """Return the unit of a column in rows of these metrics; none where theirs differ."""
    units = {METRICS[str(name)].unit for name in metrics if name in METRICS}
    return column.unit.replace(METRIC_UNIT, units.pop() if len(units) == 1 else "")


def pivot(rows: "Iterable[Row]", index: Sequence[str], by: Sequence[str]) -> "list[Row]":
    """Return one row per entry of the columns `index`; `part` prints columns of the rows that it was made of.

    It has the values of the first of these; they differ in the columns `by`.
    """
    merged: dict[tuple[Hashable, ...], Row] = {}
    for row in rows:
        whole = merged.setdefault(tuple(row[name] for name in index), {**row, _PARTS: {}})
        whole[_PARTS][frozenset((name, row[name]) for name in by)] = row
    return list(merged.values())


def part(key: str, **place: object) -> Cells:
    """Return a column of pivoted rows: `key` where the columns of `place` have these values.

    The place is its heading; below stand what the registry has of `key`: its heading, if any, and unit.
    """
    column, where = find_column(key), frozenset(place.items())
    label = ", ".join(format_value(find_column(name).format, value) for name, value in place.items())
    unit = _find_unit(column, [place.get("metric")])
    head = TableColumn(label, ", ".join(words for words in (column.heading, unit) if words))

    def cell(row: "Row") -> str:
        return column.format_cell(row[_PARTS][where]) if where in row[_PARTS] else MISSING

    return Cells(head, cell)


@dataclass(frozen=True)
class Table:
    """A table of a report."""

    name: str  # of its file and label
    rows: "Iterable[Row]"  # values by key; `to_records` returns those of a DataFrame
    # Keys of the registry, or a `part` of rows that are pivoted
    columns: Sequence[Any]  # str or Cells: a tuple of both is one of objects to mypy
    # Where one of these columns changes, a group begins: a thin rule stands before it
    groups: Sequence[str] = ()
    heads: int = 0  # how many of the first columns name the group, and are blank in its further rows
    # Which rows hold our answer: "", "first" of the table, "groups": the first of each, or the column that
    # says so
    strong: str = ""
    caption: str = ""  # what it shows, where no text of a kind says so
    notes: tuple[str, ...] = ()  # sentences under the table

    def lay_out(self, drop_empty: bool = False) -> TableLayout:
        """Return the table as text, without columns that are empty if wanted."""
        rows = list(self.rows)
        columns: list[Cells] = []
        for given in self.columns:
            if isinstance(given, str):
                column = find_column(given)
                unit = _find_unit(column, {row.get("metric") for row in rows})
                align: Literal["left", "right"] = "left" if column.is_text else "right"
                head = TableColumn(column.label, unit, align, column.format == "prose")
                given = Cells(head, column.format_cell)
            columns.append(given)
        begins = [k for k, row in enumerate(rows) if not k or self._key(row) != self._key(rows[k - 1])]
        cells = tuple(
            tuple(
                "" if self.groups and number < self.heads and k not in begins else column.cell(row)
                for number, column in enumerate(columns)
            )
            for k, row in enumerate(rows)
        )
        breaks = tuple(begins[1:]) if self.groups else ()
        heads = tuple(column.head for column in columns)
        strong = {"": (), "first": (0,), "groups": tuple(begins)}.get(self.strong)
        if strong is None:
            strong = tuple(k for k, row in enumerate(rows) if row[self.strong])
        if drop_empty:
            kept = [i for i in range(len(heads)) if any(row[i] not in ("", "–") for row in cells)]
            heads = tuple(heads[i] for i in kept)
            cells = tuple(tuple(row[i] for i in kept) for row in cells)
        return TableLayout(self.name, self.caption, heads, cells, breaks, strong, self.notes)

    def _key(self, row: "Row") -> list[Any]:
        return [row[name] for name in self.groups]


# ---- as LaTeX

_ESCAPES = {
    "\\": r"\textbackslash{}",
    **{sign: rf"\{sign}" for sign in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "×": r"$\times$",
    "−": "$-$",
    "≤": r"$\leq$",
    "μ": r"$\mu$",
    "α": r"$\alpha$",
    "β": r"$\beta$",
    "†": r"$\dagger$",
    "‡": r"$\ddagger$",
    "÷": r"$\div$",
    "·": r"$\cdot$",
    "θ": r"$\theta$",
    "°": r"\textdegree{}",
    "≥": r"$\geq$",
    "≈": r"$\approx$",
    "½": r"$\frac12$",
    "–": "--",
    NO_BREAK: "~",
    "…": r"\ldots{}",
    "’": "'",
    "“": "``",
    "”": "''",
}
_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_LOWERED = str.maketrans("₀₁₂₃₄₅₆₇₈₉", "0123456789")


@cache
def _template() -> Template:
    environment = Environment(  # with marks that LaTeX does not use
        block_start_string="<%",
        block_end_string="%>",
        variable_start_string="<<",
        variable_end_string=">>",
        comment_start_string="<#",
        comment_end_string="#>",
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
        autoescape=False,  # noqa: S701 - LaTeX, not HTML: `escape_latex` does it
    )
    text = (files("needlefit.reporting") / "templates" / "table.tex").read_text(encoding="utf-8")
    return environment.from_string(text)


def format_latex(table: TableLayout, origin_mark: str) -> str:
    """Return the table as a LaTeX float; special characters are escaped, and the mark begins the caption."""
    units = [column.unit for column in table.columns]
    aligns = ("p{5cm}" if column.wide else "l" if column.align == "left" else "r" for column in table.columns)
    return _template().render(
        environment="table" if _count_letters(table) <= MAX_COLUMN_LETTERS else "table*",
        caption=escape_latex((f"{origin_mark}. " if origin_mark else "") + bind_numbers(table.caption)),
        label=table.name.replace("_", "-"),
        aligns="".join(aligns),
        heads=[escape_latex(column.label) for column in table.columns],
        units=[f"({escape_latex(unit)})" if unit else "" for unit in units] if any(units) else [],
        rows=[
            {"rule": i in table.breaks, "cells": [format_cell(cell) for cell in row]}
            for i, row in enumerate(table.rows)
        ],
        notes=[escape_latex(bind_numbers(note)) for note in table.notes],
    )


MAX_COLUMN_LETTERS = 58
"""Largest number of characters of a row, with gaps, in one column of a two-column paper; wider tables span
both."""

_GAP_LETTERS = 2  # number of characters between two columns
_WIDE_COLUMN_LETTERS = 35  # width (characters) of a column of text that is broken into lines


def _count_letters(table: TableLayout) -> int:
    cells = [
        (_WIDE_COLUMN_LETTERS,)
        if column.wide
        else [len(column.label), len(column.unit) + 2, *(len(row[i]) for row in table.rows)]
        for i, column in enumerate(table.columns)
    ]
    return sum(max(lengths) + _GAP_LETTERS for lengths in cells)


def escape_latex(text: str) -> str:
    """Return text that LaTeX prints literally, in any font encoding."""
    # Character by character: escaping in several passes would escape the backslashes of the pass before. Only
    # then are exponents recognised, by their escaped form.
    escaped = "".join(_ESCAPES.get(sign, sign) for sign in text)
    escaped = re.sub(r"\\textasciicircum\{\}(-?\d+(?:\.\d+)?)", r"$^{\1}$", escaped)
    escaped = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda m: f"$^{{{m[0].translate(_RAISED)}}}$", escaped)
    escaped = re.sub("[₀₁₂₃₄₅₆₇₈₉]+", lambda m: f"$_{{{m[0].translate(_LOWERED)}}}$", escaped)
    return escaped.replace("$$", "")  # one formula of two neighbours


_NUMBER = r"[−-]?\d+(?:\.\d+)?(?: × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?"
_NUMBER_PATTERN = re.compile(rf"({_NUMBER})(?: ± (\d+(?:\.\d+)?))?")
_RANGE_PATTERN = re.compile(rf"({_NUMBER}) to ({_NUMBER})")


def _to_digits(number: str) -> str:
    """Return a printed number as siunitx reads it: 2.13e5."""
    mantissa, times, power = number.replace("−", "-").partition(" × 10")
    return f"{mantissa}e{power.translate(_RAISED)}" if times else mantissa


def format_cell(cell: str) -> str:
    r"""Return a printed cell as LaTeX: numbers, ± and ranges by siunitx, all else as `escape_latex`."""
    if match := _NUMBER_PATTERN.fullmatch(cell):
        spread = rf" \pm {match[2]}" if match[2] else ""
        return rf"\num{{{_to_digits(match[1])}{spread}}}"
    if match := _RANGE_PATTERN.fullmatch(cell):
        return rf"\numrange{{{_to_digits(match[1])}}}{{{_to_digits(match[2])}}}"
    return escape_latex(cell)
