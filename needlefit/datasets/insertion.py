"""Types of measured data: an insertion, the dataset, its stated measurement errors."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.geometry.curves import arc_length
from needlefit.geometry.frames import IDENTITY_FRAME, Frame
from needlefit.geometry.surfaces import Surface
from needlefit.mechanics.needle import Needle
from needlefit.project.result_warnings import ResultWarning

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """The measurement errors that a dataset states, mm.

    Attributes
    ----------
    registration_mean : float
        Mean 3-D error that registration alone leaves at the needle.
    point_sd : float
        Standard deviation of independent noise of a centreline point, per axis.
    correlated_sd, correlation_length : float
        Standard deviation per axis and length along the needle of the correlated part.
    """

    registration_mean: float = 0.0
    point_sd: float = 0.0
    correlated_sd: float = 0.0
    correlation_length: float = 5.0

    @property
    def stated(self) -> bool:
        """Whether an error is stated for the points of a centreline."""
        return self.point_sd > 0 or self.correlated_sd > 0


@dataclass(frozen=True)
class Insertion:
    """One measured insertion, reduced to its bending plane.

    Attributes
    ----------
    id, medium, specimen : str
        `specimen` groups repeats in one piece; folds never split it.
    layers, layers_alternative : int
        Layers traversed as listed, and the other reading where it ends at a boundary (else the same).
    depth : float
        Inserted arc length, mm.
    side : int
        The side of C's x axis that the bevel faces, +1 or -1.
    frame : Frame
        C in the world: origin at the tip's first contact, x along the entry, y in the bending plane.
    pose_source : str
        "stage", "shaft", "fitted" or "none".
    pose_shift_sd, pose_angle_sd : float
        Standard deviation of the entry pose in the plane, mm and rad.
    centerline : (N, 3) array
        World points from entry to tip, mm.
    planar : (N, 2) array
        The same points in C's xy plane, mm.
    out_of_plane : (N,) array
        What the projection drops, mm.
    boundaries : (n - 1,) array
        Measured depths of the layer interfaces crossed, along C's x axis, mm.
    sequence : tuple of int
        Layer number (from 1) met in each of the n intervals between boundaries.
    boundary_sd : float
        Standard deviation of the boundaries, mm.
    depth_sd : float
        Standard deviation of `depth`, mm; 0 where none is stated.
    guide_distance : float or None
        Distance from a clamping guide to the entry, mm, where it is known.
    sd : (N,) array or None
        Standard deviation of each point in any one direction across the needle, mm, where it is known.
    surfaces : tuple of Surface
        Every boundary of its medium as it lay at this insertion, world; empty where depths are given.
    patient : Frame
        The patient coordinates (LPS) of its scan in the world.
    base_moved : float
        How far the base was moved across, toward +y of C, after the insertion and before the measurement, mm.
    """

    id: str
    medium: str
    specimen: str
    layers: int
    layers_alternative: int
    depth: float
    side: int
    frame: Frame
    pose_source: Literal["stage", "shaft", "fitted", "none"]
    pose_shift_sd: float
    pose_angle_sd: float
    centerline: Floats
    planar: Floats
    out_of_plane: Floats
    boundaries: Floats
    sequence: tuple[int, ...]
    boundary_sd: float
    guide_distance: float | None = None
    sd: Floats | None = None
    surfaces: tuple[Surface, ...] = ()
    patient: Frame = IDENTITY_FRAME
    depth_sd: float = 0.0
    base_moved: float = 0.0

    @property
    def deflection(self) -> float:
        """Measured tip deflection y_K - y_1 in C, positive toward the bevel, mm."""
        return float(self.side * (self.planar[-1, 1] - self.planar[0, 1]))


@dataclass(frozen=True)
class Dataset:
    """Insertions measured with one needle.

    Attributes
    ----------
    origin : str
        "measured" or "synthetic"; a synthetic dataset is called so wherever it appears.
    media : tuple of str
        Names of the media described; every insertion went into one of them.
    pose : str
        "known", or "free" where shapes are known only up to a rigid motion.
    drop_proximal : float
        Proximal length left out of comparisons of free shapes, mm.
    digest : str
        SHA-256 over all files read, in the order of their names.
    notes : tuple of str
        What its makers want known of data, needle and noise; reports print it.
    outer_diameter : float or None
        Of the needle, mm, where it is stated.
    warnings : tuple of ResultWarning
        What is suspicious in it, though it can be fitted.
    """

    name: str
    title: str
    origin: Literal["measured", "synthetic"]
    needle: Needle
    insertions: tuple[Insertion, ...]
    media: tuple[str, ...]
    noise: Noise
    pose: Literal["known", "free"]
    drop_proximal: float
    path: Path
    digest: str
    notes: tuple[str, ...] = ()
    outer_diameter: float | None = None
    warnings: tuple[ResultWarning, ...] = ()


def find_free_reach(drop: float, insertion: Insertion) -> float:
    """Return the distance from the tip at which the comparison of free shapes begins, mm.

    Raises
    ------
    DataError
        If nothing is left to compare.
    """
    reach = min(float(arc_length(insertion.planar)[-1]), insertion.depth) - drop
    if reach <= 0:
        raise DataError(
            f"insertion `{insertion.id}` is not longer than the {drop:g} mm that are left out",
            fix="lessen frame.drop_proximal_mm, or leave the insertion out",
        )
    return reach
