"""Read the contours of a DICOM structure set (RTSTRUCT), and mark the voxels inside them."""

import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from numpy.typing import NDArray
from pydicom.uid import RTStructureSetStorage

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.geometry.curves import make_normal
from needlefit.geometry.meshes import fill_outline
from needlefit.imaging.refusals import located, refusal
from needlefit.imaging.segmentations import choose_segments
from needlefit.imaging.volume import VoxelGrid, begins_as_dicom, check_grid, grid_to_json
from needlefit.project.input_files import is_file, list_files, open_regular
from needlefit.project.reader_process import Arrays

PIXEL_MM = 0.25  # spacing of the pixels within a plane of contours, mm, unless they would be too many
MAX_CONTOUR_VOXELS = 2**26
MAX_ROIS = 1000
MAX_CONTOURS = 200_000
# A point may stand this far from its plane, and a plane from its place among even steps, mm.
PLANE_TOLERANCE_MM = 0.1
AXIS_COSINE = 1 - 1e-6  # a normal nearer than this to an axis of the patient is that axis
_CLOSED = ("CLOSED_PLANAR", "CLOSEDPLANAR_XOR")


@dataclass(frozen=True)
class ContouredRegion:
    """A region of interest: its name, its closed contours (N, 3), LPS, mm, and whether it has others."""

    name: str
    contours: list[Floats]
    others: bool


def _parse_points(contour: pydicom.Dataset) -> Floats:
    """Return the points (N, 3) of a contour from its text at once: pydicom takes a second for a MB."""
    raw = contour.get_item("ContourData")
    value = b"" if raw is None else raw.value
    try:
        numbers = value.split(b"\\") if isinstance(value, bytes) else list(value or ())
        points = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError):
        raise _contour_error("has a contour whose points are no triples of numbers") from None
    if len(points) < 3 or not np.isfinite(points).all() or np.abs(points).max() > 1e5:
        raise _contour_error("has a contour with fewer than three points, or one that is not finite")
    return points


def mark_regions(regions: Sequence[ContouredRegion]) -> tuple[VoxelGrid, NDArray[np.uint8]]:
    """Return the planes of contours as a grid, and the labels 1, 2, ... of the regions (K, J, I).

    Of two that share voxels the later one has them.

    DataError if contours are not parallel, flat and in even steps.
    """
    normal = _find_normal([one for region in regions for one in region.contours])
    first = np.array([1.0, 0.0, 0.0]) if normal[2] == 1.0 else make_normal(normal)
    axes = np.column_stack([first, np.cross(normal, first), normal])
    turned = [[one @ axes for one in region.contours] for region in regions]
    grid = _make_grid(turned, axes)
    values = np.zeros(grid.size[::-1], dtype=np.uint8)
    for label, (region, contours) in enumerate(zip(regions, turned, strict=True), 1):
        columns, rows, slices = grid.size
        inside = np.zeros((slices, rows, columns), dtype=np.bool_)
        planes: dict[int, list[Floats]] = {}
        for one in contours:
            index = (one - grid.origin @ axes) / grid.spacing
            planes.setdefault(round(float(index[:, 2].mean())), []).append(index[:, :2])
        for k, outlines in planes.items():
            lines = [np.stack([one, np.roll(one, -1, axis=0)], axis=1) for one in outlines]
            inside[k] = fill_outline(np.concatenate(lines), (rows, columns))
        values[inside] = label
        if not inside.any():
            raise _contour_error(f"region {region.name} holds no voxel of {grid.spacing.tolist()} mm")
    return grid, values


def _find_normal(contours: Sequence[Floats]) -> Floats:
    """Return the unit normal of the contour that is largest; see that all others are flat and parallel."""
    areas = [np.cross(one - one[0], np.roll(one, -1, axis=0) - one[0]).sum(axis=0) / 2 for one in contours]
    largest = max(areas, key=lambda area: float(np.linalg.norm(area)))
    normal: Floats = largest / (np.linalg.norm(largest) or 1.0)
    main = int(np.argmax(np.abs(normal)))
    normal = normal if normal[main] > 0 else -normal
    if normal[main] > AXIS_COSINE:
        normal = np.eye(3)[main]
    thickness = max(float(np.ptp(one @ normal)) for one in contours)
    if not normal.any() or thickness > 2 * PLANE_TOLERANCE_MM:
        raise _contour_error("has contours that are not flat, or not parallel to each other")
    return normal


