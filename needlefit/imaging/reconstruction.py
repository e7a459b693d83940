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
from needlefit.imaging.scan import Scan
from needlefit.imaging.sphere_profile import PointSpread


@dataclass(frozen=True)
class RejectedMarker:
    """What has about a marker's size and is none.

    Attributes
    ----------
    center : (3,) array
        LPS, mm.
    diameter : float
        Of a ball of as many voxels, mm.
    misfit, max_misfit : float
        Of a ball's model to it, and the largest allowed, in parts of its brightness.
    reason : str
        "misfit", "blur", "moved" (the fit ran away), or "edge" (the volume's face is too near).
    """

    center: Floats
    diameter: float
    misfit: float
    max_misfit: float
    reason: Literal["misfit", "blur", "moved", "edge"]


@dataclass(frozen=True)
class MarkerResult:
    """The markers found in the scan.

    Attributes
    ----------
    centers : (M, 3) array
        LPS, mm.
    sd : (M,) array
        Deviation in any one direction, mm.
    source : str
        "volume", or "fiducials": placed by hand.
    misfits : (M,) array
        Of the balls' model, in parts of their brightness; empty for fiducials.
    rejected : tuple of RejectedMarker
        Other candidates in the volume.
    spread : PointSpread or None
        The scanner's, as the balls show it.
    warnings : tuple of str
        What a person should know of the balls.
    """

    centers: Floats
    sd: Floats
    source: Literal["volume", "fiducials"]
    misfits: Floats = field(default_factory=lambda: np.empty(0))
    rejected: tuple[RejectedMarker, ...] = ()
    spread: PointSpread | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class EntryPose:
    """The pose of the needle at first contact.

    Attributes
    ----------
    origin, direction : (3,) arrays
        World; mm, unit vector into the tissue.
    source : str
        "stage" or "shaft".
    shift_sd, angle_sd : float
        Deviations of both against the measured centreline, in any one direction across; mm, rad.
    along_sd : float
        Deviation of `origin` along the needle, mm.
    """

    origin: Floats
    direction: Floats
    source: Literal["stage", "shaft"]
    shift_sd: float
    angle_sd: float
    along_sd: float


@dataclass(frozen=True)
class IntensityProfile:
    """The brightness along the needle.

    Attributes
    ----------
    s : (P,) array
        Along the needle from its first contact, mm; negative outside the tissue.
    core, around : (P,) arrays
        Of the needle itself and of what surrounds it, HU; nan outside the volume.
    """

    s: Floats
    core: Floats
    around: Floats


@dataclass(frozen=True)
class ScanView:
    """An image of the scan along two axes of the constraint frame.

    Attributes
    ----------
    axes : tuple of str
        What runs to the right and upwards: "x", "y" or "z" of C.
    values : (H, W) array
        Mean over a thin slab, HU; nan outside the volume. Row 0 is the lowest. Along the third axis the slab
        follows the needle, so that a bent one stays in the picture.
    extent : tuple of float
        left, right, bottom, top edges of the picture, mm in C.
    """

    axes: tuple[str, str]
    values: NDArray[np.float32]
    extent: tuple[float, float, float, float]


@dataclass(frozen=True)
class Layers:
    """The layers that the needle crosses.

    Attributes
    ----------
    surfaces : tuple of Surface
        World.
    boundaries : (n - 1,) array
        Depths of the interfaces crossed, along C's x, mm.
    sd : (n - 1,) array
        Their deviations, mm: of surface, registration and centreline.
    points : (n - 1, 3) array
        Where they are crossed, world, mm.
    sequence : tuple of int
        The n layers met.
    """

    surfaces: tuple[Surface, ...]
    boundaries: Floats
    sd: Floats
    points: Floats
    sequence: tuple[int, ...]


@dataclass(frozen=True)
class ProposedInterface:
    """An interface between soft materials that the scan shows; a proposal, never used by itself.

    Attributes
    ----------
    surface : Surface
        A sheet around the needle, LPS of the scan.
    at, sd : float
        Where the needle crosses it, mm along the needle from the entry, and its deviation.
    step : float
        Change of brightness, HU.
    tilt : float
        Angle between its normal and the needle, rad.
    """

    surface: Surface
    at: float
    sd: float
    step: float
    tilt: float


@dataclass(frozen=True)
class Reconstruction:
    """The complete reconstruction of one scan.

    Attributes
    ----------
    spacing : (3,) array
        Of the voxels along i, j, k, mm.
    needle_axis : Centerline
        The whole needle, LPS.
    markers : MarkerResult or None
        None where the world is the patient frame.
    patient : Frame
        The scan's LPS axes and origin in the world.
    shaft : EntryPose or None
        The pose by the shaft outside the tissue; None where too little of it shows.
    frame : Frame
        The constraint frame C in the world.
    plane : str
        What fixes the bending plane: "stated", "bevel" (as seen in the scan) or "shape".
    points : (N, 3) array
        The centreline from first contact to tip, world, mm.
    sd : (N,) array
        Of each point in any one direction across, mm; the registration's error, common to all, is not in it.
    depth, depth_sd : float
        Inserted arc length, mm.
    target_error : (2,) array
        Mean error that the registration leaves at the entry and at the tip, predicted, mm; 0 without one.
    views : tuple of View
    warnings : tuple of str
        What a person should know.
    sections : SplineSections or None
        What the centreline was drawn through, world, arc lengths from first contact, the shaft outside
        included; None where no scan was traced.
    proposals : tuple of ProposedInterface or None
        Interfaces that the scan shows; None where nobody asked.
    """

    scan: Scan
    spacing: Floats
    needle_axis: Centerline
    markers: MarkerResult | None
    registration: Registration | None
    patient: Frame
    pose: EntryPose
    shaft: EntryPose | None
    frame: Frame
    plane: Literal["stated", "bevel", "shape"]
    points: Floats
    sd: Floats
    depth: float
    depth_sd: float
    target_error: Floats
    layers: Layers
    profile: IntensityProfile
    views: tuple[ScanView, ...]
    warnings: tuple[str, ...]
    sections: SplineSections | None = None
    proposals: tuple[ProposedInterface, ...] | None = None

    @property
    def local(self) -> Floats:
        """The centreline in C (N, 3), mm; z is the deviation out of the bending plane."""
        return self.frame.to_local(self.points)
