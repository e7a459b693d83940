"""The needle that a user controls: its inputs (`mechanics.inputs`), one change of them, and what it does.

V-inputs act on the needle's shape (base, guides, a tracked tip), H-inputs on how far it is in and where it
cuts (depth, bevel). The moduli and a bevel strength throughout are no inputs of an insertion but parameters
of the model: with them the insertion so far is simulated again.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import groupby
from pathlib import Path

from needlefit.errors import ConfigError, DataError, ModelError
from needlefit.mechanics.control import Bevel, Controls, Guide, Step, TrackedTip
from needlefit.mechanics.inputs import MAX_GUIDE_NUMBER, find_input
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.scene import Scene, begin_session
from needlefit.mechanics.session import NeedleState, Session
from needlefit.mechanics.tissue import Tissue
from needlefit.mechanics.torsion import find_roll
from needlefit.project.input_files import parse_toml, read_text
from needlefit.project.toml import check, dumps
from needlefit.schemas.limits import MAX_NEEDLE_LENGTH_MM, MAX_NUMBER
from needlefit.schemas.scene import PlacementRecord, RecordingRecord, SceneRecord


def make_steered_scene(record: SceneRecord, where: str) -> Scene:
    """Return the scene of a needle to steer; `where` is named in errors.

    ConfigError if the model does not take it, or its needle leaves the plane z = 0 by other inputs than the
    roll of the bevel.
    """
    scene = Scene.from_record(record, where)
    if scene.tissue.torsional_friction or any(step.controls.act_along_z for step in scene.steps):
        raise ConfigError(
            "its tip lags behind the hub, or its base, guides or tip have inputs along z",
            expected="a needle that its bevel alone leads out of the plane",
            fix="`needlefit simulate` computes it",
            where=where,
        )
    return scene


def name_guides(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """Return a scene all of whose guides have a name, and the names in the order of their numbers."""
    steps = []
    for step in scene.steps:
        guides = tuple(replace(guide, name=guide.name or "guide") for guide in step.controls.guides)
        steps.append(replace(step, controls=replace(step.controls, guides=guides)))
    names = tuple(dict.fromkeys(guide.name for step in steps for guide in step.controls.guides))
    return replace(scene, steps=tuple(steps)), names


@dataclass(frozen=True)
class Change:
    """One input and its new value; ModelError if it is no such input or value."""

    name: str  #: a key of `INPUTS`, with its unit, or a shape parameter of a law; slopes are dy/dx
    item: int | None  #: number of the guide or layer, from 1
    value: float

    def __post_init__(self) -> None:
        input_ = find_input(self.name)
        if (self.item is None) != (input_.item is None) or (self.item is not None and self.item < 1):
            wanted = f"the number of a {input_.item}, from 1" if input_.item else "no item"
            raise ModelError(f"{self.name} has item {self.item!s:.20}", expected=wanted)
        if input_.item == "guide" and self.item is not None and self.item > MAX_GUIDE_NUMBER:
            raise ModelError(
                f"guides have no number {self.item!s:.20}", expected=f"a number from 1 to {MAX_GUIDE_NUMBER}"
            )
        most = MAX_NEEDLE_LENGTH_MM if self.name.endswith("_mm") else MAX_NUMBER
        finite = abs(self.value) <= most
        whole = self.name != "return_to" or float(self.value).is_integer()
        if not finite or not input_.allows(self.value) or not whole:
            largest = f"a finite number, at most {most:g}"
            where = "" if self.item is None else f" of {input_.item} {self.item}"
            expected = input_.expected if finite and input_.expected else largest
            raise ModelError(f"{self.name}{where} is {self.value:g}", expected=expected)

    @property
    def is_parameter(self) -> bool:
        """Whether it is a parameter of the model, which applies to the whole insertion."""
        return find_input(self.name).parameter


Values = dict[tuple[str, int | None], float]


def apply_changes(
    step: Step, changes: Iterable[Change], names: Sequence[str], stands: tuple[float, float]
) -> Step:
    """Return the depth and inputs of `step` after some inputs were changed.

    ModelError if the model has no such inputs.

    Parameters
    ----------
    changes : iterable of Change
    names : sequence of str
        What the scene calls its guides, in the order of their numbers.
    stands : (y, z)
        Where the tip stands, mm: it is held there where nothing says another place.
    """
    values: Values = {(change.name, change.item): change.value for change in changes}

    def of(name: str, now: float) -> float:
        return values.get((name, None), now)

    held, tip, angle = step.controls, step.controls.tip, values.get(("cut_angle_deg", None))
    if of("tip_held", 1.0) == 0:
        tip = None
    elif tip is not None or {("tip_held", None), ("tip_y_mm", None)} & values.keys():
        y, slope, z = (tip.y, tip.slope, tip.z) if tip else (stands[0], None, stands[1])
        tip = TrackedTip(of("tip_y_mm", y), values.get(("tip_slope", None), slope), z)
    controls = Controls(
        of("base_y_mm", held.base_y),
        of("base_slope", held.base_slope),
        held.stage_slope,
        _apply_to_guides(held.guides, values, names),
        tip,
    )
    side = values.get(("bevel_side", None))
    roll = find_roll(step.bevel) if side is None else 0.0 if side > 0 else 180.0
    bevel = Bevel.turn(
        of("bevel_roll_deg", roll),
        of("bevel_offset_mm", step.bevel.offset),
        step.bevel.cut_angle if angle is None else math.radians(angle),  # stays to the bit
    )
    return Step(of("depth_mm", step.depth), bevel, controls)


def find_changes(step: Step, now: Step, names: Sequence[str]) -> tuple[Change, ...]:
    """Return the changes that turn the inputs of `now` into those of `step`; the depth is not included."""
    wanted, held = step.controls, now.controls
    turned = ("bevel_side", float(step.bevel.side), float(now.bevel.side))
    if step.bevel.roll_deg or now.bevel.roll_deg:
        turned = ("bevel_roll_deg", find_roll(step.bevel), find_roll(now.bevel))
    pairs = [
        turned,
        ("bevel_offset_mm", step.bevel.offset, now.bevel.offset),
        ("cut_angle_deg", math.degrees(step.bevel.cut_angle), math.degrees(now.bevel.cut_angle)),
        ("base_y_mm", wanted.base_y, held.base_y),
        ("base_slope", wanted.base_slope, held.base_slope),
    ]
    changes = [Change(name, None, value) for name, value, before in pairs if value != before]
    there = {guide.name for guide in wanted.guides}
    for guide in held.guides:
        if guide.name not in there:
            changes.append(Change("guide_engaged", guide_number(guide, names), 0.0))
    for guide in wanted.guides:
        if guide not in held.guides:
            item = guide_number(guide, names)
            changes += [Change("guide_x_mm", item, guide.x), Change("guide_y_mm", item, guide.y)]
            changes.append(Change("guide_turns_freely", item, float(guide.slope is None)))
            if guide.slope is not None:
                changes.append(Change("guide_slope", item, guide.slope))
    if wanted.tip is None and held.tip is not None:
        changes.append(Change("tip_held", None, 0.0))
    elif wanted.tip is not None and wanted.tip != held.tip:
        changes.append(Change("tip_y_mm", None, wanted.tip.y))
        if wanted.tip.slope is not None:
            changes.append(Change("tip_slope", None, wanted.tip.slope))
    return tuple(changes)


def list_scene_changes(
    steps: Sequence[Step], names: Sequence[str]
) -> list[list[tuple[str, int | None, float]]]:
    """Return the changes of each step of a scene, which lead its needle from first contact to its end."""
    before = (steps[0], *steps)
    return [
        [
            *((one.name, one.item, one.value) for one in find_changes(step, now, names)),
            ("depth_mm", None, step.depth),
        ]
        for step, now in zip(steps, before, strict=False)
    ]


def guide_number(guide: Guide, names: Sequence[str]) -> int:
    """Return the number of a guide, counted from 1."""
    return names.index(guide.name) + 1 if guide.name in names else int(guide.name.removeprefix("guide "))


def _apply_to_guides(guides: Sequence[Guide], values: Values, names: Sequence[str]) -> tuple[Guide, ...]:
    now, moves = {guide.name: guide for guide in guides}, dict[int, dict[str, float]]()
    for (input_name, item), value in values.items():
        if item is not None and input_name.startswith("guide_"):
            moves.setdefault(item, {})[input_name.removeprefix("guide_")] = value
    for item, moved in sorted(moves.items()):
        name = names[item - 1] if item <= len(names) else f"guide {item}"
        if moved.get("engaged") == 0:
            now.pop(name, None)
            continue
        if (guide := now.get(name)) is None:
            if not {"x_mm", "y_mm"} <= moved.keys():
                raise ModelError(
                    f"there is no {name}",
                    expected="guide_x_mm and guide_y_mm together, which make a guide",
                    fix="add it before it is moved",
                )
            guide = Guide(moved["x_mm"], moved["y_mm"], 0.0, moved["x_mm"] >= 0, name)
        x, slope = moved.get("x_mm", guide.x), moved.get("slope", guide.slope)
        if "turns_freely" in moved:
            slope = None if moved["turns_freely"] else moved.get("slope", guide.slope or 0.0)
        now[name] = replace(guide, x=x, y=moved.get("y_mm", guide.y), slope=slope, in_tissue=x >= 0)
    return tuple(now.values())


class SteeredNeedle:
    """The needle of a scene, simulated step by step from first contact on.

    The same changes in the same order find the same bits, here and in the page (`page/model/steered.js`).
    `first_cell` is the depth of the first constraint point, mm.
    """

    def __init__(self, scene: Scene, first_cell: float) -> None:
        self.scene, self.names = name_guides(scene)
        self.number = 0  #: steps so far
        self._session = begin_session(self.scene, first_cell)
        self._saved: dict[int, Session] = {}
        self.keep()

    @property
    def now(self) -> NeedleState:
        return self._session.now

    @property
    def first_cell(self) -> float:
        """Depth of the first constraint point, mm."""
        return self._session.lattice.first_cell

    def input_path(self) -> tuple[Step, ...]:
        """Return the shortest steps that lead to the present state."""
        return self._session.input_path()

    def apply(self, changes: Sequence[Change]) -> NeedleState:
        """Carry out one step: all changes at once.

        ModelError if the model does not take them, or finds no needle that does; then nothing has happened.
        """
        inputs = [(change.name, change.item) for change in changes]
        for name, item in inputs:
            if inputs.count((name, item)) > 1:
                raise ModelError(f"{name} has two values in one step", expected="one value for each input")
            if name == "return_to" and len(inputs) > 1:
                raise ModelError("return_to stands beside other inputs", expected="a step of its own")
        if changes and changes[0].name == "return_to":
            number = int(changes[0].value)
            if number not in self._saved:
                raise ModelError(f"nothing was kept of step {number}", expected="a step to return to")
            # A copy: the stored state must survive further steps, for another return.
            self._session = self._saved[number].copy()
        else:
            self._session = self._advance(changes)
        self.number += 1
        return self.now

    def keep(self) -> None:
        self._saved[self.number] = self._session.copy()

    def forget(self, number: int) -> None:
        """Delete the state stored at a step; the initial state stays."""
        if number:
            self._saved.pop(number, None)

    def _advance(self, changes: Sequence[Change]) -> Session:
        """Return the session after a step; the one there is stays as it was if that fails."""
        session = self._session
        parameters = [change for change in changes if change.is_parameter]
        if parameters:
            given = {change.name: change.value for change in parameters}
            angle = given.get("cut_angle_throughout_deg")
            session = session.simulate_again(
                _with_parameters(session.tissue, parameters),
                given.get("offset_throughout_mm"),
                None if angle is None else math.radians(angle),
            )
            _require_found(
                not session.failures,
                f"with these parameters the insertion so far fails {session.depth:.1f} mm deep",
                "change them less, or retract the needle first",
            )
        moved = [change for change in changes if not change.is_parameter]
        shape = session.now.shape
        stands = float(shape.u[-1]), float(shape.w[-1])
        step = apply_changes(session.last, moved, self.names, stands)
        if step != session.last:
            shape = session.go(step)
            problem = f"the model finds no needle there ({shape.status})"
            _require_found(shape.converged, problem, "move less at a time")
        return session


def _require_found(is_found: bool, problem: str, fix: str) -> None:
    if not is_found:
        raise ModelError(problem, fix=fix)


def _with_parameters(tissue: Tissue, parameters: Sequence[Change]) -> Tissue:
    """Return the tissue with other moduli (Pa in the changes, MPa in the tissue) and shape parameters."""
    mu, shape = tissue.mu.copy(), tissue.shape.copy()
    names = LAWS[tissue.law].shape_names
    for change in parameters:
        if change.item is None:
            continue
        if change.item > tissue.layers:
            raise ModelError(
                f"there is no layer {change.item!s:.20}", expected=f"one of {tissue.layers} layers"
            )
        if change.name == "mu_pa":
            mu[change.item - 1] = change.value * 1e-6
        elif change.name in names:
            shape[names.index(change.name), change.item - 1] = change.value
        else:
            raise ModelError(
                f"the tissue law `{tissue.law}` has no {change.name}", expected=", ".join(["mu_pa", *names])
            )
    return replace(tissue, mu=mu, shape=shape, is_checked=True)


# ---- the recording of an interactive insertion: a CSV file
#
# Its first lines begin with `#`; without that they are TOML: the scene, whole, and the model's first cell.
# Then comes one row an input, `step,time_s,input,item,value,tip_lateral_mm`; the rows of one step act
# together, and its last row says where the tip then stood, so that whoever replays it can tell whether they
# found the same. Numbers are written so that reading gives the same bits.

COLUMNS = ("step", "time_s", "input", "item", "value", "tip_lateral_mm")
#: largest number of digits of a guide's or layer's number; Python refuses to convert thousands of digits
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
