"""The recording of an interactive insertion: a CSV file that is complete after every step.

Its first lines begin with `#`; without that they are TOML: the scene, whole, and the model's first cell. Then
comes one row an input, `step,time_s,input,item,value,tip_lateral_mm`; the rows of one step act together, and
its last row says where the tip then stood, so that whoever replays it can tell whether they found the same.
Numbers are written so that reading gives the same bits.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from needlefit import __version__
from needlefit.errors import DataError, ModelError
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.session import NeedleState
from needlefit.project.input_files import parse_toml, read_text
from needlefit.project.load import check
from needlefit.project.toml_text import dumps
from needlefit.schemas.limits import MAX_NUMBER
from needlefit.schemas.tracker import PlacementRecord, RecordingRecord
from needlefit.viewer.interaction.inputs import Change
from needlefit.viewer.interaction.steering import SteeredNeedle

COLUMNS = ("step", "time_s", "input", "item", "value", "tip_lateral_mm")

MAX_ITEM_DIGITS = 6
"""Digits of the number of a guide or layer; Python refuses to convert thousands of digits."""


@dataclass(frozen=True)
class RecordedStep:
    """One step of a recording.

    Attributes
    ----------
    number : int
        From 1.
    time : float
        Since the recording began, s.
    tip_lateral : float
        Of the tip after it, mm.
    line : int
        Of the file where it begins.
    """

    number: int
    time: float
    changes: tuple[Change, ...]
    tip_lateral: float
    line: int = 0


@dataclass(frozen=True)
class Recording:
    """The contents of a recording: the scene, and the steps of its needle."""

    head: RecordingRecord
    steps: tuple[RecordedStep, ...]
    where: str = ""


class RecordingWriter:
    """Writes a recording step by step; a written step stays in the file however the program ends.

    The file is made at the first step.
    """

    def __init__(self, path: Path, head: RecordingRecord) -> None:
        self.path, self._head, self._begun = path, head, False

    def write(self, step: RecordedStep) -> None:
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
        """Create the file with its head, unless it exists; OSError if it cannot be written."""
        if self._begun:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # x: an existing file is never overwritten.
        with self.path.open("xb", buffering=0) as file:
            file.write(_head_lines(self._head).encode())
        self._begun = True


def read_recording(path: Path) -> Recording:
    """Return the recording in a file; an incomplete last line is left out.

    Raises
    ------
    DataError, ConfigError
        If it is not a recording, or one of its lines or keys is wrong.
    """
    lines = read_text(path).splitlines(keepends=True)
    count = next((n for n, line in enumerate(lines) if not line.startswith("#")), len(lines))
    head = _head(lines[:count], path)
    if count < len(lines) and lines[count].strip() != ",".join(COLUMNS):
        raise _line_error(path, count + 1, "other columns", ",".join(COLUMNS))
    if count < len(lines) - 1 and not lines[-1].endswith("\n"):
        lines.pop()  # cut off while it was written
    rows = (_row(text, line, path) for line, text in enumerate(lines[count + 1 :], start=count + 2))
    return Recording(head, tuple(_steps(rows, path)), str(path))


def _head_lines(head: RecordingRecord) -> str:
    tables = head.model_dump(mode="json", by_alias=True, exclude_none=True)
    text = "a needle steered by hand; `needlefit simulate --recording FILE` replays it\n" + dumps(tables)
    first, *rest = text.splitlines()
    lines = [f"# # {first}", *(f"# {line}".rstrip() for line in rest)]
    return "\n".join([*lines, ",".join(COLUMNS)]) + "\n"


def _rows(step: RecordedStep) -> Iterator[str]:
    for n, change in enumerate(step.changes, start=1):
        item = "" if change.item is None else str(change.item)
        last = repr(step.tip_lateral) if n == len(step.changes) else ""
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


class _LogRow(NamedTuple):
    """A line of a log, its cells as they are written."""

    line: int
    step: str
    time: str
    name: str
    item: str
    value: str
    tip_lateral: str


def _row(text: str, line: int, path: Path) -> _LogRow:
    (cells,) = csv.reader([text])
    if len(cells) != len(COLUMNS):
        raise _line_error(path, line, f"{len(cells)} cells", f"{len(COLUMNS)}: {','.join(COLUMNS)}")
    return _LogRow(line, *cells)


def _steps(rows: Iterable[_LogRow], path: Path) -> Iterator[RecordedStep]:
    """Yield the steps; the last one is left out if its other rows were cut off."""
    open_at = 0
    for number, (_, group) in enumerate(groupby(rows, key=lambda row: row.step), start=1):
        first, *_ = step = list(group)
        if first.step != str(number):
            raise _line_error(path, first.line, f"step {first.step}", f"step {number}: none left out")
        *before, last = step
        if open_at or any(row.tip_lateral for row in before):
            at = open_at or first.line
            raise _line_error(
                path, at, "tip_lateral_mm", "a number in the last row of a step, and only there"
            )
        if last.tip_lateral:
            time, tip_lateral = _time(first, path), _number(last.tip_lateral, last.line, path)
            yield RecordedStep(number, time, _changes(step, path), tip_lateral, first.line)
        else:
            open_at = first.line


def _time(row: _LogRow, path: Path) -> float:
    time = _number(row.time, row.line, path)
    if time < 0:
        raise _line_error(path, row.line, f"time_s is {row.time}", "seconds since the recording began")
    return time


def _changes(step: Sequence[_LogRow], path: Path) -> tuple[Change, ...]:
    """Return the inputs of a step, each of which has one value."""
    found: dict[tuple[str, int | None], Change] = {}
    for row in step:
        change = _change(row, path)
        if (change.name, change.item) in found:
            raise _line_error(
                path, row.line, f"a second {row.name} in step {row.step}", "one value for each input"
            )
        found[change.name, change.item] = change
    return tuple(found.values())


def _change(row: _LogRow, path: Path) -> Change:
    if row.item and not (row.item.isdecimal() and len(row.item) <= MAX_ITEM_DIGITS):
        raise _line_error(path, row.line, f"item `{row.item}`", "the number of a guide or layer, or nothing")
    try:
        value = _number(row.value, row.line, path)
        return Change(row.name, int(row.item) if row.item else None, value)
    except ModelError as error:
        raise _line_error(path, row.line, error.what, error.expected) from None


def _number(text: str, line: int, path: Path) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= MAX_NUMBER:
        raise _line_error(path, line, f"`{text}`", "a finite number")
    return number


def _line_error(path: Path, line: int, what: str, expected: str) -> DataError:
    fix = "replay the file as it was recorded"
    return DataError(what, where=f"{path}, line {line}", expected=expected, fix=fix)


def make_head(
    target: str, first_cell: float, scene: dict[str, object], placement: PlacementRecord | None = None
) -> RecordingRecord:
    """Return the head of a new recording of a scene (a record) at `placement`."""
    tables = {
        "schema": RecordingRecord.SCHEMA,
        "needlefit": __version__,
        "target": target,
        "first_cell_mm": first_cell,
    }
    lies = {} if placement is None else {"placement": placement.model_dump(mode="json")}
    return check(tables | lies | {"scene": scene}, RecordingRecord, "recording")


@dataclass(frozen=True)
class ReplayedStep:
    """One step of a recording after its replay.

    Attributes
    ----------
    recorded : RecordedStep or None
        The recorded step; None for the needle at first contact.
    state : NeedleState
        The needle after it.
    """

    recorded: RecordedStep | None
    state: NeedleState

    @property
    def time(self) -> float:
        """Time since the recording began, s."""
        return self.recorded.time if self.recorded else 0.0

    @property
    def tip_offset_mm(self) -> float:
        """Distance of the tip from its recorded position, mm; 0: the same bits."""
        return abs(self.state.shape.tip_lateral - self.recorded.tip_lateral) if self.recorded else 0.0


def begin_replay(recording: Recording) -> SteeredNeedle:
    """Return the needle of a recording at first contact.

    Raises
    ------
    ConfigError
        If the model does not take its scene.
    """
    return SteeredNeedle(
        Scene.from_record(recording.head.scene, recording.where), recording.head.first_cell_mm
    )


def replay(recording: Recording, steering: SteeredNeedle | None = None) -> Iterator[ReplayedStep]:
    """Yield the needle at first contact and after every step of a recording.

    Parameters
    ----------
    steering : SteeredNeedle, optional
        The needle for the replay, at first contact; by default a new one.

    Raises
    ------
    DataError
        If a step cannot be carried out; it was recorded by another version, or changed since.
    """
    steering = steering or begin_replay(recording)
    last = find_last_returns(recording.steps)
    yield ReplayedStep(None, steering.now)
    for recorded in recording.steps:
        try:
            state = steering.apply(recorded.changes)
        except ModelError as error:
            raise DataError(
                f"step {recorded.number} cannot be carried out: {error.what}",
                where=f"{recording.where}, line {recorded.line}",
                expected=error.expected,
                fix=f"it was recorded by needlefit {recording.head.needlefit}; replay it with that version",
            ) from error
        keep_for_returns(recorded, last, steering.keep, steering.forget)
        yield ReplayedStep(recorded, state)


def find_last_returns(steps: Sequence[RecordedStep]) -> dict[int, int]:
    """Return the steps to which the needle returns, each with the number of the last that does."""
    return {int(c.value): step.number for step in steps for c in step.changes if c.name == "return_to"}


def keep_for_returns(
    recorded: RecordedStep, last: dict[int, int], keep: Callable[[], None], forget: Callable[[int], None]
) -> None:
    """Store the state after a step if a later step returns to it; delete a state after its last return."""
    if recorded.number in last:
        keep()
    for change in recorded.changes:
        if change.name == "return_to" and last[int(change.value)] == recorded.number:
            forget(int(change.value))
