"""The recording of an interactive insertion: a CSV file.

Its first lines begin with `#`; without that they are TOML: the scene, whole, and the model's first cell. Then
comes one row an input, `step,time_s,input,item,value,tip_lateral_mm`; the rows of one step act together, and
its last row says where the tip then stood, so that whoever replays it can tell whether they found the same.
Numbers are written so that reading gives the same bits.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import groupby
from pathlib import Path

from needlefit.errors import DataError, ModelError
from needlefit.mechanics.session import NeedleState
from needlefit.planning.steered_needle import Change, SteeredNeedle, make_steered_scene
from needlefit.project.input_files import parse_toml, read_text
from needlefit.project.toml import check, dumps
from needlefit.schemas.limits import MAX_NUMBER
from needlefit.schemas.scene import PlacementRecord, RecordingRecord, SceneRecord

COLUMNS = ("step", "time_s", "input", "item", "value", "tip_lateral_mm")
#: digits of the number of a guide or layer; Python refuses to convert thousands of digits
MAX_ITEM_DIGITS = 6


@dataclass(frozen=True)
class RecordedStep:
    """One step of a recording: its number from 1, time (s), and the tip's lateral displacement after it (mm).

    `line` is the line of the file where it begins.
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


def make_head(
    target: str, first_cell: float, scene: SceneRecord, placement: PlacementRecord | None = None
) -> RecordingRecord:
    """Return the head of a new recording of a scene at `placement`; `first_cell` in mm."""
    tables = {"needlefit": version("needlefit"), "target": target, "first_cell_mm": first_cell}
    placed = {} if placement is None else {"placement": placement.model_dump(mode="json")}
    tables |= placed | {
        "schema": RecordingRecord.SCHEMA,
        "scene": scene.model_dump(mode="json", by_alias=True),
    }
    return check(tables, RecordingRecord, "recording")


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording, which `view` and `simulate` replay; OSError if it cannot be written."""
    rows = []
    for step in recording.steps:
        for change in step.changes:
            item = "" if change.item is None else str(change.item)
            rows.append(f"{step.number},{step.time:.4f},{change.name},{item},{change.value!r},\n")
        rows[-1] = f"{rows[-1][:-1]}{step.tip_lateral!r}\n"
    path.write_bytes((format_head(recording.head) + "".join(rows)).encode())


def format_head(head: RecordingRecord) -> str:
    """Return the lines of a recording before its first step."""
    tables = head.model_dump(mode="json", by_alias=True, exclude_none=True)
    text = "# a needle steered by hand; `needlefit simulate --recording FILE` replays it\n" + dumps(tables)
    lines = [f"# {line}".rstrip() for line in text.splitlines()]
    return "\n".join([*lines, ",".join(COLUMNS)]) + "\n"


def read_recording(path: Path) -> Recording:
    """Return the recording in a file; an incomplete last line is left out.

    DataError or ConfigError if it is not a recording, or one of its lines or keys is wrong.
    """
    lines = read_text(path).splitlines(keepends=True)
    count = next((n for n, line in enumerate(lines) if not line.startswith("#")), len(lines))
    head = "".join(line[1:].removeprefix(" ") for line in lines[:count])
    tables = parse_toml(head, f"{path}, its first lines", DataError)
    if not tables:
        raise DataError(
            "is no recording: it does not begin with the scene",
            expected="a file that `needlefit view` recorded",
            where=path,
        )
    record = check(tables, RecordingRecord, str(path))
    if count < len(lines) and lines[count].strip() != ",".join(COLUMNS):
        raise _line_error(path, count + 1, "other columns", ",".join(COLUMNS))
    if count < len(lines) - 1 and not lines[-1].endswith("\n"):
        lines.pop()  # cut off while it was written
    rows = (
        _Row(path, line, next(csv.reader([text]))) for line, text in enumerate(lines[count + 1 :], count + 2)
    )
    return Recording(record, tuple(_list_steps(rows)), str(path))


def _line_error(path: Path, line: int, problem: str, expected: str) -> DataError:
    fix = "replay the file as it was recorded"
    return DataError(problem, where=f"{path}, line {line}", expected=expected, fix=fix)


class _Row:
    """A line of a recording, its cells as they are written."""

    def __init__(self, path: Path, line: int, cells: list[str]) -> None:
        self.path, self.line = path, line
        if len(cells) != len(COLUMNS):
            raise self.refuse(f"{len(cells)} cells", f"{len(COLUMNS)}: {','.join(COLUMNS)}")
        self.step, self.time, self.name, self.item, self.value, self.tip_lateral = cells

    def refuse(self, problem: str, expected: str) -> DataError:
        return _line_error(self.path, self.line, problem, expected)

    def number(self, text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not abs(number) <= MAX_NUMBER:
            raise self.refuse(f"`{text}`", "a finite number")
        return number

    def change(self) -> Change:
        if self.item and not (self.item.isdecimal() and len(self.item) <= MAX_ITEM_DIGITS):
            raise self.refuse(f"item `{self.item}`", "the number of a guide or layer, or nothing")
        value = self.number(self.value)
        try:
            return Change(self.name, int(self.item) if self.item else None, value)
        except ModelError as error:
            raise self.refuse(error.what, error.expected) from None


def _list_steps(rows: Iterable[_Row]) -> Iterator[RecordedStep]:
    """Yield the steps; the last one is left out if its other rows were cut off."""
    cut: _Row | None = None
    for number, (_, group) in enumerate(groupby(rows, key=lambda row: row.step), start=1):
        *before, last = step = list(group)
        first = step[0]
        if first.step != str(number):
            raise first.refuse(f"step {first.step}", f"step {number}: none left out")
        if cut is not None or any(row.tip_lateral for row in before):
            expected = "a number in the last row of a step, and only there"
            raise (cut or first).refuse("tip_lateral_mm", expected)
        if not last.tip_lateral:
            cut = first
            continue
        time, tip_lateral = first.number(first.time), last.number(last.tip_lateral)
        if time < 0:
            raise first.refuse(f"time_s is {first.time}", "seconds since the recording began")
        changes: dict[tuple[str, int | None], Change] = {}
        for row in step:
            change = row.change()
            if changes.setdefault((change.name, change.item), change) is not change:
                raise row.refuse(f"a second {row.name} in step {row.step}", "one value for each input")
        yield RecordedStep(number, time, tuple(changes.values()), tip_lateral, first.line)


@dataclass(frozen=True)
class ReplayedStep:
    """The needle after one step of a recording; `recorded` is None for the needle at first contact."""

    recorded: RecordedStep | None
    state: NeedleState

    @property
    def tip_offset_mm(self) -> float:
        """Distance of the tip from its recorded position, mm; 0: the same bits."""
        return abs(self.state.shape.tip_lateral - self.recorded.tip_lateral) if self.recorded else 0.0


def begin_replay(recording: Recording) -> SteeredNeedle:
    """Return the needle of a recording at first contact; ConfigError if the model does not take its scene."""
    scene = make_steered_scene(recording.head.scene, recording.where)
    return SteeredNeedle(scene, recording.head.first_cell_mm)


def replay(recording: Recording, steering: SteeredNeedle | None = None) -> Iterator[ReplayedStep]:
    """Yield the needle at first contact and after every step of a recording.

    `steering` is the needle for the replay, at first contact; by default a new one. DataError if a step
    cannot be carried out; it was recorded by another version, or changed since.
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
                expected=error.expected,
                fix=f"it was recorded by needlefit {recording.head.needlefit}; replay it with that version",
                where=f"{recording.where}, line {recorded.line}",
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
