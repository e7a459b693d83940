"""The numbers of a run as LaTeX macros, so that a paper never holds a number that was typed."""

import re
from collections.abc import Iterator, Sequence

from needlefit.reporting.display import Display
from needlefit.reporting.latex import escape
from needlefit.reporting.numbers import MISSING, fixed, number, percent, typeset
from needlefit.reporting.parameters import NOT_DETERMINED, parameters_table
from needlefit.reporting.tables import Row, over_floor, records, validation_table
from needlefit.validation.results import Results

_HEAD = r"""% Numbers of a run of needlefit: \nf{KEY}. A key that is not here is set in bold after ??.
\providecommand{\nf}[1]{\ifcsname nf@#1\endcsname\csname nf@#1\endcsname\else\textbf{??\detokenize{#1}}\fi}
"""
_ERRORS = {
    "median": "median_err_mm",
    "ipe": "ipe_mean_mm",
    "ipe-sd": "ipe_std_mm",
    "ipe-max": "ipe_max_mm",
    "te": "te_mm",
}
_BESIDE = ("floor", "paper")


def macros(results: Sequence[Results]) -> str:
    """Return a LaTeX file: errors in mm, EDP in per cent, fitted parameters in Pa and mm, by readable keys.

    A key is `<run>-<medium>-<layers>-<error>`, with `floor-` or `paper-` before the error for what stands
    beside it or `-over-floor` after it for the multiple of its noise floor, or `<run>-<parameter>`.
    """
    lines = [_line(key, words) for one in results for key, words in (*_errors(one), *_parameters(one))]
    return _HEAD + "".join(lines)


def table_macros(name: str, tables: Sequence[Display]) -> str:
    """Return a LaTeX file with every number of some tables of a run as they are printed.

    A key is `<run>-<table>-<words of the row>-<head of the column>`, in small letters and hyphens; a row that
    names only what is new in it has the other words of the row above.
    """
    lines = [_line(_slug(name, *keys), words) for table in tables for keys, words in _cells(table)]
    return _HEAD + "".join(dict.fromkeys(lines))


def _cells(table: Display) -> Iterator[tuple[tuple[str, ...], str]]:
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


def _line(key: str, words: str) -> str:
    return f"\\expandafter\\def\\csname nf@{key}\\endcsname{{{escape(words)}}}\n"


def _errors(results: Results) -> Iterator[tuple[str, str]]:
    for row in records(validation_table(results)):
        begin = f"{results.name}-{row['validate_medium']}-{row['validate_layers']}"
        digits = 3 if row["comparison"] == "aligned" else 2
        yield f"{begin}-n", str(row["insertions"])
        for name, column in _ERRORS.items():
            yield f"{begin}-{name}", fixed(row[column], digits)
            for beside in _BESIDE:
                if row.get(f"{beside}_{column}") is not None:
                    yield f"{begin}-{beside}-{name}", fixed(row[f"{beside}_{column}"], digits)
            if (times := over_floor(row, column)) is not None:
                yield f"{begin}-{name}-over-floor", fixed(times, 1)
        yield f"{begin}-edp", percent(row["edp_percent"])


def _parameters(results: Results) -> Iterator[tuple[str, str]]:
    table = records(parameters_table(results))
    several = len({row["fold"] for row in table}) > 1
    for row in table:
        name = str(row["parameter"]).removesuffix("_pa").removesuffix("_mm").replace("_", "-")
        where = f"-{row['fold']}" if several else ""
        yield f"{results.name}{where}-{name}", _value(row)


def _value(row: Row) -> str:
    value = row["fitted"]
    return NOT_DETERMINED if value == NOT_DETERMINED else typeset(number(float(value)))