def _make_grid(turned: Sequence[Sequence[Floats]], axes: Floats) -> VoxelGrid:
    """Return a grid whose slices are the planes of contours, given along the axes (N, 3)."""
    contours = [one for region in turned for one in region]
    heights = np.unique(np.round([one[:, 2].mean() for one in contours], 2))
    steps = np.diff(heights)
    steps = steps[steps > 2 * PLANE_TOLERANCE_MM]
    if not len(steps):
        raise _contour_error("has contours in one plane only")
    # the mean of many steps: rounding of single heights must not add up over the stack
    step = float(steps.min())
    step = float(heights[-1] - heights[0]) / max(round(float(heights[-1] - heights[0]) / step), 1)
    places = (heights - heights[0]) / step
    if np.abs(places - np.rint(places)).max() * step > PLANE_TOLERANCE_MM:
        raise _contour_error(f"has contours in uneven steps; the smallest is {steps.min():.3g} mm")
    points = np.concatenate(contours)[:, :2]
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    slices = round(float(places[-1])) + 1
    pixel = max(PIXEL_MM, float(np.sqrt(extent.prod() * slices / MAX_CONTOUR_VOXELS)))
    columns, rows = (int(n) + 3 for n in np.ceil(extent / pixel))
    origin = axes @ np.array([*(low - pixel), heights[0]])
    grid = VoxelGrid((columns, rows, slices), origin, np.array([pixel, pixel, step]), axes)
    check_grid(grid)
    return grid


def _contour_error(what: str) -> DataError:
    return refusal(f"""{what}
        expected: closed, flat, parallel contours in even steps
        fix: export the structures again as closed planar contours, or as a segmentation (NRRD)""")


def _holds_structures(file: Path) -> bool:
    """Return whether a file is a DICOM structure set; one that cannot be read is none."""
    if not begins_as_dicom(file):
        return False
    try:
        with open_regular(file, sys.maxsize) as content:
            data = pydicom.dcmread(content, stop_before_pixels=True, specific_tags=["SOPClassUID"])
        return data.get("SOPClassUID") == RTStructureSetStorage
    except DataError:
        raise
    except Exception:  # whatever the bytes provoke
        return False


def _parse_regions(data: pydicom.Dataset, file: Path) -> list[ContouredRegion]:
    """Return the regions of a structure set, in its order."""
    listed = list(data.StructureSetROISequence)
    drawn = {int(one.ReferencedROINumber): one for one in data.get("ROIContourSequence") or ()}
    if len(listed) > MAX_ROIS or len({int(one.ROINumber) for one in listed}) < len(listed):
        raise _contour_error("lists too many regions, or two of one number")
    regions, count = [], 0
    for one in listed:
        name = str(one.get("ROIName") or f"region {one.ROINumber}").strip()
        contours = drawn.get(int(one.ROINumber), pydicom.Dataset()).get("ContourSequence") or ()
        closed = [contour for contour in contours if contour.get("ContourGeometricType") in _CLOSED]
        with located(f"{file}, region {name}"):
            points = [_parse_points(contour) for contour in closed]
        regions.append(ContouredRegion(name, points, len(closed) < len(contours)))
        count += len(contours)
    if count > MAX_CONTOURS:
        raise _contour_error(f"holds {count} contours")
    return regions


def read_structures(arrays: Arrays, path: str, names: Sequence[str] = ()) -> dict[str, Any]:
    """Read a structure set: add the array "values" of labels 1, 2, ...; return its grid, the regions' names.

    `path`: the file, or a folder with one in it or below.
    `names`: regions that are read, in this order; empty: all.

    DataError if there is no structure set or several, or a name is not in it.
    """
    place = Path(path)
    found = [one for one in ([place] if is_file(place) else list_files(place)) if _holds_structures(one)]
    if len(found) != 1:
        listed = ": " + ", ".join(one.name for one in found[:10]) if found else ""
        raise refusal(f"""holds {len(found) or "no"} DICOM structure set{"s" * (len(found) > 1)}{listed}
            expected: one segmentation: an RTSTRUCT file, .seg.nrrd, or a volume of labels
            fix: {"name the file of the segmentation" if found else "export the segmentation as one of these"}
            where: {path}""")
    with warnings.catch_warnings(), located(found[0]):
        warnings.simplefilter("ignore")
        try:
            return _read_contours(arrays, found[0], names)
        except (DataError, MemoryError):
            raise
        except Exception as error:  # whatever the bytes provoke
            raise refusal(f"""cannot be read as a structure set ({type(error).__name__})
                expected: a whole RTSTRUCT file
                fix: copy the file again, or export the structures again""") from error


def _read_contours(arrays: Arrays, file: Path, names: Sequence[str]) -> dict[str, Any]:
    with open_regular(file, sys.maxsize) as content:
        data = pydicom.dcmread(content)
    regions = _parse_regions(data, file)
    if not names:  # points and lines mark places, such as the isocentre
        regions = [one for one in regions if one.contours]
    regions = [regions[n] for n in choose_segments([one.name for one in regions], names)]
    empty = [one.name for one in regions if not one.contours or one.others]
    if empty:
        raise refusal(f"""region {empty[0]} has no contours, or open ones
            expected: closed planar contours
            fix: leave it out, or export it again as closed contours""")
    grid, values = mark_regions(regions)
    arrays["values"] = values.astype(np.float32)
    chosen = [one.name for one in regions]
    stated = {
        str(one.get(name, ""))
        for sequence, name in (
            ("StructureSetROISequence", "ReferencedFrameOfReferenceUID"),
            ("ReferencedFrameOfReferenceSequence", "FrameOfReferenceUID"),
        )
        for one in data.get(sequence) or ()
    } - {""}
    frame = stated.pop() if len(stated) == 1 else ""
    return {**grid_to_json(grid), "names": chosen, "frame_of_reference": frame}
