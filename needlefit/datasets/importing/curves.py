"""What an import has read of each needle: its points, and what is stated of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from needlefit.arrays import Floats
from needlefit.datasets.columns import InsertionRow
from needlefit.datasets.importing.mapped_table import MappedTable
from needlefit.datasets.importing.stated import Stated
from needlefit.datasets.layers import find_length_tolerance
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.geometry.surfaces import Surface
from needlefit.schemas.mapping import Holds
from needlefit.schemas.scene import NeedleRecord


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
    holds: Holds
    stated: dict[str, Stated] = field(default_factory=dict)  # of `ATTRIBUTES`
    depths: Floats = field(default_factory=lambda: np.empty(0))  # (N,), mm; of readings, empty: not stated
    depth_column: str = ""  # the header of the depths of readings
    is_deflection: bool = False  # the points are (depth, deflection up, to the right)
    rolls: Floats = field(default_factory=lambda: np.empty(0))  # (N,), of readings; where the bevel faces
    is_timed: bool = False  # times stand where depths of readings will, which another table states
    guide: Floats | None = None  # (N, 3), mm; places of the guide at the readings
    is_named: bool = True  # a cell names it; else it has the name of its file or sheet
    given: str = ""  # its name in the file, which several curves may have
    hole: str = ""  # the name that depths of one hole have together
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
        """The greatest distance of a point from the first one, about the length; 0 without points."""
        if not len(self.line):
            return 0.0
        start = 0.0 if self.is_deflection or len(self.line) == 1 else self.line[0]
        return float(np.linalg.norm(self.line - start, axis=1).max())

    def read_tip(self, n: int) -> TipReading:
        """Return a point as the reading of a tip."""
        sd = None if self.points.sd is None else float(self.points.sd[n])
        if "point_sd" in self.stated:
            sd = self.stated["point_sd"].to_number("point_sd", is_above=True)
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
        return (
            self.stated["depth"].to_number("depth") if "depth" in self.stated else self.before + self.length
        )


@dataclass(frozen=True)
class ImportContent:
    """What the files of an import hold, as the mapping reads them."""

    curves: list[ImportedCurve]
    surfaces: list[Surface]  # between the layers, in their order
    files: Mapping[str, str]  # SHA-256 of each file, by name
    left_out: Sequence[str]  # points without a measured coordinate, counted for each table
    tables: Sequence[MappedTable]  # as they were read
