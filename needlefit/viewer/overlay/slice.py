"""The slice of a scan in the bending plane of its needle."""

from dataclasses import dataclass

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.sources import ScanVolume, find_volume
from needlefit.imaging.views import ENTRY_MARGIN_MM, render_bending_plane
from needlefit.imaging.volume_files import ct_packages_installed, read_volume
from needlefit.project.input_files import path_exists

SLICE_HALF_WIDTH_MM = 25.0
"""How far the slice reaches to both sides of the needle, mm."""


@dataclass(frozen=True)
class InsertionScan:
    """A measured needle, and the scan in which it was measured."""

    volume: ScanVolume
    insertion: Insertion


@dataclass(frozen=True)
class ScanSlice:
    """A slice of a scan as PNG, and its edges in C: left, right, bottom, top, mm."""

    png: bytes
    extent: tuple[float, float, float, float]


def find_scan(dataset: Dataset, insertion: Insertion) -> tuple[InsertionScan | None, str]:
    """Return the scan of an insertion, or None with the reason if one was expected.

    Raises
    ------
    DataError
        If the table of the dataset's scans has a fault.
    """
    volume = find_volume(dataset, insertion.id)
    if volume is None:
        return None, ""
    if not ct_packages_installed():
        return None, "No slice of the scan: it takes pip install 'needlefit[ct]'."
    if not path_exists(volume.path):
        return None, f"No slice of the scan: it is not at {volume.path} any more, where volumes.csv has it."
    return InsertionScan(volume, insertion), ""


def read_slice(one: InsertionScan) -> ScanSlice:
    """Read a scan and return the slice along its needle; this takes seconds for a large scan.

    It follows the needle through the thickness, so that a needle bent out of its plane stays in it; before
    the entry it follows the entry axis.

    Raises
    ------
    DataError
        If the scan cannot be read.
    """
    from needlefit.reporting.figures.scan_views import (
        encode_png,  # the page is there before a slice is asked for
    )

    insertion = one.insertion
    shaft = insertion.frame.to_world(np.array([[-ENTRY_MARGIN_MM, 0.0, 0.0]]))
    needle = insertion.patient.to_local(np.concatenate([shaft, insertion.centerline]))
    volume = read_volume(one.volume.path, one.volume.series)
    view = render_bending_plane(volume, insertion.patient, insertion.frame, needle, SLICE_HALF_WIDTH_MM)
    return ScanSlice(encode_png(view), view.extent)
