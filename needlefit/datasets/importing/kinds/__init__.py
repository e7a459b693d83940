"""What rows of a table may be: points of shapes, tips, curvatures, readings of tips, turns, or facts.

Each file has the name of its kind, as `holds` of a mapping states it: how a table of it is recognised, how
its rows are read, and how its needles are placed. Here is what all kinds share: a needle as it was read, and
how what holds of needles is settled.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.importing.draft_table import Columns, Records, TableDraft
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.stated import Settler, Stated, name_set
from needlefit.datasets.insertion import Pose
from needlefit.datasets.layers import SAME_POINT_MM, find_length_tolerance, select_layers
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame, to_unit
from needlefit.geometry.surfaces import Surface
from needlefit.project.locate import join_names
from needlefit.registry import Registry
from needlefit.schemas.mapping import Holds
from needlefit.schemas.scene import NeedleRecord

MIN_SAME_SIDE = 0.9  # smallest length of the mean of unit deflections that have one direction
SAME_AXIS_DEG = 10.0  # largest angle (degrees) to a world axis at which that axis is proposed


@dataclass(frozen=True)
class TipReading:
    """A deflection of a tip from the line of insertion."""

    deflection: Floats  # (2,), mm; up and to the right
    sd: float | None  # mm; None: that of a point
    where: str


@dataclass(eq=False)
class ImportedCurve:
    """One needle: its points in mm, which planning may cut, and what is stated of it."""

    name: str
    points: Points  # of tips and tracks (depth, deflections) or places, a reading a row
    kind: "RowKind"
    stated: dict[str, Stated] = field(default_factory=dict)  # of `ATTRIBUTES`
    depths: Floats = field(default_factory=lambda: np.empty(0))  # (N,), mm; of readings, empty: not stated
    depth_column: str = ""  # the header of the depths of readings
    is_deflection: bool = False  # the points are (depth, deflection up, to the right)
    rolls: Floats = field(default_factory=lambda: np.empty(0))  # (N,), of readings; where the bevel faces
    times: Floats = field(default_factory=lambda: np.empty(0))  # (N,), s; of readings whose depths are open
    guide: Floats | None = None  # (N, 3), mm; places of the guide at the readings
    is_named: bool = True  # a cell names it; else it has the name of its file or sheet
    given: str = ""  # its name in the file, which several curves may have
    hole: str = ""  # the name that depths of one hole have together
    # (3,), mm; from where its reach counts
    origin: Floats = field(default_factory=lambda: np.zeros(3))
    side: int = 1  # of its bevel, 1 or -1
    turn: float = 0.0  # rad; by which the bevel of side 1 is turned from up, about the needle
    shaft: Floats = field(default_factory=lambda: np.empty((0, 3)))  # (K, 3), mm; points up to the entry
    turns: list[tuple[float, Stated]] = field(default_factory=list)  # depths, mm, and where bevels face then
    sensors: list[Floats] = field(default_factory=list)  # (4,) each: `SENSOR` in mm and 1/mm
    tips: list[TipReading] = field(default_factory=list)  # of its tip, measured beside the shape
    are_sensors_from_base: bool = False  # places of sensors are counted from the needle's base, not its tip
    before: float = 0.0  # mm; inserted length before the first point, of points with stated depths
    # of planning: the place of its entry, mm (None: its first point), boundaries along it, mm, the standard
    # deviation of a point, mm, the needle, the frame of its insertion (of tips), and the row of the dataset
    entry: Floats | None = None
    boundaries: tuple[float, ...] = ()
    point_sd: float = 0.0
    needle: NeedleRecord = field(init=False)
    frame: Frame = IDENTITY_FRAME
    row: InsertionRow = field(init=False)

    def fill(self, **cells: Any) -> None:  # noqa: ANN401 - values of fields of the row
        """Fill in cells of the row."""
        self.row = replace(self.row, **cells)

    def state(self, facts: Mapping[str, Stated]) -> None:
        """Add what is stated of the needle; DataError if something else was stated before."""
        for meaning, fact in facts.items():
            other = self.stated.setdefault(meaning, fact)
            if other.text != fact.text:
                raise DataError(
                    f"{meaning} of {self.name} is {fact.text[:60]!r}, in {other.where} {other.text[:60]!r}",
                    expected="one value",
                    fix="correct one of the two",
                    where=fact.where,
                )

    def reverse(self) -> None:
        """Put the last point first."""
        self.points = self.points.part(np.arange(len(self.line))[::-1])

    def keep_readings(self, rows: NDArray[np.intp]) -> None:
        """Keep the readings of a tip at these rows: points, rolls, and places of the guide."""
        self.points = self.points.part(rows)
        self.rolls = self.rolls[rows] if len(self.rolls) else self.rolls
        self.guide = None if self.guide is None else self.guide[rows]

    @property
    def line(self) -> Floats:
        """The points (N, 3)."""
        return self.points.values

    @property
    def chord(self) -> Floats:
        """The way from the first point to the last (3,), mm."""
        chord: Floats = self.line[-1] - self.line[0]
        return chord

    @property
    def reading_depths(self) -> Floats:
        """The depths of readings of a tip (N,), mm; empty where they are not stated."""
        return self.line[:, 0] if self.is_deflection else self.depths

    @property
    def length(self) -> float:
        """The length of the curve smoothed to its noise."""
        return self.points.curve.length

    @property
    def start(self) -> Floats:
        """The place of its entry (3,), mm."""
        return self.line[0] if self.entry is None else self.entry

    @property
    def direction(self) -> Floats:
        """The unit direction of its insertion (3,), once it is placed."""
        assert self.row.direction is not None
        return self.row.direction

    @property
    def is_turned(self) -> bool:
        """Whether what was measured of it depends on where its bevel faces on the way."""
        return bool(self.turns or self.sensors or self.tips)

    @property
    def depth_tolerance(self) -> float:
        """By how much its length may differ from its inserted length, mm."""
        return find_length_tolerance(self.depth)

    @property
    def reach(self) -> float:
        """The greatest distance of a point from the first of its needle; 0 without points."""
        return float(np.linalg.norm(self.line - self.origin, axis=1).max(initial=0.0))

    def read_tip(self, n: int) -> TipReading:
        """Return a point as the reading of a tip."""
        sd = None if self.points.sd is None else float(self.points.sd[n])
        if "point_sd" in self.stated:
            sd = self.stated["point_sd"].to_number(is_above=True)
        return TipReading(self.line[n, 1:], sd, self.points.where(n))

    def read_curvature(self) -> Floats | None:
        """Return `sensors` (n, 4), from the tip, with curvatures toward the bevel and across."""
        if not self.sensors:
            return None
        read = np.array(self.sensors)
        turned = Rotation.from_rotvec([-self.turn, 0.0, 0.0]).apply(read[:, :3])
        if self.are_sensors_from_base:
            turned[:, 0] = self.needle.length_mm - turned[:, 0]
        return np.column_stack([turned, read[:, 3]])

    @property
    def depth(self) -> float:
        """The inserted length, mm: of the last reading, as stated, or from the entry."""
        if len(self.depths):
            return float(self.depths[-1])
        return self.stated["depth"].to_number() if "depth" in self.stated else self.before + self.length


StatedValues = dict[ImportedCurve, Stated]  # of each needle
Numbers = dict[ImportedCurve, float]


def snap_to_axis(direction: Floats) -> Floats:
    """Return a unit direction, or the world axis that is near."""
    axis, nearest = np.zeros(3), int(np.argmax(np.abs(direction)))
    axis[nearest] = np.sign(direction[nearest])
    return axis if axis @ direction >= np.cos(np.radians(SAME_AXIS_DEG)) else direction


def format_direction(direction: Floats) -> str:
    """Return a direction as options state it."""
    return ",".join(f"{value:z.3g}" for value in direction.round(3))


def list_names(curves: Iterable[ImportedCurve]) -> str:
    """Return the names of curves, in a sentence; empty of none."""
    return join_names([curve.name for curve in curves], 5)


class BendsOfSides:
    """How far bevels of side 1 would have bent across their directions, mm: `toward` (N, 3).

    `bends` (N, 3): of curves, from the directions `along` (N, 3), mm.
    """

    def __init__(self, curves: Sequence[ImportedCurve], bends: Floats, along: Floats) -> None:
        turns = np.array([curve.turn for curve in curves])
        self.turned = Rotation.from_rotvec(turns[:, None] * along)
        across = bends - np.sum(bends * along, axis=1)[:, None] * along
        sides = np.array([curve.side for curve in curves])
        self.toward: Floats = sides[:, None] * self.turned.inv().apply(across)
        self.sizes = np.linalg.norm(self.toward, axis=1)
        self.units = self.toward / np.maximum(self.sizes, SAME_POINT_MM)[:, None]
        self.direction = to_unit(along.sum(axis=0))
        self.mean = to_unit(self.toward.sum(axis=0))  # of straight needles it is 0

    @property
    def agree(self) -> bool:
        """Whether they have one direction."""
        return bool(np.linalg.norm(self.units.sum(axis=0)) > MIN_SAME_SIDE * len(self.units))


class CurveAnswers:
    """Some curves of an import, and what holds of each; the `others` of the import stand beside them.

    `surfaces` part the layers of all.
    """

    def __init__(
        self,
        curves: list[ImportedCurve],
        settler: Settler,
        surfaces: list[Surface],
        others: Sequence[ImportedCurve] = (),
    ) -> None:
        self.curves, self.others, self.surfaces = curves, others, surfaces
        self.settler, self.assumed = settler, settler.assumed
        self.settle, self.note = settler.settle, settler.note

    def each(
        self, key: str, usual: str | None = None, reason: str = "", is_sure: bool = False
    ) -> StatedValues:
        """Return what holds of each needle: its own cell, else the value of all.

        A value that is stated beside cells of all needles of the import takes their place. DataError if
        nothing states it of some needles.
        """
        cells = {curve: curve.stated[key] for curve in self.curves if key in curve.stated}
        missing = [curve for curve in self.curves if curve not in cells]
        is_stated = key in self.settler.values and not self.settler.is_partly_stated(key)
        if not cells or (is_stated and not missing):
            return dict.fromkeys(self.curves, self.settle(key, usual, reason, is_sure=is_sure))
        if not missing:
            return cells
        reason = f"stated of {list_names(cells)}, not of {list_names(missing)}"
        fix = f"fill in their cells, or state {name_set(key)} of all that are blank"
        rest = self.settle(key, "", reason, fix=fix, where=next(iter(cells.values())).where)
        return {curve: cells.get(curve, rest) for curve in self.curves}

    def numbers(
        self, key: str, is_above: bool = False, usual: str | None = None, reason: str = ""
    ) -> Numbers:
        """Return the number of each needle, in the unit of the key."""
        answers = self.each(key, usual, reason)
        return {curve: answer.to_number(is_above) for curve, answer in answers.items()}

    @property
    def point_sd_mm(self) -> float:
        """The least standard deviation of a point, mm, once they are settled."""
        return min(curve.point_sd for curve in self.curves)

    def stated(self, key: str) -> str:
        """Return what the mapping, or the same cell of every needle, states of all; empty if nothing."""
        self.settler.used.add(key)
        shared = self.settler.find_shared(key)
        return shared.text if shared else self.settler.values.get(key, "")

    def is_stated(self, key: str) -> bool:
        """Return whether the mapping or the cells of a needle state a key."""
        return key in self.settler.values or any(key in curve.stated for curve in self.curves)

    def settle_sides(self, is_needed: bool = False) -> Numbers:
        """Return the direction that each bevel faces, degrees about the needle; none if nobody states any.

        Bevels that differ by half turns are of sides 1 and -1, all turned alike; others are of side 1.
        DataError if a cell is not understood. `is_needed`: what nobody states is assumed.
        """
        if not (is_needed or self.is_stated("bevel_side")):
            return {}
        answers = self.each("bevel_side", "1", "not stated")
        angles = {curve: answer.to_angle() for curve, answer in answers.items()}
        period = 180.0 if len({angle % 180.0 for angle in angles.values()}) == 1 else 360.0
        for curve, angle in angles.items():
            curve.turn = float(np.radians(angle % period))
            curve.side = 1 if angle % 360.0 < period else -1
        return angles


class Placer(CurveAnswers):
    """Places the needles of one kind."""

    #: usual answers, with their reasons, of keys that are usual otherwise without such needles
    usual: Mapping[str, tuple[str | None, str]] = MappingProxyType({})
    pose: Pose = "known"
    #: of the direction of each run in the frame of a tracker, and of what all share; None: not known
    slope_sds_deg: tuple[float, float | None] = (0.0, None)

    def settle_places(self) -> None:
        """Settle entries and inserted lengths; `curves` may become others."""
        raise NotImplementedError

    def fill_rows(self) -> None:
        """Fill in poses and what was measured beside points, where the rows have it."""

    def choose_study(self) -> Mapping[str, float | str]:
        """Return keys of a first study."""
        return {}

    def meet_layers(self, runs: Numbers | None = None) -> None:
        """Fill in the numbers of layers that needles meet, by the depths of boundaries.

        `runs`, mm: how far they go along their directions; without them their inserted lengths.
        """
        is_layered = bool(self.surfaces) or any(curve.boundaries for curve in self.curves)
        sds = self.numbers("boundary_sd") if is_layered else {}
        for curve in self.curves:
            reach = runs[curve] if runs else curve.depth
            _, layers = select_layers(np.array(curve.boundaries), reach)
            curve.fill(layers=len(layers), boundary_sd=sds.get(curve, 0.0))

    def settle_shifts(self) -> Numbers:
        """Settle the standard deviations of entries per axis, mm: usually that of a point."""
        return self.numbers("pose_shift_sd", usual=f"{self.point_sd_mm:g}", reason="that of a point")

    def note_deflections(self, zero: str = "from the line of insertion") -> None:
        """Note which deflections are positive, and from where they count, unless it is assumed."""
        if "deflection" not in self.assumed and any(curve.is_deflection for curve in self.curves):
            self.note("deflection", f"positive where a bevel of side 1 bends; {zero}")


# ---- kinds


@dataclass(frozen=True)
class RowKind:
    """One kind of rows."""

    name: Holds
    #: table, whether a person states the kind -> columns by needle, "" of all; none of other kinds
    propose: Callable[[TableDraft, bool], dict[str, Columns]]
    rank: int  #: the greatest is looked for first
    #: meanings of needles that each row may state anew
    varying: Sequence[str] = ("depth", "point_sd")
    has_points: bool = False  #: rows are places, in the unit of coordinates
    has_shape: bool = False  #: each needle has a centreline
    is_track: bool = False  #: needles were measured on their way, in the frame of a tracker
    is_of_each: bool = False  #: each needle needs a row
    #: each depth of a needle is an insertion of its own, and rows without a name are needles
    has_stops: bool = False
    placer: type[Placer] | None = None  #: places its needles; None: rows alone make no needle
    #: table, needle, its rows: adds to the needle what they state beside points
    read: Callable[[MappedTable, ImportedCurve, Sequence[int]], None] = lambda mapped, curve, rows: None
    #: table, columns of a needle: completes them, or asks
    complete: Callable[[TableDraft, Records], None] = lambda draft, records: None


KINDS = Registry(RowKind, __name__, "kind of rows")


def list_kinds() -> list[RowKind]:
    """Return all kinds, in the order in which they are looked for."""
    return sorted(KINDS.values(), key=lambda kind: -kind.rank)
