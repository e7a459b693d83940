"""The input log: a CSV that holds all of an interactive insertion, and is complete after every step.

Its first lines begin with `#`; without that they are TOML: the scene, whole, and the model's first cell. Then
comes one row an input, `step,time_s,input,item,value,deflection_mm`; the rows of one step act together, and
its last row says where the tip then stood, so that whoever replays it can tell whether they found the same.
Numbers are written so that reading gives the same bits.
"""

import csv
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from needlefit import __version__
from needlefit.datasets.formats.text import read_text
from needlefit.datasets.formats.toml import dumps
from needlefit.errors import DataError, ModelError
from needlefit.project.load import check
from needlefit.project.records.recording import PlacementRecord, RecordingRecord
from needlefit.viewer.hand.inputs import Change

COLUMNS = ("step", "time_s", "input", "item", "value", "deflection_mm")


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
        raise _wrong(path, count + 1, f"columns {lines[count].strip()}", ",".join(COLUMNS))
    body = list(enumerate(lines[count + 1 :], start=count + 2))
    if body and not body[-1][1].endswith("\n"):
        body.pop()  # cut off while it was written
    return Recording(head, tuple(_steps(body, path)), str(path))


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
    try:
        tables = tomllib.loads("".join(line[1:].removeprefix(" ") for line in lines))
    except tomllib.TOMLDecodeError as error:
        raise DataError(
            f"its head is no TOML: {error}",
            where=str(path),
            expected="lines `# key = value` that say the scene",
            mend="replay the file as it was recorded",
        ) from None
    if not tables:
        raise DataError(
            "is no recording: it does not begin with the scene",
            where=str(path),
            expected="a file that `needlefit view` recorded",
        )
    return check(tables, RecordingRecord, str(path))


def _steps(body: Sequence[tuple[int, str]], path: Path) -> Iterator[Recorded]:
    rows = [(line, _cells(text, line, path)) for line, text in body]
    groups = [list(group) for _, group in groupby(rows, key=lambda row: row[1]["step"])]
    for number, group in enumerate(groups, start=1):
        line, first = group[0]
        if first["step"] != str(number):
            raise _wrong(path, line, f"step {first['step']}", f"step {number}: none left out")
        *before, last = (cells["deflection_mm"] for _, cells in group)
        if not last and number == len(groups):
            return  # its other rows were cut off
        if any(before) or not last:
            raise _wrong(path, line, "deflection_mm", "a number in the last row of a step, and only there")
        changes = tuple(_change(cells, at, path) for at, cells in group)
        time, deflection = (_number(text, line, path) for text in (first["time_s"], last))
        yield Recorded(number, time, changes, deflection, line)


def _cells(text: str, line: int, path: Path) -> dict[str, str]:
    (cells,) = csv.reader([text])
    if len(cells) != len(COLUMNS):
        raise _wrong(path, line, f"{len(cells)} cells", f"{len(COLUMNS)}: {','.join(COLUMNS)}")
    return dict(zip(COLUMNS, cells, strict=True))


def _change(cells: dict[str, str], line: int, path: Path) -> Change:
    item = cells["item"]
    if item and not item.isdecimal():
        raise _wrong(path, line, f"item `{item}`", "the number of a guide or layer, or nothing")
    try:
        return Change(cells["input"], int(item) if item else None, _number(cells["value"], line, path))
    except ModelError as error:
        raise _wrong(path, line, error.what, error.expected) from None


def _number(text: str, line: int, path: Path) -> float:
    try:
        return float(text)
    except ValueError:
        raise _wrong(path, line, f"`{text}`", "a number") from None


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
