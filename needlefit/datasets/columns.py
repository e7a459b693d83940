"""Column names of `insertions.csv` and of a centreline file, and the type of a row."""

import math
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.schemas.names import MAX_NAME_BYTES

# Where an entry pose comes from. "first_point": its direction from stage or shaft, its place from the first
# point of the inserted needle, which has moved with the needle. "none" is of free shapes, "tracker" of tip
# tracks.
PoseSource = Literal["stage", "shaft", "fitted", "first_point", "none", "tracker"]

POINT_COLUMNS = ("x_mm", "y_mm", "z_mm")
SD_COLUMN = "sd_mm"  # column of a centreline with the SD of each point across the needle (mm)
ENTRY_COLUMNS = ("entry_x_mm", "entry_y_mm", "entry_z_mm")
DIRECTION_COLUMNS = ("entry_dx", "entry_dy", "entry_dz")
BEVEL_COLUMNS = ("bevel_x", "bevel_y", "bevel_z")
BEVEL_FIX = f"point {', '.join(BEVEL_COLUMNS)} across the entry direction, or leave the three cells empty"
POSE_COLUMNS = (*ENTRY_COLUMNS, *DIRECTION_COLUMNS, "pose_source", "pose_shift_sd_mm", "pose_angle_sd_deg")

SCAN_ROTATION_COLUMNS = ("scan_rx_deg", "scan_ry_deg", "scan_rz_deg")
SCAN_SHIFT_COLUMNS = ("scan_x_mm", "scan_y_mm", "scan_z_mm")
# From the patient coordinates (LPS) of an insertion's scan to the world: rotation vector and shift.
SCAN_COLUMNS = (*SCAN_ROTATION_COLUMNS, *SCAN_SHIFT_COLUMNS)
# Columns every table of insertions has; with a known pose those of `POSE_COLUMNS` too.
REQUIRED_COLUMNS = ("id", "medium", "layers", "depth_mm")
# The columns of `insertions.csv` in the order in which they are written. `NEEDLE_COLUMN`,
# `BOUNDARIES_COLUMN`, `SHARED_COLUMN`, `HOLE_COLUMN` and `ROLL_COLUMNS` follow where they are stated,
# `BASE_SHIFT_COLUMN` where any base was moved, `SCAN_COLUMNS` where any insertion has its own motion.
INSERTION_COLUMNS = (
    *("id", "medium", "specimen", "layers", "layers_alternative", "depth_mm", "bevel_side"),
    *(*ENTRY_COLUMNS, *DIRECTION_COLUMNS, *BEVEL_COLUMNS),
    *("pose_source", "pose_shift_sd_mm", "pose_angle_sd_deg"),
    *("boundary_sd_mm", "depth_sd_mm", "guide_distance_mm"),
)
NEEDLE_COLUMN = "needle"  # column with the name of the needle
SETUP_COLUMN = "setup"  # column of tip tracks with the name of the set-up
BOUNDARIES_COLUMN = "boundaries_mm"  # column of depths (mm), separated by `;`, or `NO_BOUNDARY`
NO_BOUNDARY = "none"  # text in place of depths where there is no boundary
# column of the SD of a boundary (mm) that all insertions into a specimen share
SHARED_COLUMN = "boundary_shared_sd_mm"
HOLE_COLUMN = "hole"  # column with the name of the hole
BASE_SHIFT_COLUMN = "base_moved_mm"  # column of the distance (mm) by which the base was moved
ROLL_COLUMNS = ("bevel_roll_deg", "bevel_roll_sd_deg")
TURN_COLUMNS = ("id", "depth_mm", "bevel_roll_deg")  # columns of the table of turns during insertions
# columns of the table of curvatures: place of a sensor from the tip, curvature toward +y and +z of C, its SD
CURVATURE_COLUMNS = ("id", "s_mm", "kappa_y_1_per_mm", "kappa_z_1_per_mm", "sd_1_per_mm")
# columns of an insertion whose tip was measured: its deflection along y and z of C, and its SD beside a shape
TIP_COLUMNS = ("tip_y_mm", "tip_z_mm", "tip_sd_mm")
# column of the SD of a point (mm) of insertions whose measurement errs more or less than others
POINT_SD_COLUMN = "point_sd_mm"
# column with the name of an insertion's observation, where its data do not show it
OBSERVATION_COLUMN = "observation"
# beginning of the names of columns of numbers that only the observation of a plugin has
OBSERVATION_PREFIX = "observation_"
MIN_SENSOR_MM = 1.0  # smallest distance of a sensor from tip and base (mm)
DEFAULT_ROLL_SD_DEG = 5.0  # SD of a bevel's roll (degrees) where none is stated

