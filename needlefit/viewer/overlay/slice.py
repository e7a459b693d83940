"""The slice of a scan in the plane in which the needle bends."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.geometry.frames import Frame

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scanned:
    """Where a needle lies in its scan.

    Attributes
    ----------
    volume : Path
    series : str or None
        Which DICOM series, where a folder holds several.
    patient : Frame
        The scan's axes and origin in the world.
    frame : Frame
        C in the world.
    needle : (N, 3) array
        From entry to tip, world, mm.
    """

    volume: Path
    series: str | None
    patient: Frame
    frame: Frame
    needle: Floats
