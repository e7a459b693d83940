"""What belongs to scans that are named one by one, without a table of scans."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

SurfaceFrame = Literal["world", "scan"]


@dataclass(frozen=True)
class ScanFiles:
    """The files and names of scans, as `needlefit reconstruct` has options for them."""

    markers: Path | None = None  # known places of the markers in the world
    fiducials: Path | None = None  # the markers as placed in the scan by hand
    # Each as in a table of scans: FILE, FILE=sheet:2 or FILE=solid:3.
    layers: tuple[str, ...] = ()
    layers_in: SurfaceFrame = "world"  # frame of meshes
    mask: Path | None = None  # the needle's voxels, segmented elsewhere
    series: str | None = None  # number or UID of a DICOM series
    medium: str = "medium"  # name of what was punctured


NO_FILES = ScanFiles()
