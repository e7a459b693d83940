"""Print results to stdout (tables or JSON), and notes and warnings to stderr."""

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from needlefit.cli.exit_codes import Invocation
from needlefit.errors import without_controls
from needlefit.project.json_values import to_json_values
from needlefit.project.result_warnings import ResultWarning, read_warnings

if TYPE_CHECKING:
    from needlefit.reporting.table_layout import TableLayout


def print_line(text: str = "") -> None:
    """Print a line of the result; control characters, which names and paths may hold, are escaped."""
    print(without_controls(text))


def print_note(text: str) -> None:
    """Print a line that is no result to stderr, behind all that stdout was given before."""
    sys.stdout.flush()  # else, where both go to one file, it stands before the result
    print(without_controls(text), file=sys.stderr)


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


def show_display(table: "TableLayout") -> None:
    """Print a table that is ready to be set: its caption, its cells, its notes."""
    columns = [(f"{column.label} {column.unit}", column.align == "right") for column in table.columns]
    print_line(table.caption)
    _show(columns, table.rows, table.breaks, table.strong)
    for line in table.notes:
        print_line(line)


def _show(
    columns: Sequence[tuple[str, bool]],
    rows: Sequence[Sequence[str]],
    breaks: Sequence[int] = (),
    strong: Sequence[int] = (),
) -> None:
    """Print cells under (head, whether it stands at the right).

    In a pipe nothing is cut off or wrapped; on a terminal too narrow the words are wrapped, not the numbers.
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
    console.print(wide if console.measure(wide).maximum <= console.width else build(0))
    print_line()


def _cell(value: object) -> tuple[str, bool]:
    """Return a cell's text, and whether it is a number."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "", False
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value), False
    return (f"{value:.4g}" if isinstance(value, float) else str(value)), True


def print_warnings(invocation: Invocation, warnings: Iterable[ResultWarning]) -> None:
    """Print warnings to stderr; with `--strict` the command then ends with exit code 5."""
    for one in warnings:
        invocation.warned = True
        print_note(f"needlefit: warning: {one}")


def print_run_warnings(invocation: Invocation, run: Mapping[str, Any], dataset: str = "") -> None:
    """Print the warnings that a run keeps; `dataset` is the file of its data, if that is known."""
    folder = Path(dataset).parent
    print_warnings(invocation, (_with_folder(one, folder) for one in read_warnings(run)))


def _with_folder(one: ResultWarning, folder: Path) -> ResultWarning:
    """Return a warning about a file of a folder with the file's path."""
    file = one.where.rpartition(":")[0] or one.where
    return replace(one, where=str(folder / one.where)) if file and (folder / file).is_file() else one
