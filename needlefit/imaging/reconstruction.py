"""The result of reconstructing one scan."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.geometry.smoothing_spline import SplineSections
from needlefit.geometry.surfaces import Surface
from needlefit.imaging.needle.centerline import Centerline
from needlefit.imaging.registration.register import Registration
from needlefit.imaging.scans import Scan
from needlefit.imaging.spheres import PointSpread


@dataclass(frozen=True)
class RejectedMarker:
    """What has about a marker's size and is none."""

    center: Floats  # (3,); LPS, mm
    diameter: float  # of a ball of as many voxels, mm
    # Of a ball's model to it, and the largest allowed, in parts of its brightness.
    misfit: float
    max_misfit: float
    # "misfit", "blur", "moved" (the fit ran away), or "edge" (the volume's face is too near).
    reason: Literal["misfit", "blur", "moved", "edge"]


@dataclass(frozen=True)
class MarkerResult:
    """The markers found in the scan."""

    centers: Floats  # (M, 3); LPS, mm
    sd: Floats  # (M,); deviation in any one direction, mm
    source: Literal["volume", "fiducials"]  # "volume", or "fiducials": placed by hand
    # (M,); of the balls' model, in parts of their brightness; empty for fiducials.
    misfits: Floats = field(default_factory=lambda: np.empty(0))
    rejected: tuple[RejectedMarker, ...] = ()  # other candidates in the volume
    spread: PointSpread | None = None  # the scanner's, as the balls show it
    warnings: tuple[str, ...] = ()  # what a person should know of the balls


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
    """The brightness along the needle."""

    s: Floats  # (P,); along the needle from its first contact, mm; negative outside the tissue
    # (P,); of the needle itself and of what surrounds it, HU; nan outside the volume.
    core: Floats
    around: Floats


@dataclass(frozen=True)
class ScanView:
    """An image of the scan along two axes of the constraint frame."""

    axes: tuple[str, str]  # what runs to the right and upwards: "x", "y" or "z" of C
    # (H, W); mean over a thin slab, HU; nan outside the volume. Row 0 is the lowest. Along the third axis the
    # slab follows the needle, so that a bent one stays in the picture.
    values: NDArray[np.float32]
    extent: tuple[float, float, float, float]  # left, right, bottom, top edges of the picture, mm in C


@dataclass(frozen=True)
class Layers:
    """The layers that the needle crosses."""

    surfaces: tuple[Surface, ...]  # world
    boundaries: Floats  # (n - 1,); depths of the interfaces crossed, along C's x, mm
    sd: Floats  # (n - 1,); their deviations, mm: of surface, registration and centreline
    points: Floats  # (n - 1, 3); where they are crossed, world, mm
    sequence: tuple[int, ...]  # the n layers met


@dataclass(frozen=True)
class ProposedInterface:
    """An interface between soft materials that the scan shows; a proposal, never used by itself."""

    surface: Surface  # a sheet around the needle, LPS of the scan
    # Where the needle crosses it, mm along the needle from the entry, and its deviation.
    at: float
    sd: float
    step: float  # change of brightness, HU
    tilt: float  # angle between its normal and the needle, rad


@dataclass(frozen=True)
class Reconstruction:
    """The complete reconstruction of one scan."""

    scan: Scan
    spacing: Floats  # (3,); of the voxels along i, j, k, mm
    needle_axis: Centerline  # the whole needle, LPS
    markers: MarkerResult | None  # None where the world is the patient frame
    registration: Registration | None
    patient: Frame  # the scan's LPS axes and origin in the world
    pose: EntryPose
    shaft: EntryPose | None  # the pose by the shaft outside the tissue; None where too little of it shows
    frame: Frame  # the constraint frame C in the world
    # What fixes the bending plane: "stated", "bevel" (as seen in the scan) or "shape".
    plane: Literal["stated", "bevel", "shape"]
    points: Floats  # (N, 3); the centreline from first contact to tip, world, mm
    # (N,); of each point in any one direction across, mm; the registration's error, common to all, is not in
    # it.
    sd: Floats
    # Inserted arc length, mm.
    depth: float
    depth_sd: float
    # (2,); mean error that the registration leaves at the entry and at the tip, predicted, mm; 0 without one.
    target_error: Floats
    layers: Layers
    profile: IntensityProfile
    views: tuple[ScanView, ...]
    warnings: tuple[str, ...]  # what a person should know
    # What the centreline was drawn through, world, arc lengths from first contact, the shaft outside
    # included; None where no scan was traced.
    sections: SplineSections | None = None
    # Interfaces that the scan shows; None where nobody asked.
    proposals: tuple[ProposedInterface, ...] | None = None

    @property
    def local(self) -> Floats:
        """The centreline in C (N, 3), mm; z is the deviation out of the bending plane."""
        return self.frame.to_local(self.points)
