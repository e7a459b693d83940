"""The result of reconstructing one scan."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length, interpolate_at_arc
from needlefit.geometry.frames import IDENTITY_FRAME, Frame, make_entry_frame
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.needle.axis_spline import PLANE_SPACING_MM
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.needle.segmentation import principal_axes
from needlefit.imaging.point_spread import PointSpread
from needlefit.imaging.registration import Registration, predict_mean_target_error
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import Volume, VoxelGrid, sample


@dataclass(frozen=True)
class MarkerResult:
    """The markers found in the scan."""

    centers: Floats  # (M, 3); LPS, mm
    sd: Floats  # (M,); deviation in any one direction, mm
    source: Literal["volume", "fiducials"]  # "volume", or "fiducials": placed by hand
    spread: PointSpread | None = None  # the scanner's, as the balls show it


@dataclass(frozen=True)
class EntryPose:
    """The pose of the needle at first contact."""

    # (3,); world; mm, unit vector into the tissue.
    origin: Floats
    direction: Floats
    source: Literal["stage", "shaft"]
    # Deviations of both against the measured centreline, in any one direction across; mm, rad.
    shift_sd: float
    angle_sd: float
    along_sd: float  # deviation of `origin` along the needle, mm


@dataclass(frozen=True)
class IntensityProfile:
    """The brightness around the needle, along it."""

    s: Floats  # (P,); along the needle from its first point, mm
    around: Floats  # (P,); of what surrounds it, HU; nan outside the volume


MaterialKind = Literal["air", "soft", "metal"]


@dataclass(frozen=True)
class MaterialRun:
    """A part of the needle whose surroundings are of one kind."""

    kind: MaterialKind
    # Along the needle from its first point, mm; a first or last run may go on beyond what is seen.
    begin: float
    end: float
    level: float  # median of the surroundings, HU
    sd: float  # deviation of where it begins, mm
    rise: float  # by which the brightness rises there, HU
    behind_air: bool  # whether it is soft and follows air, as tissue does; near metal streaks brighten that

    @property
    def length(self) -> float:
        """Length along the needle, mm."""
        return self.end - self.begin


@dataclass(frozen=True)
class EntryPlace:
    """Where the tissue begins, or may begin."""

    # Along the needle from its first point, and its deviation, mm.
    at: float
    sd: float
    guide: tuple[float, float] | None = None  # where the guide before it begins and ends, likewise
    confirmed: str = ""  # what was in doubt, and which answer a person gave; empty if nothing was


@dataclass(frozen=True)
class EntryChoice:
    """The places where the tissue may begin, the likeliest first; none where nothing shows it."""

    entries: tuple[EntryPlace, ...] = ()
    doubt: DataError | None = None  # why only a person can decide; None: the first is the entry


@dataclass(frozen=True)
class ScanView:
    """An image of the scan along two axes of the constraint frame, of which x runs to the right."""

    up: int  # the axis of C that runs upwards: 1, y, or 2, z
    # (H, W); mean over a thin slab, HU; nan outside the volume. Row 0 is the lowest. Along the third axis the
    # slab follows the needle, so that a bent one stays in the picture.
    values: Floats
    extent: tuple[float, float, float, float]  # left, right, bottom, top edges of the picture, mm in C


@dataclass(frozen=True)
class CurvePicture:
    """What is shown of a scan that was refused."""

    views: tuple[ScanView, ...]
    curve: Floats  # (N, 3); what was taken for the needle, in the frame of the views, mm
    entries: Floats  # (M,); x of the entries to choose from, mm


@dataclass(frozen=True)
class Layers:
    """The layers that the needle crosses."""

    surfaces: tuple[Surface, ...]  # world
    boundaries: Floats  # (n - 1,); depths of the interfaces crossed, along C's x, mm
    sd: Floats  # (n - 1,); their deviations, mm: of surface, registration and centreline
    points: Floats  # (n - 1, 3); where they are crossed, world, mm
    sequence: tuple[int, ...]  # the n layers met


@dataclass(frozen=True, kw_only=True)
class NeedleImage:
    """What a scan shows of its needle."""

    scan: Scan
    grid: VoxelGrid
    needle_axis: Centerline  # the whole needle, LPS
    profile: IntensityProfile
    passed: tuple[MaterialRun, ...]  # what the needle passes
    choice: EntryChoice  # where the brightness shows that the tissue begins
    markers: MarkerResult | None = None  # None where the world is the patient frame
    registration: Registration | None = None  # likewise

    @property
    def patient(self) -> Frame:
        """The scan's LPS axes and origin in the world."""
        return IDENTITY_FRAME if self.registration is None else self.registration.frame

    @property
    def whole_needle(self) -> Floats:
        """The whole needle in the world (N, 3), mm."""
        return self.patient.to_world(self.needle_axis.points)


