"""Print results to stdout (tables or JSON), and notes and warnings to stderr."""

import json
import math
import re
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

from needlefit.cli.exit_codes import Invocation
from needlefit.errors import without_controls
from needlefit.project.json_values import to_json_values
from needlefit.project.result_warnings import ResultWarning

if TYPE_CHECKING:
    from needlefit.reporting.table import TableLayout


def print_line(text: str = "") -> None:
    """Print a line of the result; control characters, which names and paths may hold, are escaped."""
    print(without_controls(text))


def print_written(folder: Path | str, more: str = "") -> None:
    """Print the digest of the manifest of a result, and where the result lies."""
    from needlefit.project.folders import MANIFEST, sha256

    if (manifest := Path(folder) / MANIFEST).is_file():
        print_line(f"Manifest: {MANIFEST}, SHA-256 {sha256(manifest)}")
    print_line(f"written: {folder}/{more}")


SCREEN_COLUMNS = 100  # width of sentences and tables in a pipe or file


def print_text(text: str) -> None:
    """Print sentences, wrapped between words to the width of the terminal, or to `SCREEN_COLUMNS`."""
    print_line(_wrap(text, sys.stdout, SCREEN_COLUMNS))


def _wrap(text: str, stream: TextIO, piped_width: int | None = None) -> str:
    """Return text wrapped to the width of a terminal, elsewhere to `piped_width` (None: as it is)."""
    width = shutil.get_terminal_size().columns if stream.isatty() else piped_width
    if width is None:
        return text
    return "\n".join(
        textwrap.fill(
            line,
            width,
            subsequent_indent=line[: len(line) - len(line.lstrip())],
            break_on_hyphens=False,
            break_long_words=False,
        )
        for line in text.splitlines()
    )


def print_note(text: str) -> None:
    """Print a line that is no result to stderr, behind all that stdout was given before.

    It is wrapped on a terminal only: programs read warnings line by line.
    """
    sys.stdout.flush()  # else, where both go to one file, it stands before the result
    print(_wrap(without_controls(text), sys.stderr), file=sys.stderr)


def show_json(value: object) -> None:
    """Print a value as JSON; numbers that JSON has not (NaN, infinity) become null.

    Where stdout has not all characters they are escaped, as JSON can.
    """
    escaped = not (sys.stdout.encoding or "").lower().startswith("utf")
    print(json.dumps(to_json_values(value), indent=2, ensure_ascii=escaped, allow_nan=False))


def show_frame(frame: Any, title: str) -> None:  # noqa: ANN401  a pandas.DataFrame, not imported here
    """Print a DataFrame under a title; missing values are empty."""
    rows = [[_cell(value) for value in row] for row in frame.itertuples(index=False)]
    right = [all(is_number or not text for text, is_number in column) for column in zip(*rows, strict=True)]
    columns = [(str(name), at_right) for name, at_right in zip(frame.columns, right, strict=True)]
    print_line(title)
    _show(columns, [[text for text, _ in row] for row in rows])


MAX_MEASURED_COLUMNS = 10_000


def show_display(table: "TableLayout", notes: bool = True) -> None:
    """Print a table that is ready to be set: its caption, its cells, its notes if wanted."""
    columns = [(f"{column.label} {column.unit}", column.align == "right") for column in table.columns]
    if table.caption:
        print_text(table.caption)
    _show(columns, table.rows, table.breaks, table.strong)
    for line in table.notes if notes else ():
        print_text(line)


SKETCH_ROWS, SKETCH_COLUMNS = 6, 64  # characters; each has 4 x 2 dots
_FIRST_DOT_PATTERN = 0x2800  # of the characters of Braille, whose low bits are the dots
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))