# The columns of texts, which are fields of `InsertionRow`.
TEXT_COLUMNS = ("id", "medium", "specimen", "pose_source", NEEDLE_COLUMN, HOLE_COLUMN, OBSERVATION_COLUMN)
# The columns of single numbers: the field of `InsertionRow`, and the value of an empty cell. NaN: the field
# is None; None: no cell may be empty. Angles are in rad in the field.
NUMBER_COLUMNS: dict[str, tuple[str, float | None]] = {
    "pose_shift_sd_mm": ("pose_shift_sd", 0.0),
    "pose_angle_sd_deg": ("pose_angle_sd", 0.0),
    "boundary_sd_mm": ("boundary_sd", 0.0),
    "depth_sd_mm": ("depth_sd", 0.0),
    "depth_mm": ("depth", None),
    "guide_distance_mm": ("guide_distance", math.nan),
    BASE_SHIFT_COLUMN: ("base_moved", 0.0),
    SHARED_COLUMN: ("boundary_shared_sd", math.nan),
    TIP_COLUMNS[0]: ("tip_y", math.nan),
    TIP_COLUMNS[1]: ("tip_z", math.nan),
    TIP_COLUMNS[2]: ("tip_sd", math.nan),
    POINT_SD_COLUMN: ("point_sd", math.nan),
    ROLL_COLUMNS[0]: ("roll", math.nan),
    ROLL_COLUMNS[1]: ("roll_sd", DEFAULT_ROLL_SD_DEG),
}
STATED_POSE_SOURCES: tuple[PoseSource, ...] = get_args(PoseSource)[:-2]

MAX_ID_CHARS = 100  # largest number of characters of an id
EXPECTED_ID = f"at most {MAX_ID_CHARS} letters of any script, digits, `.`, `_`, `-`, a letter or digit first"
_ID_CATEGORIES = "LMN"  # categories of Unicode: letters, marks that are part of them, digits


def describe_column(theirs: Mapping[str, str], column: str) -> str:
    """Return a column's name for a message: the file's own, followed by ours where the two differ."""
    name = theirs.get(column, column)
    return name if name == column else f"{name} ({column})"


def make_id(text: str, default: str) -> str:
    """Return `text` reduced to the characters of an id; `default` if none is left.

    It is the same id however its file system composes letters and accents.
    """
    letters = unicodedata.normalize("NFC", text)
    kept = "".join(
        letter if letter in "._-" or unicodedata.category(letter)[0] in _ID_CATEGORIES else " "
        for letter in letters
    )
    start = next((n for n, letter in enumerate(kept) if letter.isalnum()), len(kept))
    return re.sub(" +", "_", kept[start:]) or default


def is_id(text: str) -> bool:
    """Whether a text can name an insertion and its files."""
    is_short = len(text) <= MAX_ID_CHARS and len(text.encode("utf-8")) <= MAX_NAME_BYTES
    return is_short and bool(text) and text == make_id(text, "")


@dataclass(frozen=True)
class InsertionRow:
    """One row of `insertions.csv` in internal units (mm, rad); None stands for an empty cell."""

    id: str
    medium: str
    layers: int
    depth: float
    specimen: str = ""
    layers_alternative: int | None = None
    side: int = 1  # the side of C's x axis that the bevel faces, +1 (toward +y) or -1
    # `entry`, `direction`: (3,); tip at first contact (mm) and unit direction of insertion, in the world;
    # None for free shapes
    entry: Floats | None = None
    direction: Floats | None = None
    # (3,); world direction toward which C's +y points; None: the plane and side to which the shape bends.
    bevel: Floats | None = None
    pose_source: PoseSource = "none"
    pose_shift_sd: float = 0.0
    pose_angle_sd: float = 0.0
    needle: str = ""  # the name of a table `[needles.NAME]`; "": that of `[needle]`
    # depths of its own boundaries along C's x, mm, or () for none; None: those of its medium
    boundaries: tuple[float, ...] | None = None
    boundary_sd: float = 0.0
    boundary_shared_sd: float | None = None
    depth_sd: float = 0.0
    guide_distance: float | None = None
    # The patient coordinates (LPS) of its scan in the world; None: that of `[frame] lps_to_world`.
    patient: Frame | None = None
    base_moved: float = 0.0
    hole: str = ""  # the same in rows of one specimen: one insertion, measured at several depths
    line: int = 0  # line of the file that it comes from, 0 if from none
    # in place of a side: roll of the bevel at first contact, right-handed about x, rad; 0 toward +y
    roll: float | None = None
    roll_sd: float = math.radians(DEFAULT_ROLL_SD_DEG)
    # turns during the insertion: depth (mm) from which on the bevel has a roll (rad)
    turns: tuple[tuple[float, float], ...] = ()
    # deflection of the tip along y and z of C, mm, measured alone or beside a shape
    tip_y: float | None = None
    tip_z: float | None = None
    # standard deviation of a tip beside a shape, mm; None: that of a point
    tip_sd: float | None = None
    # standard deviation of a point per axis, mm; None: that of the dataset
    point_sd: float | None = None
    observation: str = ""  # the name of an observation; "": that of the data that are there
    # the numbers of the columns `observation_NAME`, by NAME; an empty cell has none
    observation_values: Mapping[str, float] = field(default_factory=dict)
    # (n, 4); of each sensor the numbers of `CURVATURE_COLUMNS`
    curvature: Floats | None = None
