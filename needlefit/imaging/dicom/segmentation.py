"""Read DICOM segmentations (SEG by highdicom, RTSTRUCT by pydicom) as label volumes."""

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.uid import RTStructureSetStorage, SegmentationStorage

from needlefit.errors import DataError
from needlefit.imaging.dicom.contours import find_frame_of_reference, mark_regions, parse_regions
from needlefit.imaging.header_checks import choose_segments
from needlefit.imaging.volume import VoxelGrid, begins_as_dicom, check_grid, grid_to_json, orthogonalize
from needlefit.project.input_files import is_file, list_files, open_regular
from needlefit.project.sandbox import SandboxArrays, allow_memory

if TYPE_CHECKING:
    from highdicom.seg import Segmentation

MIN_FRACTION = 0.5
"""A voxel of a fractional segment belongs to it from this fraction on."""

EXPECTED_SEGMENTATION = "one segmentation: a DICOM-SEG or RTSTRUCT file, .seg.nrrd, or a volume of labels"
BYTES_PER_VOXEL = 24
"""Memory of a voxel while its segments are read, one after another."""

Answer = dict[str, Any]


def read_segmentation(results: SandboxArrays, path: str, names: Sequence[str] = ()) -> Answer:
    """Read a DICOM segmentation: the array "values" of labels 1, 2, ..., its grid, the segments' names.

    Parameters
    ----------
    path : str
        The file, or a folder with one in it or below.
    names : sequence of str
        Segments or regions that are read, in this order; empty: all.

    Raises
    ------
    DataError
        If there is no segmentation or several, a name is not in it, or its segments overlap.
    """
    file = _find_segmentation(Path(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if _storage(file) == RTStructureSetStorage:
                return _read_contours(results, file, names)
            return _read_segments(results, file, names)
        except (DataError, MemoryError):
            raise
        except Exception as error:  # whatever the bytes provoke
            raise DataError(
                f"cannot be read as a segmentation ({type(error).__name__})",
                where=str(file),
                expected="a whole DICOM-SEG or RTSTRUCT file",
                fix="copy the file again, or export the segmentation again",
            ) from error


def _find_segmentation(path: Path) -> Path:
    files = [path] if is_file(path) else list_files(path)
    found = [one for one in files if begins_as_dicom(one) and _storage(one) in _STORAGES]
    if len(found) == 1:
        return found[0]
    listed = ": " + ", ".join(one.name for one in found[:10]) if found else ""
    raise DataError(
        f"holds {len(found) or 'no'} DICOM segmentation{'s' * (len(found) > 1)}{listed}",
        where=str(path),
        expected=EXPECTED_SEGMENTATION,
        fix="name the file of the segmentation" if found else "export the segmentation, not the scan",
    )


_LABEL_MAP_STORAGE = "1.2.840.10008.5.1.4.1.1.66.7"
_STORAGES = (SegmentationStorage, _LABEL_MAP_STORAGE, RTStructureSetStorage)


def _storage(file: Path) -> str:
    """Return what kind of DICOM object a file holds; empty if it cannot be read."""
    try:
        with open_regular(file, sys.maxsize) as content:
            data = pydicom.dcmread(content, stop_before_pixels=True, specific_tags=["SOPClassUID"])
        return str(data.get("SOPClassUID", ""))
    except DataError:
        raise
    except Exception:  # whatever the bytes provoke
        return ""


def _read_contours(results: SandboxArrays, file: Path, names: Sequence[str]) -> Answer:
    with open_regular(file, sys.maxsize) as content:
        data = pydicom.dcmread(content)
    regions = parse_regions(data, str(file))
    if not names:  # points and lines mark places, such as the isocentre
        regions = [one for one in regions if one.contours]
    regions = [regions[n] for n in choose_segments([one.name for one in regions], names, file)]
    empty = [one.name for one in regions if not one.contours or one.others]
    if empty:
        raise DataError(
            f"region {empty[0]} has no contours, or open ones",
            where=str(file),
            expected="closed planar contours",
            fix="leave it out, or export it again as closed contours",
        )
    planes = mark_regions(regions, str(file))
    results.new("values", planes.values.shape, "float32")[...] = planes.values
    frame = find_frame_of_reference(data)
    return {
        **grid_to_json(planes.grid),
        "names": [one.name for one in regions],
        "frame_of_reference": frame,
    }


def _read_segments(results: SandboxArrays, file: Path, names: Sequence[str]) -> Answer:
    import highdicom  # takes its time to load, and contours need none

    with open_regular(file, sys.maxsize) as content:
        segmentation = highdicom.seg.segread(content)
    numbers = list(segmentation.segment_numbers)
    labels = [str(segmentation.get_segment_description(n).segment_label).strip() for n in numbers]
    chosen = choose_segments(labels, names, file)
    grid = _find_grid(segmentation, file)
    values = results.new("values", grid.size[::-1], "float32")
    allow_memory(values.size * BYTES_PER_VOXEL)
    for label, n in enumerate(chosen, 1):
        inside = _read_segment(segmentation, numbers[n])
        met = int(values[inside].max(initial=0))
        if met:
            raise DataError(
                f"its segments overlap: {labels[chosen[met - 1]]}, {labels[n]}",
                where=str(file),
                expected="every voxel in one layer",
                fix="draw them without overlap, or name those that do not overlap: FILE=segments:NAME,NAME",
            )
        values[inside] = label
    grid_parts = grid_to_json(VoxelGrid(grid.size, grid.origin, grid.spacing, orthogonalize(grid.direction)))
    frame = str(segmentation.get("FrameOfReferenceUID", ""))
    return {**grid_parts, "names": [labels[n] for n in chosen], "frame_of_reference": frame}


def _find_grid(segmentation: "Segmentation", file: Path) -> VoxelGrid:
    geometry = segmentation.get_volume_geometry()
    if geometry is None:
        raise DataError(
            "its frames are no even stack of slices",
            where=str(file),
            expected="segments on the slices of one volume",
            fix="resample the scan to even steps, and segment it again",
        )
    slices, rows, columns = geometry.spatial_shape
    affine = np.asarray(geometry.affine, dtype=np.float64)  # of slice, row, column
    steps = affine[:3, 2::-1]
    spacing = np.linalg.norm(steps, axis=0)
    grid = VoxelGrid((columns, rows, slices), affine[:3, 3].copy(), spacing, steps / spacing)
    check_grid(grid, str(file))
    return grid


def _read_segment(segmentation: "Segmentation", number: int) -> NDArray[np.bool_]:
    """Return the voxels (K, J, I) of one segment."""
    volume = segmentation.get_volume(segment_numbers=[number], dtype=np.float32)
    inside: NDArray[np.bool_] = volume.array[..., 0] >= MIN_FRACTION
    return inside