def show_needle(points: Any, boundaries: Iterable[float]) -> None:  # noqa: ANN401  an array, not imported here
    """Print a sketch of the inserted needle, (N, 2) in mm from the entry, between layer boundaries (mm)."""
    if not (sys.stdout.encoding or "").lower().startswith("utf"):
        return
    import numpy as np

    deep, low, high = points[-1, 0], min(points[:, 1].min(), 0.0), max(points[:, 1].max(), 0.0)
    span, dots = max(high - low, 1e-3), np.zeros((SKETCH_ROWS, SKETCH_COLUMNS), int)
    along = np.linspace(0, 1, 20 * SKETCH_COLUMNS)  # so close that the line has no gaps
    across = (high - np.interp(along * deep, *points.T)) / span
    row, column = (
        ((4 * SKETCH_ROWS - 1) * across).round().astype(int),
        (along * (2 * SKETCH_COLUMNS - 1)).astype(int),
    )
    np.bitwise_or.at(dots, (row // 4, column // 2), np.array(_DOTS)[row % 4, column % 2])
    axis, marked = (
        int((SKETCH_ROWS - 1) * high / span),
        {int(one / deep * SKETCH_COLUMNS) for one in boundaries},
    )
    scale = deep / (2 * SKETCH_COLUMNS) / (span / (4 * SKETCH_ROWS))
    print_line(f"Inserted needle, mm; deflection stretched {scale:.2g} times:")
    for n, cells in enumerate(dots.tolist()):
        edge = {SKETCH_ROWS - 1: low, axis: 0.0, 0: high}.get(n)
        label = "" if edge is None else f"{edge:z.2f}"
        signs = ["│" if at in marked else "─" if n == axis else " " for at in range(SKETCH_COLUMNS)]
        drawn = (
            chr(_FIRST_DOT_PATTERN + one) if one else sign for one, sign in zip(cells, signs, strict=True)
        )
        print_line(f"{label:>7} {''.join(drawn)}".rstrip())
    print_line(f"{'':8}0{f'{deep:.4g}':>{SKETCH_COLUMNS - 1}}")


def _show(
    columns: Sequence[tuple[str, bool]],
    rows: Sequence[Sequence[str]],
    breaks: Sequence[int] = (),
    strong: Sequence[int] = (),
) -> None:
    """Print cells under (head, whether it stands at the right).

    To keep to the width of a terminal, or to `SCREEN_COLUMNS`, words are wrapped, not numbers; in a pipe a
    table whose numbers and longest words need more is wider.
    """
    from rich import box
    from rich.align import Align
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table
    from rich.text import Text

    def build(gap: int) -> Table:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, gap, 0, 0), pad_edge=False, show_edge=False)
        for head, is_right in columns:
            words = re.sub(r"(\d) %", "\\1\u00a0%", head)  # a number stays with its sign
            text = "\n".join(re.split("[ \n]+", words.strip(" \n"))) if is_right else head.strip()
            side: Literal["left", "right"] = "right" if is_right else "left"
            heading = Align(Text(text, justify=side), side, vertical="bottom")
            table.add_column(heading, justify=side, no_wrap=is_right, overflow="fold")
        for number, row in enumerate(rows):
            style = "bold" if number in strong else None
            table.add_row(*map(Text, row), style=style, end_section=number + 1 in breaks)
        return table

    console, spaced, close = (
        Console(width=None if sys.stdout.isatty() else SCREEN_COLUMNS),
        build(1),
        build(0),
    )
    unlimited = console.options.update(max_width=MAX_MEASURED_COLUMNS)  # else it is the console's width
    if not sys.stdout.isatty():
        console.width = max(SCREEN_COLUMNS, Measurement.get(console, unlimited, close).minimum)
    fits = Measurement.get(console, unlimited, spaced).maximum <= console.width
    console.print(spaced if fits else close)
    print_line()


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


# What stays open in a dataset: `needlefit check` prints these warnings in full, other commands in one line.
OPEN_POINTS = {"placeholder": "texts to fill in", "assumed": "assumptions of the import"}


def print_warnings(invocation: Invocation, warnings: Iterable[ResultWarning], in_full: bool = False) -> None:
    """Print warnings to stderr, each with the command that explains it.

    `in_full`: also each of `OPEN_POINTS`. With `--strict` the command then ends with exit code 5.
    """
    left: dict[str, None] = {}
    for one in warnings:
        invocation.warned = True
        if one.kind in OPEN_POINTS and not in_full:
            left[OPEN_POINTS[one.kind]] = None
        else:
            print_note(f"needlefit: warning: {one} ({one.help_command})")
    if left:
        print_note(f"needlefit: warning: the dataset has {' and '.join(left)} (listed by needlefit check)")
