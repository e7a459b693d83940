"""Tables as LaTeX, with the rules of the package booktabs, no wider than the page (graphicx)."""

import re
from importlib.resources import files

from jinja2 import Environment, StrictUndefined

from needlefit.reporting.display import Column, Display

_SPECIAL = {
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


def latex(table: Display, synthetic: bool) -> str:
    """Return the table as a LaTeX float; every special sign is escaped.

    Parameters
    ----------
    table : Display
    synthetic : bool
        Whether the caption begins with "SYNTHETIC DATA."
    """
    template = (files("needlefit.reporting") / "templates" / "table.tex").read_text(encoding="utf-8")
    units = [column.unit for column in table.columns]
    return (
        _environment()
        .from_string(template)
        .render(
            caption=escape(("SYNTHETIC DATA. " if synthetic else "") + table.caption),
            label=table.name.replace("_", "-"),
            aligns="".join(_align(column) for column in table.columns),
            heads=[escape(column.label) for column in table.columns],
            units=[f"({escape(unit)})" if unit else "" for unit in units] if any(units) else [],
            rows=[
                {"rule": i in table.breaks, "cells": [escape(cell) for cell in row]}
                for i, row in enumerate(table.rows)
            ],
            notes=[escape(note) for note in table.notes],
        )
    )


def _align(column: Column) -> str:
    return "p{5cm}" if column.wide else "l" if column.align == "left" else "r"


def escape(text: str) -> str:
    """Return text that LaTeX sets as it reads, in any font encoding."""
    escaped = "".join(_SPECIAL.get(sign, sign) for sign in text)
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
        autoescape=False,  # noqa: S701 - LaTeX, not HTML: `escape` does it
    )
