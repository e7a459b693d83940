"""Print results to stdout (tables or JSON), and notes and warnings to stderr."""

import json
import math
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

from needlefit.cli.exit_codes import Invocation
from needlefit.errors import without_controls
from needlefit.project.json_values import to_json_values
from needlefit.project.result_warnings import ResultWarning

if TYPE_CHECKING:
    from needlefit.reporting.table_layout import TableLayout


def print_line(text: str = "") -> None:
    """Print a line of the result; control characters, which names and paths may hold, are escaped."""
    print(without_controls(text))


def print_text(text: str) -> None:
    """Print sentences, wrapped between words to the width of a terminal; in a pipe each is one line."""
    print_line(_wrap(text, sys.stdout))


def _wrap(text: str, stream: TextIO) -> str:
    if not stream.isatty():
        return text
    width = shutil.get_terminal_size().columns
    return "\n".join(textwrap.fill(line, width, break_on_hyphens=False) for line in text.splitlines())


def print_note(text: str) -> None:
    """Print a line that is no result to stderr, behind all that stdout was given before."""
    sys.stdout.flush()  # else, where both go to one file, it stands before the result
    print(_wrap(without_controls(text), sys.stderr), file=sys.stderr)


def compile_ahead(*kernel_parts: str, quiet: bool = False) -> None:
    """Compile the model, or further parts of its kernel, where they are not; say so, as it takes a while."""
    from needlefit.mechanics.kernel.cache import CACHE_DIR_VARIABLE, find_cache_folder, is_complete

    wanted = ("kernel", *kernel_parts)
    if all(is_complete(part) for part in wanted):
        return
    if not quiet:
        why = find_cache_folder().why_temporary
        once = f"in every run: {why}; set {CACHE_DIR_VARIABLE} to another folder" if why else "once"
        print_note(f"needlefit: compiling the model; this takes some seconds, {once}")
    from needlefit.mechanics.precompile import precompile

    precompile(*wanted)


def show_json(value: object) -> None:
    """Print a value as JSON; numbers that JSON has not (NaN, infinity) become null.

    Where stdout has not all characters they are escaped, as JSON can.
    """
    escaped = not (sys.stdout.encoding or "").lower().startswith("utf")
    print(json.dumps(to_json_values(value), indent=2, ensure_ascii=escaped, allow_nan=False))


def show_frame(frame: Any, title: str) -> None:  # noqa: ANN401  a pandas.DataFrame, not imported here
    """Print a DataFrame under a title; missing values are empty."""
    rows = [[_cell(value) for value in row] for row in frame.itertuples(index=False)]
    right = [any(is_number for _, is_number in column) for column in zip(*rows, strict=True)]
    columns = [(str(name), at_right) for name, at_right in zip(frame.columns, right, strict=True)]
    print_line(title)
    _show(columns, [[text for text, _ in row] for row in rows])


SCREEN_COLUMNS = 100
"""Width that tables keep to where their words can be wrapped."""


def show_display(table: "TableLayout", notes: bool = True) -> None:
    """Print a table that is ready to be set: its caption, its cells, its notes if wanted.

    Without notes it keeps to `SCREEN_COLUMNS` in a pipe too.
    """
    columns = [(f"{column.label} {column.unit}", column.align == "right") for column in table.columns]
    print_text(table.caption)
    _show(columns, table.rows, table.breaks, table.strong, None if notes else SCREEN_COLUMNS)
    for line in table.notes if notes else ():
        print_text(line)


def _show(
    columns: Sequence[tuple[str, bool]],
    rows: Sequence[Sequence[str]],
    breaks: Sequence[int] = (),
    strong: Sequence[int] = (),
    wanted_width: int | None = None,
) -> None:
    """Print cells under (head, whether it stands at the right).

    To keep to the width of a terminal, or a wanted one, words are wrapped, not numbers; nothing is cut off.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    def build(gap: int) -> Table:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, gap, 0, 0), pad_edge=False, show_edge=False)
        for head, is_right in columns:
            text = "\n".join(head.split()) if is_right else head.strip()
            side: Literal["left", "right"] = "right" if is_right else "left"
            table.add_column(Text(text), justify=side, no_wrap=is_right, vertical="bottom", overflow="fold")
        for number, row in enumerate(rows):
            style = "bold" if number in strong else None
            table.add_row(*map(Text, row), style=style, end_section=number + 1 in breaks)
        return table

    console = Console(width=None if sys.stdout.isatty() else 1000)
    wide = build(1)
    if wanted_width is not None and console.measure(wide).minimum <= wanted_width < console.width:
        console.width = wanted_width
    console.print(wide if console.measure(wide).maximum <= console.width else build(0))
    print_line()


def _cell(value: object) -> tuple[str, bool]:
    """Return a cell's text, and whether it is a number."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "", False
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value), _is_number_as_text(value)
    return (f"{value:.4g}" if isinstance(value, float) else str(value)), True


def _is_number_as_text(value: object) -> bool:
    try:
        float(str(value))
    except ValueError:
        return False
    return True


def print_warnings(invocation: Invocation, warnings: Iterable[ResultWarning]) -> None:
    """Print warnings to stderr, each with the page that explains it.

    With `--strict` the command then ends with exit code 5.
    """
    for one in warnings:
        invocation.warned = True
        print_note(f"needlefit: warning: {one} ({one.help_page})")


def locate_warning(one: ResultWarning, folder: Path) -> ResultWarning:
    """Return a warning about a file of a folder with the file's path."""
    file = one.where.rpartition(":")[0] or one.where
    return replace(one, where=str(folder / one.where)) if file and (folder / file).is_file() else one
