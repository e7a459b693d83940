"""Print results to stdout (tables or JSON), and notes and warnings to stderr."""

import json
import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from needlefit.cli.exit_codes import Invocation
from needlefit.errors import without_controls
from needlefit.project.input_files import to_json_values
from needlefit.project.result_warnings import ResultWarning, condense_open_points

if TYPE_CHECKING:
    from rich.table import Table as RichTable

    from needlefit.reporting.table import TableColumn, TableLayout


def print_line(text: str = "") -> None:
    """Print a line of the result; control characters, which names and paths may hold, are escaped."""
    print(without_controls(text))


def print_written(folder: Path | str, more: str = "") -> None:
    """Print where a result lies."""
    print_line(f"written: {folder}/{more}")


SCREEN_COLUMNS = 100  # width (characters) of sentences and tables in a pipe or file


def find_width() -> int:
    """Return the columns of the screen: the variable COLUMNS, else the terminal's, else `SCREEN_COLUMNS`."""
    return shutil.get_terminal_size((SCREEN_COLUMNS, 0)).columns


def print_text(text: str, style: str = "", styled: int = 0) -> None:
    """Print sentences, wrapped between words; a terminal shows the first `styled` characters in a style."""
    lines = without_controls(_wrap(text))
    if not styled:
        print(lines)
        return
    from rich.console import Console
    from rich.text import Text

    words = Text(lines)
    words.stylize(style, 0, styled)
    Console().print(words, soft_wrap=True)


def _wrap(text: str) -> str:
    """Return text wrapped to the width of the screen."""
    from needlefit.reporting.number_format import NO_BREAK, bind_numbers

    wrapped = "\n".join(
        textwrap.fill(
            line,
            find_width(),
            subsequent_indent=line[: len(line) - len(line.lstrip())],
            break_on_hyphens=False,
            break_long_words=False,
        )
        for line in bind_numbers(text).splitlines()
    )
    return wrapped.replace(NO_BREAK, " ")  # as it is searched for, and copied


def print_note(text: str) -> None:
    """Print a line that is no result to stderr, behind all that stdout was given before.

    It is wrapped on a terminal only: programs read warnings line by line.
    """
    sys.stdout.flush()  # else, where both go to one file, it stands before the result
    line = without_controls(text)
    print(_wrap(line) if sys.stderr.isatty() else line, file=sys.stderr)


def show_json(value: object) -> None:
    """Print a value as JSON; numbers that JSON has not (NaN, infinity) become null.

    Where stdout has not all characters they are escaped, as JSON can.
    """
    escaped = not (sys.stdout.encoding or "").lower().startswith("utf")
    print(json.dumps(to_json_values(value), indent=2, ensure_ascii=escaped, allow_nan=False))


def show_frame(frame: Any, title: str) -> None:  # noqa: ANN401  a pandas.DataFrame, not imported here
    """Print a DataFrame under a title; missing values are empty."""
    from needlefit.reporting.table import TableColumn, TableLayout

    rows = [[_cell(value) for value in row] for row in frame.itertuples(index=False)]
    columns = [
        TableColumn(
            str(name), align="right" if all(is_number or not text for text, is_number in cells) else "left"
        )
        for name, cells in zip(frame.columns, zip(*rows, strict=True), strict=True)
    ]
    print_line(title)
    _show(TableLayout("", "", tuple(columns), tuple(tuple(text for text, _ in row) for row in rows)))
    print_line()


#: width (characters) of a console that limits no table, so that a table's own width is measured
MAX_MEASURED_COLUMNS = 10_000
MAX_HEAD_LINES = 8  #: largest number of lines of the head of a column


def show_display(table: "TableLayout", notes: bool = True) -> None:
    """Print a table that is ready to be set: its caption, its cells, its notes if wanted."""
    if table.caption:
        print_text(table.caption)
    _show(table)
    for line in table.notes if notes else ():
        print_text(line)


_RICH_NO_BREAK = "\ue000"  #: character in place of a no-break space in rich, which breaks lines there


def _join_head(column: "TableColumn") -> str:
    """Return the head of a column, on one line unless it has several."""
    return " ".join(filter(None, (column.label, column.unit)))


def _turn(table: "TableLayout") -> "TableLayout":
    """Return a table with rows as columns, whose heads are the cells of the first column."""
    from needlefit.reporting.table import TableColumn

    (head, *others), (first, *cells) = table.columns, zip(*table.rows, strict=True)
    columns = (replace(head, align="left"), *map(TableColumn, first))
    labels = (" ".join(_join_head(column).split()) for column in others)
    rows = tuple((label, *row) for label, row in zip(labels, cells, strict=True))
    return replace(table, columns=columns, rows=rows, breaks=(), strong=())


