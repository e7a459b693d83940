"""The input log: a CSV that holds all of an interactive insertion, and is complete after every step.

Its first lines begin with `#`; without that they are TOML: the scene, whole, and the model's first cell. Then
comes one row an input, `step,time_s,input,item,value,deflection_mm`; the rows of one step act together, and
its last row says where the tip then stood, so that whoever replays it can tell whether they found the same.
Numbers are written so that reading gives the same bits.
"""

import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from needlefit import __version__
from needlefit.datasets.formats.toml import dumps
from needlefit.errors import DataError, ModelError
from needlefit.project.load import check
from needlefit.project.reading import parse_toml, read_text
from needlefit.project.records.recording import PlacementRecord, RecordingRecord
from needlefit.viewer.hand.inputs import Change

COLUMNS = ("step", "time_s", "input", "item", "value", "deflection_mm")

MAX_ITEM_DIGITS = 6
"""Of the number of a guide or layer; Python refuses to convert thousands of digits."""


@dataclass(frozen=True)
class Recorded:
    """One step of a recording.

    Attributes
    ----------
    number : int
        From 1.
    time : float
        Since the recording began, s.
    changes : tuple of Change
    deflection : float
        Of the tip after it, mm.
    line : int
        Of the file where it begins.
    """

    number: int
    time: float
    changes: tuple[Change, ...]
    deflection: float
    line: int = 0


@dataclass(frozen=True)
class Recording:
    """What a log holds: the scene, and what was done to its needle."""

    head: RecordingRecord
    steps: tuple[Recorded, ...]
    where: str = ""


class Recorder:
    """Writes a recording as it happens; a step that was written is there whatever ends the program.

    The file is made at the first step.
    """

    def __init__(self, path: Path, head: RecordingRecord) -> None:
        self.path, self._head, self._begun = path, head, False

    def write(self, step: Recorded) -> None:
        """Append a step.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        self.begin()
        # one write, unbuffered: the step is in the system's hands, or it is not there at all
        with self.path.open("ab", buffering=0) as file:
            file.write("".join(_rows(step)).encode())

    def begin(self) -> None:
        """Make the file with its head, where that was not done; raise OSError if it cannot be written."""
        if self._begun:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("xb", buffering=0) as file:
            file.write(_head_lines(self._head).encode())
        self._begun = True


def read(path: Path) -> Recording:
    """Return the recording in a file; a step that was cut off at its end is left out.

    Raises
    ------
    DataError, ConfigError
        If it is none, or one of its lines or keys is wrong.
    """
    lines = read_text(path).splitlines(keepends=True)
    count = next((n for n, line in enumerate(lines) if not line.startswith("#")), len(lines))
    head = _head(lines[:count], path)
    if count < len(lines) and lines[count].strip() != ",".join(COLUMNS):
        raise _wrong(path, count + 1, "other columns", ",".join(COLUMNS))
    if count < len(lines) - 1 and not lines[-1].endswith("\n"):
        lines.pop()  # cut off while it was written
    rows = (_row(text, line, path) for line, text in enumerate(lines[count + 1 :], start=count + 2))
    return Recording(head, tuple(_steps(rows, path)), str(path))


def _head_lines(head: RecordingRecord) -> str:
    tables = head.model_dump(mode="json", by_alias=True, exclude_none=True)
    text = "a needle steered by hand; `needlefit simulate --inputs FILE` replays it\n" + dumps(tables)
    first, *rest = text.splitlines()
    lines = [f"# # {first}", *(f"# {line}".rstrip() for line in rest)]
    return "\n".join([*lines, ",".join(COLUMNS)]) + "\n"


def _rows(step: Recorded) -> Iterator[str]:
    for n, change in enumerate(step.changes, start=1):
        item = "" if change.item is None else str(change.item)
        last = repr(step.deflection) if n == len(step.changes) else ""
        yield f"{step.number},{step.time:.4f},{change.name},{item},{change.value!r},{last}\n"


def _head(lines: Sequence[str], path: Path) -> RecordingRecord:
    head = "".join(line[1:].removeprefix(" ") for line in lines)
    tables = parse_toml(head, f"{path}, its first lines", DataError)
    if not tables:
        raise DataError(
            "is no recording: it does not begin with the scene",
            where=str(path),
            expected="a file that `needlefit view` recorded",
        )
    return check(tables, RecordingRecord, str(path))


class _Row(NamedTuple):
    """A line of a log, its cells as they are written."""

    line: int
    step: str
    time: str
    name: str
    item: str
    value: str
    deflection: str


def _row(text: str, line: int, path: Path) -> _Row:
    (cells,) = csv.reader([text])
    if len(cells) != len(COLUMNS):
        raise _wrong(path, line, f"{len(cells)} cells", f"{len(COLUMNS)}: {','.join(COLUMNS)}")
    return _Row(line, *cells)


def _steps(rows: Iterable[_Row], path: Path) -> Iterator[Recorded]:
    """Yield the steps; the last one is left out if its other rows were cut off."""
    open_at = 0
    for number, (_, group) in enumerate(groupby(rows, key=lambda row: row.step), start=1):
        first, *_ = step = list(group)
        if first.step != str(number):
            raise _wrong(path, first.line, f"step {first.step}", f"step {number}: none left out")
        *before, last = step
        if open_at or any(row.deflection for row in before):
            at = open_at or first.line
            raise _wrong(path, at, "deflection_mm", "a number in the last row of a step, and only there")
        if last.deflection:
            time, deflection = _time(first, path), _number(last.deflection, last.line, path)
            yield Recorded(number, time, _changes(step, path), deflection, first.line)
        else:
            open_at = first.line


def _time(row: _Row, path: Path) -> float:
    time = _number(row.time, row.line, path)
    if time < 0:
        raise _wrong(path, row.line, f"time_s is {row.time}", "seconds since the recording began")
    return time


def _changes(step: Sequence[_Row], path: Path) -> tuple[Change, ...]:
    """Return the inputs of a step, each of which has one value."""
    found: dict[tuple[str, int | None], Change] = {}
    for row in step:
        change = _change(row, path)
        if (change.name, change.item) in found:
            raise _wrong(
                path, row.line, f"a second {row.name} in step {row.step}", "one value for each input"
            )
        found[change.name, change.item] = change
    return tuple(found.values())


def _change(row: _Row, path: Path) -> Change:
    if row.item and not (row.item.isdecimal() and len(row.item) <= MAX_ITEM_DIGITS):
        raise _wrong(path, row.line, f"item `{row.item}`", "the number of a guide or layer, or nothing")
    try:
        value = _number(row.value, row.line, path)
        return Change(row.name, int(row.item) if row.item else None, value)
    except ModelError as error:
        raise _wrong(path, row.line, error.what, error.expected) from None


def _number(text: str, line: int, path: Path) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise _wrong(path, line, f"`{text}`", "a finite number")
    return number


def _wrong(path: Path, line: int, what: str, expected: str) -> DataError:
    mend = "replay the file as it was recorded"
    return DataError(what, where=f"{path}, line {line}", expected=expected, mend=mend)


def head_of(
    subject: str, first_cell: float, scene: dict[str, object], placement: PlacementRecord | None = None
) -> RecordingRecord:
    """Return the head of a new recording of a scene (as its record says it), which lies at `placement`."""
    tables = {"schema": 1, "needlefit": __version__, "subject": subject, "first_cell_mm": first_cell}
    lies = {} if placement is None else {"placement": placement.model_dump(mode="json")}
    return check(tables | lies | {"scene": scene}, RecordingRecord, "recording")