@dataclass(frozen=True, kw_only=True)
class Reconstruction(NeedleImage):
    """The complete reconstruction of one scan."""

    entry: EntryPlace  # where the tissue begins
    pose: EntryPose
    shaft: EntryPose | None  # by the shaft outside the tissue, beside a stage; None where too little shows
    frame: Frame  # the constraint frame C in the world
    points: Floats  # (N, 3); the centreline from first contact to tip, world, mm
    # (N,); of each point in any one direction across, mm; the registration's error, common to all, is not in
    # it.
    sd: Floats
    layers: Layers
    views: tuple[ScanView, ...] = ()
    warnings: tuple[str, ...] = ()  # what a person should know

    @property
    def local(self) -> Floats:
        """The centreline in C (N, 3), mm; z is the deviation out of the bending plane."""
        return self.frame.to_local(self.points)

    @property
    def guide_faces(self) -> Floats:
        """Where the needle passes the faces of the guide (2, 3), LPS, mm; (0, 3) without a guide."""
        return interpolate_at_arc(self.needle_axis.points, self.entry.guide or ())

    @property
    def depth(self) -> float:
        """Inserted arc length, mm."""
        return float(arc_length(self.points)[-1])

    @property
    def depth_sd(self) -> float:
        """Deviation of the inserted arc length, mm."""
        return float(np.hypot(self.needle_axis.end.sd[0], self.pose.along_sd))

    @property
    def target_error(self) -> Floats:
        """Mean error that the registration leaves at the entry and at the tip (2,), predicted, mm."""
        if self.registration is None:
            return np.zeros(2)
        return predict_mean_target_error(self.registration, self.patient.to_local(self.points[[0, -1]]))

    @property
    def sections(self) -> SplineSections | None:
        """What the needle was drawn through, world, arc lengths from first contact, the shaft included."""
        drawn = self.needle_axis.sections
        return None if drawn is None else drawn.seen_from(self.patient, self.entry.at)

    def name_part(self, run: MaterialRun) -> Literal["before", "guide", "tissue"]:
        """Return what was taken for what the needle passes."""
        middle, guide = (run.begin + run.end) / 2, self.entry.guide
        if guide is not None and guide[0] < middle < guide[1]:
            return "guide"
        return "tissue" if middle > self.entry.at else "before"

    @property
    def deflection(self) -> float:
        """Tip deflection, mm, counted as in a dataset: from the first point, positive toward the bevel."""
        y = self.local[:, 1]
        return float(self.scan.side * (y[-1] - y[0]))


def render_views(volume: Volume, patient: Frame, frame: Frame, needle: ArrayLike) -> tuple[ScanView, ...]:
    """Return two images: the bending plane (x, y), and across it (x, z).

    `patient`: the scan's axes and origin in the world.
    `frame`: C in the world.
    `needle`: (N, 3); the whole needle from base to tip, LPS, mm.
    """
    local = frame.to_local(patient.to_world(needle))
    local = local[np.argsort(local[:, 0])]
    before, margin = 35.0, 10.0  # mm that are shown before the entry, and beyond the tip and to the sides
    # along the third axis a picture is averaged, mm: the slab holds the needle whole, and its mean quiets the
    # noise so that layers show
    slab = np.arange(-1.2, 1.3, 0.4)
    columns = np.arange(max(-before, local[0, 0] - 2.0), local[-1, 0] + margin, PLANE_SPACING_MM)
    right, shown, views = columns[:-1] + PLANE_SPACING_MM / 2, local[local[:, 0] >= -before], []
    for up, through in ((1, 2), (2, 1)):
        rows = np.arange(shown[:, up].min() - margin, shown[:, up].max() + margin, PLANE_SPACING_MM)
        x, height, off = np.meshgrid(right, rows[:-1] + PLANE_SPACING_MM / 2, slab)
        sides = {up: height, through: np.interp(x, *local[:, [0, through]].T) + off}
        points = np.stack([x, sides[1], sides[2]], axis=-1)
        mean = sample(volume, patient.to_local(frame.to_world(points))).mean(axis=2)
        extent = columns[0], columns[-1], rows[0], rows[-1]
        views.append(ScanView(up, mean, extent))
    return tuple(views)


def picture_curve(volume: Volume, curve: Floats, entries: Floats) -> CurvePicture:
    """Return pictures of a scan that was refused along a curve (N, 3), LPS, mm, with the `entries` (M, 3)."""
    center, axes = principal_axes(curve)
    forward = np.sign(axes[0] @ (curve[-1] - curve[0]) or 1.0)
    frame = make_entry_frame(center, forward * axes[0], axes[1])
    views = render_views(volume, IDENTITY_FRAME, frame, curve)
    return CurvePicture(views, frame.to_local(curve), frame.to_local(entries)[:, 0])
