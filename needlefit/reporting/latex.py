"""Write tables as LaTeX (booktabs, no wider than the page), and the numbers of a run as LaTeX macros."""

import re
from collections.abc import Iterator, Sequence
from importlib.resources import files

from jinja2 import Environment, StrictUndefined

from needlefit.reporting.number_format import MISSING, format_mm, format_number, format_percent, typeset
from needlefit.reporting.parameter_table import NOT_DETERMINED, tabulate_parameters
from needlefit.reporting.table_layout import TableColumn, TableLayout
from needlefit.reporting.tables import Row, divide_by_floor, tabulate_validation, to_records
from needlefit.validation.results import Results

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
    "†": r"$\dagger$",
    "‡": r"$\ddagger$",
    "÷": r"$\div$",
    "–": "--",
    "…": r"\ldots{}",
    "’": "'",
    "“": "``",
    "”": "''",
}
_RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_LOWERED = str.maketrans("₀₁₂₃₄₅₆₇₈₉", "0123456789")


def format_latex(table: TableLayout, synthetic: bool) -> str:
    """Return the table as a LaTeX float; every special character is escaped.

    Parameters
    ----------
    table : TableLayout
    synthetic : bool
        Whether the caption begins with "SYNTHETIC DATA."
    """
    template = (files("needlefit.reporting") / "templates" / "table.tex").read_text(encoding="utf-8")
    units = [column.unit for column in table.columns]
    return (
        _environment()
        .from_string(template)
        .render(
            caption=escape_latex(("SYNTHETIC DATA. " if synthetic else "") + table.caption),
            label=table.name.replace("_", "-"),
            aligns="".join(_align(column) for column in table.columns),
            heads=[escape_latex(column.label) for column in table.columns],
            units=[f"({escape_latex(unit)})" if unit else "" for unit in units] if any(units) else [],
            rows=[
                {"rule": i in table.breaks, "cells": [escape_latex(cell) for cell in row]}
                for i, row in enumerate(table.rows)
            ],
            notes=[escape_latex(note) for note in table.notes],
        )
    )


def _align(column: TableColumn) -> str:
    return "p{5cm}" if column.wide else "l" if column.align == "left" else "r"


def escape_latex(text: str) -> str:
    """Return text that LaTeX prints literally, in any font encoding."""
    # Character by character: escaping in several passes would escape the backslashes of the pass before. Only
    # then are exponents recognised, by their escaped form.
    escaped = "".join(_ESCAPES.get(sign, sign) for sign in text)
    escaped = re.sub(r"\\textasciicircum\{\}(-?\d+(?:\.\d+)?)", r"$^{\1}$", escaped)
    escaped = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda m: f"$^{{{m[0].translate(_RAISED)}}}$", escaped)
    return re.sub("[₀₁₂₃₄₅₆₇₈₉]+", lambda m: f"$_{{{m[0].translate(_LOWERED)}}}$", escaped)


def _environment() -> Environment:
    """Return jinja2 with marks that LaTeX does not use."""
    return Environment(
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


_MACRO_HEAD = r"""% Numbers of a run of needlefit: \nf{KEY}. A key that is not here is set in bold after ??.
\providecommand{\nf}[1]{\ifcsname nf@#1\endcsname\csname nf@#1\endcsname\else\textbf{??\detokenize{#1}}\fi}
"""
_ERROR_KEYS = {
    "median": "median_err_mm",
    "ipe": "ipe_mean_mm",
    "ipe-sd": "ipe_std_mm",
    "ipe-max": "ipe_max_mm",
    "te": "te_mm",
}
_REFERENCE_PREFIXES = ("floor", "paper")


def format_macros(results: Sequence[Results]) -> str:
    """Return a LaTeX file of macros: errors in mm, EDP in per cent, fitted parameters in Pa and mm, by
    readable keys.

    A key is `<run>-<medium>-<layers>-<error>`, with `floor-` or `paper-` before the error for what stands
    beside it or `-over-floor` after it for the multiple of its noise floor, or `<run>-<parameter>`.
    """
    lines = [
        _format_macro(key, words)
        for one in results
        for key, words in (*_error_macros(one), *_parameter_macros(one))
    ]
    return _MACRO_HEAD + "".join(lines)


def format_table_macros(name: str, tables: Sequence[TableLayout]) -> str:
    """Return a LaTeX file with every number of some tables of a run, as they are printed.

    A key is `<run>-<table>-<words of the row>-<head of the column>`, in small letters and hyphens; a row that
    names only what is new in it has the other words of the row above.
    """
    lines = [_format_macro(_slug(name, *keys), words) for table in tables for keys, words in _cells(table)]
    # A dict keeps the order and drops repeated lines.
    return _MACRO_HEAD + "".join(dict.fromkeys(lines))


def _cells(table: TableLayout) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield every cell that stands at the right, with the words that say which it is."""
    words = [i for i, column in enumerate(table.columns) if column.align == "left"]
    above: dict[int, str] = {}
    for row in table.rows:
        above = {i: row[i] or above.get(i, "") for i in words}
        for i, column in enumerate(table.columns):
            if i not in words and row[i] not in ("", MISSING):
                yield (table.name, *above.values(), f"{column.label} {column.unit}"), row[i]


def _slug(*words: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", " ".join(words).lower()).strip("-")


def _format_macro(key: str, words: str) -> str:
    return f"\\expandafter\\def\\csname nf@{key}\\endcsname{{{escape_latex(words)}}}\n"


def _error_macros(results: Results) -> Iterator[tuple[str, str]]:
    for row in to_records(tabulate_validation(results)):
        begin = f"{results.name}-{row['validate_medium']}-{row['validate_layers']}"
        digits = 3 if row["comparison"] == "aligned" else 2
        yield f"{begin}-n", str(row["insertions"])
        for name, column in _ERROR_KEYS.items():
            yield f"{begin}-{name}", format_mm(row[column], digits)
            for prefix in _REFERENCE_PREFIXES:
                if row.get(f"{prefix}_{column}") is not None:
                    yield f"{begin}-{prefix}-{name}", format_mm(row[f"{prefix}_{column}"], digits)
            if (times := divide_by_floor(row, column)) is not None:
                yield f"{begin}-{name}-over-floor", format_mm(times, 1)
        yield f"{begin}-edp", format_percent(row["edp_percent"])


def _parameter_macros(results: Results) -> Iterator[tuple[str, str]]:
    table = to_records(tabulate_parameters(results))
    several = len({row["fold"] for row in table}) > 1
    for row in table:
        name = str(row["parameter"]).removesuffix("_pa").removesuffix("_mm").replace("_", "-")
        where = f"-{row['fold']}" if several else ""
        yield f"{results.name}{where}-{name}", _format_parameter(row)


def _format_parameter(row: Row) -> str:
    value = row["fitted"]
    return NOT_DETERMINED if value == NOT_DETERMINED else typeset(format_number(float(value)))
