"""What the files of an import hold: curves of needles or places of tips, and what is stated of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.importing.answers import Stated
from needlefit.datasets.importing.questions import QUESTIONS
from needlefit.datasets.importing.synonyms import list_meanings
from needlefit.datasets.importing.tables import CellTable, UnclearTableError
from needlefit.datasets.points import Points
from needlefit.errors import ConfigError
from needlefit.geometry.frames import PatientSystem
from needlefit.geometry.surfaces import Surface

# What files may state of one needle: its depth, and answers that it may have of its own.
ATTRIBUTES = ("depth", *(what for what, one in QUESTIONS.items() if one.is_own))


@dataclass(frozen=True)
class Readings:
    """What the rows of a tip's track state beside its places."""

    depth: Floats  # (N,), in the unit of its column; empty: no column of depths changes from row to row
    unit: str  # of the depths, as the file states it
    is_log: bool  # time or direction of the tip stand in each row, too
    is_deflection: bool  # the points are (depth, deflection, 0)


@dataclass
class ImportedCurve:
    """One curve of a file, or the places of a tip in one run; a plan brings it into mm, and cuts it."""

    name: str  # as the file calls it; empty where it has no name
    points: Points
    unit: str = ""  # as the file states it; empty where it does not
    # LPS once points were converted to it, as those of markups are; None where the file states no system.
    system: PatientSystem | None = None
    stated: dict[str, Stated] = field(default_factory=dict)  # of `ATTRIBUTES`, once for the curve
    axes: str = "x, y, z"  # its coordinates
    readings: Readings | None = None
    guide: Floats | None = None  # (N, 3); places of the guide at the readings
    # Places (N, 3) of what may be the guide, by its name in the file, in the unit of the coordinates.
    guides: dict[str, Floats] = field(default_factory=dict)
    is_named: bool = True  # the file names it; else it has the name of the file
    hole: str = ""  # the name that depths of one hole have together
    shaft: Floats = field(default_factory=lambda: np.empty((0, 3)))  # (K, 3); points up to the entry
    turns: list[tuple[float, Stated]] = field(default_factory=list)  # depths, mm, and where bevels face then
    sensors: list[Floats] = field(default_factory=list)  # (4,) each: `SENSOR` in mm and 1/mm
    are_sensors_from_base: bool = False  # places of sensors are counted from the needle's base, not its tip

    def scale(self, factor: float) -> None:
        """Bring the coordinates into another unit."""
        self.points = self.points.scale(factor)
        self.guides = {name: factor * places for name, places in self.guides.items()}

    @property
    def line(self) -> Floats:
        """The points (N, 3)."""
        return self.points.values

    @property
    def length(self) -> float:
        """The length of the curve smoothed to its noise."""
        return self.points.curve.length

    @property
    def reach(self) -> float:
        """The greatest distance of a point from the first one, about the length: of unsorted points, too.

        Of deflections it is that from the entry; 0 without points.
        """
        if not len(self.line):
            return 0.0
        start = 0.0 if self.is_tip else self.line[0]
        return float(np.linalg.norm(self.line - start, axis=1).max())

    @property
    def is_tip(self) -> bool:
        """Whether its points are depths and deflections."""
        return self.readings is not None and self.readings.is_deflection

    @property
    def track(self) -> Readings:
        """Its readings, which every track has."""
        assert self.readings is not None
        return self.readings

    @property
    def depth(self) -> float:
        """The inserted length: as it is stated, else that of the curve."""
        return self.stated["depth"].to_number("depth") if "depth" in self.stated else self.length


@dataclass(frozen=True)
class NeedleRow:
    """What a row without coordinates states of a needle: of all of it, of a turn, or of a sensor."""

    needle: str
    where: str  # its place, and that of the row of headers of its table
    head: str
    stated: Mapping[str, Stated] = field(default_factory=dict)
    turns: Sequence[tuple[float, Stated]] = ()
    sensors: Sequence[Floats] = ()
    are_sensors_from_base: bool = False


@dataclass
class ImportContent:
    """What the files of an import hold, as they are read."""

    columns: Mapping[str, str] = field(default_factory=dict)  # meanings that are stated, by header or number
    layout: str = ""  # where a table may be read in two ways: `rows` or `columns` are needles
    columns_found: set[str] = field(default_factory=set)  # those that any table has
    files: list[Path] = field(default_factory=list)
    curves: list[ImportedCurve] = field(default_factory=list)
    # With their files and systems; in LPS where it is known. Kind and layer are not decided yet.
    surfaces: list[tuple[Surface, Path, PatientSystem | None]] = field(default_factory=list)
    needles: list[NeedleRow] = field(default_factory=list)  # of tables without coordinates
    setup: dict[str, Stated] = field(default_factory=dict)  # answers by the names of questions
    unused: list[tuple[str, str]] = field(default_factory=list)  # what is not used; where it stands, or why
    # Why some of it was probably meant to be used, and what to do.
    doubts: dict[tuple[str, str], str] = field(default_factory=dict)
    renamed: dict[str, str] = field(default_factory=dict)  # names of rows whose curve has another spelling
    # Columns of numbers under headers that no language knows, and where they stand.
    unknown: list[tuple[str, str]] = field(default_factory=list)
    unclear: list[UnclearTableError] = field(default_factory=list)  # of tables that were left out
    left_out: dict[tuple[str, str], CellTable] = field(default_factory=dict)  # those tables, as of `unused`

    def leave_out(self, what: str, where: str, doubt: str) -> None:
        """Note what is not used although it was probably meant to be."""
        self.unused.append((what, where))
        self.doubts[what, where] = doubt


def parse_columns(text: str) -> dict[str, str]:
    """Return the meanings that `--columns` states, by header or number.

    ConfigError if it is not understood.
    """
    parts = [part.strip() for part in text.split(",")] if text.strip() else []
    pairs = [part.partition("=")[::2] for part in parts if "=" in part] or zip("xyz", parts, strict=False)
    stated = {name.strip(): meaning.strip() for meaning, name in pairs}
    known, once = ("x", "y", "z", *list_meanings()), [one for one in stated.values() if one != "unrelated"]
    if len(stated) < len(parts) or not {*once} <= {*known} or not all(stated) or len({*once}) < len(once):
        raise ConfigError.of(f"""--columns is {text[:60]!r}
            expected: headers or numbers of {", ".join(known)}
            fix: write X,Y,Z or MEANING=HEADER, with commas between them""")
    return stated
