"""What is asked of a reconstruction: one scan of an inserted needle, and what is known besides."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.geometry.surfaces import Kind

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Stage:
    """Where the needle was held, in the world.

    Attributes
    ----------
    entry : (3,) array
        The tip at first contact, mm.
    direction : (3,) array
        Unit vector of insertion, into the tissue.
    shift_sd, angle_sd : float
        Standard deviations of both in any one direction, mm and rad.
    """

    entry: Floats
    direction: Floats
    shift_sd: float
    angle_sd: float


@dataclass(frozen=True)
class LayerSource:
    """A file with a layer's surface (STL, PLY, OBJ), or with a segmentation of all layers (NRRD, NIfTI).

    Attributes
    ----------
    path : Path
    kind : "sheet", "solid" or None
        None: solid where the mesh is closed.
    into : int or None
        The layer it leads into; 1 is the tissue's own surface. None: by its place in the list, from 2.
    """

    path: Path
    kind: Kind | None = None
    into: int | None = None


@dataclass(frozen=True)
class Scan:
    """One scan, and what is known besides.

    Attributes
    ----------
    id, medium, specimen : str
        As in `insertions.csv`.
    volume : Path
        A DICOM folder or file, NRRD, NIfTI or MetaImage; `series` names one of several in a folder.
    mask : Path or None
        The needle's voxels, segmented elsewhere; a volume that stands where the scan does.
    markers : Path or None
        Known places of the markers in the world; None: the world is the patient frame (LPS) of the scan.
    fiducials : Path or None
        The markers as placed in the scan by hand; None: they are looked for in the volume.
    surfaces : tuple of LayerSource
    surfaces_in : "world" or "scan"
        The frame of `surfaces`; a segmentation always lies in that of its scan.
    stage : Stage or None
        None: the entry pose comes from the shaft outside the tissue.
    bevel : (3,) array or None
        World direction toward which C's +y shall point, on or off the entry plane.
    side : int
        The side of C's x axis that the bevel faces, +1 (toward +y) or -1.
    layers, layers_alternative : int or None
        Layers that were met, where somebody counted them; None: as many as are found.
    guide_distance : float or None
        As in `insertions.csv`, mm.
    origin : str
        "measured" or "synthetic".
    """

    id: str
    volume: Path
    medium: str
    specimen: str = ""
    series: str | None = None
    mask: Path | None = None
    markers: Path | None = None
    fiducials: Path | None = None
    surfaces: tuple[LayerSource, ...] = ()
    surfaces_in: Literal["world", "scan"] = "world"
    stage: Stage | None = None
    bevel: Floats | None = None
    side: int = 1
    layers: int | None = None
    layers_alternative: int | None = None
    guide_distance: float | None = None
    origin: Literal["measured", "synthetic"] = "measured"

    @property
    def files(self) -> tuple[Path, ...]:
        """All files, and DICOM folders, that are read of it."""
        others = (self.mask, self.markers, self.fiducials, *(source.path for source in self.surfaces))
        return (self.volume, *(path for path in others if path is not None))