def _keep_columns(table: "TableLayout", count: int) -> "TableLayout":
    return replace(table, columns=table.columns[:count], rows=tuple(row[:count] for row in table.rows))


def _show(table: "TableLayout") -> None:
    """Print a table within the width of the screen, without breaking a word.

    A table whose numbers and longest words need more than a terminal has is turned; where that is too wide
    as well, its last columns are left out and named. In a pipe it is printed as wide as it is.
    """
    from rich.console import Console
    from rich.measure import Measurement

    console, is_fixed = Console(width=find_width()), sys.stdout.isatty() or "COLUMNS" in os.environ
    unlimited = console.options.update(max_width=MAX_MEASURED_COLUMNS)  # else it is the console's width

    def measure(table: "TableLayout", head_lines: int = MAX_HEAD_LINES) -> Measurement:
        return Measurement.get(console, unlimited, _tabulate(table, head_lines))

    left: Sequence[TableColumn] = ()
    if not is_fixed:
        console.width = max(SCREEN_COLUMNS, measure(table).minimum)
    elif measure(table).minimum > console.width:
        if table.rows and measure(turned := _turn(table)).minimum <= console.width:
            table = turned
        else:
            counts = range(len(table.columns), 1, -1)
            count = next((n for n in counts if measure(_keep_columns(table, n)).minimum <= console.width), 1)
            table, left = _keep_columns(table, count), table.columns[count:]
    fitting = (n for n in range(1, MAX_HEAD_LINES) if measure(table, n).maximum <= console.width)
    printed_table = _tabulate(table, next(fitting, MAX_HEAD_LINES))
    if Measurement.get(console, unlimited, printed_table).maximum <= console.width - len(table.columns):
        printed_table.padding = (0, 1, 0, 0)  # heads of several words stand side by side
    with console.capture() as printed:
        console.print(printed_table)
    for line in printed.get().replace(_RICH_NO_BREAK, " ").splitlines():
        print(line.rstrip())
    if left:
        heads = ", ".join(" ".join(_join_head(column).split()) for column in left)
        print_text(f"Not shown, as the terminal is too narrow: {heads}")


def _tabulate(layout: "TableLayout", head_lines: int) -> "RichTable":
    """Return the table that rich prints: words are wrapped, not numbers; heads in so many lines at most."""
    from rich import box
    from rich.align import Align
    from rich.table import Table as RichTable
    from rich.text import Text

    from needlefit.reporting.number_format import NO_BREAK, bind_numbers

    def bind(words: str) -> str:
        return bind_numbers(words).replace(NO_BREAK, _RICH_NO_BREAK)

    padding = (0, 1 if head_lines == 1 else 0, 0, 0)
    table = RichTable(box=box.SIMPLE_HEAD, padding=padding, pad_edge=False, show_edge=False)
    for number, column in enumerate(layout.columns):
        text, side = bind(_join_head(column).strip(" \n")), column.align
        if side == "right" and head_lines > 1:
            # no narrower than its longest word, or its widest cell
            width = max(map(len, (*re.split("[ \n]+", text), *(row[number] for row in layout.rows))))
            folds = (_fold(text, wide) for wide in range(width, len(text) + 1))
            text = next((fold for fold in folds if fold.count("\n") < head_lines), text)
        heading = Align(Text(text, justify=side), side, vertical="bottom")
        table.add_column(heading, justify=side, no_wrap=side == "right", overflow="fold")
    for number, row in enumerate(layout.rows, start=1):
        style = "bold" if number - 1 in layout.strong else None
        table.add_row(*(Text(bind(cell)) for cell in row), style=style, end_section=number in layout.breaks)
    return table


def _fold(text: str, width: int) -> str:
    return textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False)


def _cell(value: object) -> tuple[str, bool]:
    """Return a cell's text, and whether it is a number."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "", False
    if isinstance(value, bool) or not isinstance(value, int | float):
        try:
            float(str(value))
        except ValueError:
            return str(value), False
        return str(value), True
    return (f"{value:z.4g}" if isinstance(value, float) else str(value)), True


def print_warnings(invocation: Invocation, warnings: Iterable[ResultWarning], in_full: bool = False) -> None:
    """Print warnings to stderr, each with the command that explains it.

    `in_full`: also each of `OPEN_POINTS`. With `--strict` the command then ends with exit code 5.
    """
    for warning in warnings if in_full else condense_open_points(warnings):
        invocation.warned = True
        print_note(f"needlefit: warning: {warning} ({warning.help_command})")
