"""Write tables as LaTeX (booktabs, no wider than the page)."""

import re
from functools import cache
from importlib.resources import files

from jinja2 import Environment, StrictUndefined, Template

from needlefit.reporting.number_format import NO_BREAK, bind_numbers
from needlefit.reporting.table import TableLayout

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
"""Characters of a row, gaps included, that fit one column of a two-column paper; wider tables span both."""

_GAP_LETTERS = 2  # characters between two columns
_WIDE_COLUMN_LETTERS = 35  # characters of a column of text that is broken into lines


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
