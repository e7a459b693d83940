"""Types of measured data: an insertion, the dataset, its stated measurement errors."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from needlefit.arrays import Floats, pad_axis
from needlefit.datasets.columns import DEFAULT_ROLL_SD_DEG, STATED_POSE_SOURCES, PoseSource
from needlefit.datasets.sources import DatasetFiles
from needlefit.errors import DataError
from needlefit.geometry.curves import select_compared
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.geometry.measured_curve import MeasuredCurve, measure_curve
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.geometry.surfaces import Surface
from needlefit.mechanics.needle import Needle
from needlefit.project.result_warnings import ResultWarning
from needlefit.schemas.base import DIRECTIONS, Compared
from needlefit.schemas.dataset import SESSION_SLOPE_SD_DEG, MeasurementRecord
from needlefit.schemas.origin import Origin

if TYPE_CHECKING:
    import pandas as pd

Pose = Literal["known", "free"]
# What is known of the pose of one insertion: that of its dataset, the direction alone, or of a tip track what
# a shift and a slope of the tracker's frame leave.
InsertionPose = Literal["known", "direction", "free", "tracker"]

DEFAULT_MEASUREMENT = MeasurementRecord()


@dataclass(frozen=True)
class Noise:
    """The measurement errors that a dataset states, mm."""

    registration_mean: float = 0.0  # mean 3-D error that registration alone leaves at the needle
    point_sd: float = 0.0  # standard deviation of independent noise of a centreline point, per axis
    # `correlated_sd`, `correlation_length`: standard deviation per axis and length along the needle of the
    # correlated part
    correlated_sd: float = 0.0
    correlation_length: float = 5.0
    # `heading_sd`, `slope_sd`, `session_slope_sd`: of tip tracks, rad: standard deviation of a heading, 0
    # where headings are not used; of a run's slope in the tracker's frame about that of its session, 0 where
    # every run has its own; and of the slope of a session, which its runs share
    heading_sd: float = 0.0
    slope_sd: float = 0.0
    session_slope_sd: float = math.radians(SESSION_SLOPE_SD_DEG)

    @property
    def whole_slope_sd(self) -> float:
        """Standard deviation of a run's slope in the tracker's frame, with that of its session, rad."""
        return math.hypot(self.slope_sd, self.session_slope_sd)

    def correlate(self, s: Floats) -> Floats:
        """Return the correlation (K, K) of the correlated part at arc lengths `s` (K,), mm."""
        return np.exp(-np.abs(s[:, None] - s) / self.correlation_length)

    def of(self, insertion: "Insertion") -> "Noise":
        """Return the noise of an insertion, whose points may err by more or less than others."""
        return self if insertion.point_sd is None else replace(self, point_sd=insertion.point_sd)

    @property
    def stated(self) -> bool:
        """Whether an error is stated for the points of a centreline."""
        return self.point_sd > 0 or self.correlated_sd > 0


GUIDE_STILL_MM = 0.05  # movement (mm) of a guide below which it counts as fixed: stages jitter


@dataclass(frozen=True, eq=False)
class GuideMotion:
    """Where a clamping guide stood across the insertion axis on the way to each of n depths, mm."""

    depths: Floats  # (n,); inserted lengths, from 0
    # `y`, `z`: (n,); from where it stood at the first
    y: Floats
    z: Floats

    @property
    def moved(self) -> bool:
        """Whether it moved."""
        return bool(np.ptp(self.y) > GUIDE_STILL_MM or self.moved_along_z)

    @property
    def moved_along_z(self) -> bool:
        """Whether it moved along z."""
        return bool(np.ptp(self.z) > GUIDE_STILL_MM)

    def flatten(self) -> Self:
        """Return the motion along y alone."""
        return replace(self, z=np.zeros(len(self.z)))


@dataclass(frozen=True, eq=False, kw_only=True)
class InsertionInputs:
    """What the simulation of an insertion needs of it; see `Insertion`."""

    needle: Needle
    depth: float
    side: int
    boundaries: Floats
    sequence: tuple[int, ...]
    guide_distance: float | None = None
    base_moved: float = 0.0
    bevel_factor: float = 1.0
    turns: tuple[tuple[float, float], ...] = ()
    guide: GuideMotion | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Insertion(InsertionInputs):
    """One insertion: what was done, and what was measured of it, in a frame C at its bending plane.

    Attributes
    ----------
    id, medium, specimen : str
        `specimen` groups repeats in one piece; folds never split it.
    needle : Needle
        The needle that was inserted.
    layers, layers_alternative : int
        Layers traversed as listed, and the other reading where it ends at a boundary (else the same).
    depth : float
        Inserted arc length, mm.
    side : int
        The side of C's x axis that the bevel faces, +1 or -1.
    frame : Frame
        C in the world: origin at the tip's first contact, x along the entry, y in the bending plane.
    bevel : (3,) array or None
        Direction in the world that a bevel of side 1, or a roll of 0, faces, where it is stated.
    pose_source : str
        "stage", "shaft", "fitted", "first_point", "tracker" or "none".
    pose_shift_sd, pose_angle_sd : float
        Standard deviation of the entry pose in the plane, mm and rad.
    centerline : (N, 3) array
        World points from entry to tip, mm.
    points : (N, 3) array
        The same points in C, mm: z is their distance from the bending plane.
    boundaries : (n - 1,) array
        Measured depths of the layer interfaces crossed, along C's x axis, mm.
    sequence : tuple of int
        Layer number (from 1) met in each of the n intervals between boundaries.
    boundary_sd : float
        Standard deviation of the boundaries, mm.
    boundary_shared_sd : float or None
        The part of it that all insertions into the specimen share, mm; None where none is stated.
    depth_sd : float
        Standard deviation of `depth`, mm; 0 where none is stated.
    guide_distance : float or None
        Distance from a clamping guide to the entry, mm, where it is known.
    sd : (N,) array or None
        Standard deviation of each point in any one direction across the needle, mm, where it is known.
    point_sd : float or None
        Standard deviation of the independent noise of its points, per axis, mm; None: that of the dataset.
    independent : int or None
        Number of points with errors of their own, where the others were interpolated; None: all.
    surfaces : tuple of Surface
        Every boundary of its medium as it lay at this insertion, world; empty where depths are given.
    patient : Frame
        The patient coordinates (LPS) of its scan in the world.
    base_moved : float
        How far the base was moved across, toward +y of C, after the insertion and before the measurement, mm.
    sections : SplineSections or None
        The cross-sections through which a smoothing spline was drawn, world, arc lengths from first contact;
        where they are known, they are the measurement, and `centerline` is that spline.
    hole : str
        Name of its hole, unique within the specimen; insertions of one hole are one, measured at several
        depths. Empty where the table does not state it.
    bevel_factor : float
        What the needle's bevel offset is multiplied by in this insertion; 1 as measured.
    roll_sd : float
        Standard deviation of the bevel's roll about x, rad.
    turns : tuple of (float, float)
        Depth, mm, from which on the bevel has a roll, degrees, counted from that at first contact.
    curvature : (n, 4) array or None
        Of each sensor its distance from the tip, mm, the curvatures along y and z of C, and their standard
        deviation, 1/mm.
    guide : GuideMotion or None
        How a guide was moved on the way; None of one that was not.
    tip : (3,) array or None
        Beside a shape: the tip's deflection along y and z of C, NaN where not measured, and its standard
        deviation, NaN: that of a point; mm.
    observation : str
        Name of the observation (`inference/likelihood/observations/`) that compares `points` with the
        simulation: "points", "tip_track", or one of a plugin.
    observation_values : mapping of str to float
        What the observation of a plugin has besides `points`: the numbers of the columns `observation_NAME`.
    own_errors : bool
        Whether each reading of its observation states its own error.
    directions : int
        2 where the z of `points` was measured, 1 where they are known along y alone.
    headings : tuple of (N,) arrays
        Directions of the tip, rad, along y, and z, as a tracker reports them; empty where it does not.
    setup : str
        Name of the guide and of how the specimen was held, of a tip track; one for all where it is empty.
    digest : callable
        Returns the SHA-256 of what was read of it and decides a fit (`digests`); empty of one made in memory.
    where : str
        File and line of its row; empty of one that was made in memory.
    curve_roll : float
        Roll about x of the plane in which curves without mechanics bend, rad; 0 of one compared in its plane.
    """

    id: str
    medium: str
    specimen: str
    layers: int
    layers_alternative: int
    frame: Frame
    pose_source: PoseSource
    pose_shift_sd: float
    pose_angle_sd: float
    centerline: Floats
    points: Floats
    boundary_sd: float
    bevel: Floats | None = None
    sd: Floats | None = None
    point_sd: float | None = None
    independent: int | None = None
    surfaces: tuple[Surface, ...] = ()
    patient: Frame = IDENTITY_FRAME
    depth_sd: float = 0.0
    sections: SplineSections | None = None
    boundary_shared_sd: float | None = None
    hole: str = ""
    roll_sd: float = math.radians(DEFAULT_ROLL_SD_DEG)
    curvature: Floats | None = None
    tip: Floats | None = None
    observation: str = "points"
    observation_values: Mapping[str, float] = field(default_factory=dict)
    own_errors: bool = False
    directions: int = 2
    headings: tuple[Floats, ...] = ()
    setup: str = ""
    digest: Callable[[], str] = str
    where: str = ""
    curve_roll: float = 0.0
    #: smooth curves, with the points that they were drawn through; copies of the insertion share them
    curves: dict[Compared, tuple[Floats, MeasuredCurve]] = field(default_factory=dict, repr=False)

    @property
    def states_errors(self) -> bool:
        """Whether the errors of what was measured stand with it, whatever noise its dataset states."""
        return self.sd is not None or self.point_sd is not None or self.own_errors

    @property
    def observations(self) -> tuple[str, ...]:
        """Names of all by which it was measured, first that of its points or of what replaces them."""
        beside = {"curvature": self.curvature, "tip": self.tip}
        names = [name for name, values in beside.items() if values is not None]
        return tuple(dict.fromkeys((self.observation, *names)))

    @property
    def is_posed(self) -> bool:
        """Whether its entry pose is known, or its direction alone."""
        return self.pose_source in STATED_POSE_SOURCES

    @property
    def in_tracker_frame(self) -> bool:
        """Whether its places are known in the frame of a tracker alone: they have no place in a scan."""
        return self.pose_source == "tracker"

    @property
    def guided(self) -> bool:
        """Whether a guide moved during the insertion."""
        return self.guide is not None and self.guide.moved

    def with_points(self, points: Floats) -> Self:
        """Return the insertion as if its measured points were `points` in C: (N, 3), or (N, 2) at z = 0."""
        points = pad_axis(points, 3)
        centerline = self.frame.to_world(points)
        return replace(self, points=points, centerline=centerline, sections=None, curves={})

    def map_points(self, change: Callable[[Floats], Floats]) -> Self:
        """Return the insertion as if its points and sections (N, 3) in C lay where `change` puts them."""
        moved = self.with_points(change(self.points))
        if self.sections is None:
            return moved
        sections = self.frame.to_world(change(self.frame.to_local(self.sections.points)))
        return replace(moved, sections=replace(self.sections, points=sections))

    def measure_arc(self, compared: Compared) -> Floats:
        """Return the arc lengths (N,) of the measured points, mm: of the curve in its plane, or in space."""
        return self.smooth(compared).s

    def smooth(self, compared: Compared) -> MeasuredCurve:
        """Return the measured points as a curve smoothed to its noise, in its plane or in space."""
        points, curve = self.curves.get(compared, (None, None))
        if curve is None or points is not self.points:
            curve = measure_curve(select_compared(self.points, compared))
            self.curves[compared] = self.points, curve
        return curve

    @property
    def deflection(self) -> float:
        """Measured deflection of the tip in C, positive toward the bevel as the insertion begins, mm."""
        roll = math.radians(self.turns[0][1]) if self.turns and self.turns[0][0] == 0 else 0.0
        _, y, z = self.points[-1] - self.points[0]
        return float(self.side * (y * math.cos(roll) + z * math.sin(roll)))


@dataclass(frozen=True)
class Dataset:
    """Insertions of one or several needles, measured alike.

    Attributes
    ----------
    origin : str
        "measured", "example" or "synthetic"; data that were not measured are called so wherever they appear.
    media : tuple of str
        Names of the media described; every insertion went into one of them.
    pose : str
        Of shapes: "known"; "free" where they are known only up to a rigid motion. See `find_pose`.
    drop_proximal : float
        Proximal length left out of comparisons of free shapes, mm.
    digest : str
        SHA-256 over all files read, in the order of their names.
    notes : tuple of str
        What its makers want known of data, needle and noise; reports print it.
    warnings : tuple of ResultWarning
        What is suspicious in it, though it can be fitted.
    remarks : tuple of str
        What was left out of it, and why.
    centerline_format : str
        Name of the file format of its centrelines; empty where they stand in a table.
    measurement : MeasurementRecord
        What the measurement does to a shape before its points are stored.
    compared : Compared
        Whether needles are simulated and compared in their planes, or in space.
    files : DatasetFiles or None
        What it was read from; None where it was made in memory.
    rigidities : mapping of str to str
        From which stated values the flexural rigidity of each needle follows, by its name.
    """

    name: str
    title: str
    origin: Origin
    insertions: tuple[Insertion, ...] = field(repr=False)
    media: tuple[str, ...]
    noise: Noise
    pose: Pose
    drop_proximal: float
    path: Path
    digest: str
    notes: tuple[str, ...] = field(default=(), repr=False)
    warnings: tuple[ResultWarning, ...] = field(default=(), repr=False)
    remarks: tuple[str, ...] = field(default=(), repr=False)

    @property
    def noise_is_stated(self) -> bool:
        """Whether an error is stated for every measurement."""
        return self.noise.stated or all(one.states_errors for one in self.insertions)

    @property
    def directions(self) -> int:
        """How many deflections of a point are compared, along y, and z."""
        return DIRECTIONS[self.compared]

    @property
    def needles(self) -> dict[str, Needle]:
        """The needles that were inserted, by their names."""
        return {one.needle.name: one.needle for one in self.insertions}

    def to_frame(self) -> "pd.DataFrame":
        """Return one row per insertion: what it went into, its depth and measured tip deflection (mm)."""
        import pandas as pd  # late: simulations need none

        rows = [
            {
                "insertion": one.id,
                "medium": one.medium,
                "specimen": one.specimen,
                "needle": one.needle.name,
                "layers": one.layers,
                "layers_alternative": one.layers_alternative,
                "depth_mm": one.depth,
                "bevel_side": one.side,
                "deflection_mm": one.deflection,
                "observation": one.observation,
                "points": len(one.points),
                "pose_source": one.pose_source,
            }
            for one in self.insertions
        ]
        return pd.DataFrame(rows)

    centerline_format: str = ""
    measurement: MeasurementRecord = DEFAULT_MEASUREMENT
    compared: Compared = "plane"
    files: DatasetFiles | None = field(default=None, repr=False, compare=False)
    rigidities: Mapping[str, str] = field(default_factory=dict, repr=False)


# SD (mm) of a surface that all insertions into a specimen share, where none is stated; not more than the
# whole SD of a boundary
SHARED_BOUNDARY_SD_MM = 0.1
MIN_OWN_BOUNDARY_SD_MM = 0.02  # smallest SD (mm) of a boundary in one insertion alone


def split_boundary_sd(insertion: Insertion) -> tuple[float, float]:
    """Return the deviations of a boundary that insertions into the specimen share, and of its own, mm.

    Both are 0 where `boundary_sd` is.
    """
    whole, stated = insertion.boundary_sd, insertion.boundary_shared_sd
    if whole == 0:
        return 0.0, 0.0
    shared = min(whole, SHARED_BOUNDARY_SD_MM if stated is None else stated)
    return shared, math.sqrt(max(whole**2 - shared**2, MIN_OWN_BOUNDARY_SD_MM**2))


def find_pose(pose: Pose, insertion: Insertion) -> InsertionPose:
    """Return what is known of the pose of an insertion of a dataset whose shapes have this `pose`.

    The first point of the inserted needle lies beside the entry by as much as the needle has moved there: of
    an entry that is this point the direction alone is known.
    """
    if insertion.in_tracker_frame:
        return "tracker"
    return "direction" if pose == "known" and insertion.pose_source == "first_point" else pose


MAX_CENTERLINE_POINTS = 200  # number of points to which a centreline with more is thinned, about


def select_compared_places(
    pose: Pose, drop: float, insertion: Insertion, compared: Compared = "plane"
) -> tuple[Floats, Floats]:
    """Return arc lengths along the centreline (K,) and beam coordinates (K,), mm, of the points compared."""
    along = insertion.measure_arc(compared)
    if pose == "known":
        at = along * (insertion.depth / along[-1])
    else:
        to_tip = along[-1] - along
        kept = to_tip <= find_free_reach(drop, insertion)
        along, at = along[kept], insertion.depth - to_tip[kept]
    step = max(1, math.ceil(len(at) / MAX_CENTERLINE_POINTS))
    chosen = np.arange(len(at) - 1, -1, -step)[::-1]  # keeps the tip
    return along[chosen], at[chosen]


def find_free_reach(drop: float, insertion: Insertion) -> float:
    """Return the distance from the tip at which the comparison of free shapes begins, mm.

    DataError if nothing is left to compare.
    """
    reach = min(insertion.smooth("plane").length, insertion.depth) - drop
    if reach <= 0:
        raise DataError(
            f"insertion `{insertion.id}` is not longer than the {drop:g} mm that are left out",
            fix="lessen frame.drop_proximal_mm, or leave the insertion out",
        )
    return reach
