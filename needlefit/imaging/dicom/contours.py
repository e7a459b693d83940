"""Read the contours of a DICOM structure set (RTSTRUCT), and mark the voxels inside them."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pydicom
from pydicom.uid import RTStructureSetStorage

from needlefit.arrays import Floats
from needlefit.errors import DataError, refusal
from needlefit.geometry.curves import make_normal
from needlefit.geometry.meshes import fill_outline
from needlefit.imaging.segmentations import choose_segments
from needlefit.imaging.volume import VoxelGrid, begins_as_dicom, check_grid, grid_to_json
from needlefit.project.input_files import is_file, list_files, open_regular
from needlefit.project.reader_process import Arrays

PIXEL_MM = 0.25  # spacing of the pixels within a plane of contours, mm, unless they would be too many
MAX_CONTOUR_VOXELS = 2**26
# A point may stand this far from its plane, and a plane from its place among even steps, mm.
PLANE_TOLERANCE_MM = 0.1
AXIS_COSINE = 1 - 1e-6  # a normal nearer than this to an axis of the patient is that axis
_CLOSED = ("CLOSED_PLANAR", "CLOSEDPLANAR_XOR")


def read_structures(arrays: Arrays, path: str, names: Sequence[str] = ()) -> dict[str, Any]:
    """Read a structure set: add the array "values" of labels 1, 2, ...; return its grid, the regions' names.

    Of two regions that share voxels the later one has them.

    `path`: the file, or a folder with one in it or below.
    `names`: regions that are read, in this order; empty: all with closed contours.

    DataError if there is no structure set or several, a name is not in it, or its contours are open, not
    parallel, not flat or in uneven steps.
    """
    place, found = Path(path), list[Path]()
    for file in filter(begins_as_dicom, [place] if is_file(place) else list_files(place)):
        if _read_file(file, ["SOPClassUID"]).get("SOPClassUID") == RTStructureSetStorage:
            found.append(file)
    if len(found) != 1:
        listed = ": " + ", ".join(one.name for one in found[:10]) if found else ""
        raise refusal(f"""holds {len(found) or "no"} DICOM structure set{"s" * (len(found) > 1)}{listed}
            expected: one segmentation: an RTSTRUCT file, .seg.nrrd, or a volume of labels
            fix: {"name the file of the segmentation" if found else "export the segmentation as one of these"}
            where: {path}""")
    data = _read_file(found[0])
    drawn = {
        one.ReferencedROINumber: one.get("ContourSequence") for one in data.get("ROIContourSequence") or ()
    }
    regions = [
        (str(one.get("ROIName") or f"region {one.ROINumber}").strip(), list(drawn.get(one.ROINumber) or ()))
        for one in data.StructureSetROISequence
    ]
    if not names:  # points and lines mark places, such as the isocentre
        regions = [one for one in regions if any(map(_is_closed, one[1]))]
    regions = [regions[n] for n in choose_segments([name for name, _ in regions], names)]
    for name, contours in regions:
        if not contours or not all(map(_is_closed, contours)):
            raise refusal(f"""region {name} has no contours, or open ones
                expected: closed planar contours
                fix: leave it out, or export it again as closed contours""")
    points = [list(map(_parse_points, contours)) for _, contours in regions]
    # the unit normal of the largest contour, to which all others are flat and parallel
    every = [one for contours in points for one in contours]
    areas = [np.cross(one - one[0], np.roll(one, -1, axis=0) - one[0]).sum(axis=0) / 2 for one in every]
    largest = max(areas, key=lambda area: float(np.linalg.norm(area)))
    normal: Floats = largest / (np.linalg.norm(largest) or 1.0)
    main = int(np.argmax(np.abs(normal)))
    normal = normal if normal[main] > 0 else -normal
    if normal[main] > AXIS_COSINE:
        normal = np.eye(3)[main]
    thickness = max(float(np.ptp(one @ normal)) for one in every)
    if not normal.any() or thickness > 2 * PLANE_TOLERANCE_MM:
        raise _contour_error("has contours that are not flat, or not parallel to each other")
    first = np.array([1.0, 0.0, 0.0]) if normal[2] == 1.0 else make_normal(normal)
    axes = np.column_stack([first, np.cross(normal, first), normal])
    turned = [[one @ axes for one in contours] for contours in points]
    grid = _make_grid(turned, axes)
    values = arrays["values"] = np.zeros(grid.size[::-1], dtype=np.float32)
    for label, contours in enumerate(turned, 1):
        planes: dict[int, list[Floats]] = {}
        for one in contours:
            index = (one - grid.origin @ axes) / grid.spacing
            line = np.stack([index, np.roll(index, -1, axis=0)], axis=1)[..., :2]
            planes.setdefault(round(float(index[:, 2].mean())), []).append(line)
        for k, lines in planes.items():
            values[k, fill_outline(np.concatenate(lines), grid.size[1::-1])] = label
        if label not in values:
            raise _contour_error(
                f"region {regions[label - 1][0]} holds no voxel of {grid.spacing.tolist()} mm"
            )
    sequences = {
        "StructureSetROISequence": "ReferencedFrameOfReferenceUID",
        "ReferencedFrameOfReferenceSequence": "FrameOfReferenceUID",
    }
    stated = {str(one.get(name, "")) for key, name in sequences.items() for one in data.get(key) or ()} - {""}
    frame = stated.pop() if len(stated) == 1 else ""
    return {**grid_to_json(grid), "names": [name for name, _ in regions], "frame_of_reference": frame}


def _read_file(file: Path, tags: list[str] | None = None) -> pydicom.Dataset:
    with open_regular(file, sys.maxsize) as content:
        return pydicom.dcmread(content, specific_tags=tags)


def _is_closed(contour: pydicom.Dataset) -> bool:
    return contour.get("ContourGeometricType") in _CLOSED


def _parse_points(contour: pydicom.Dataset) -> Floats:
    """Return the points (N, 3) of a contour from its text at once: pydicom takes a second for a MB."""
    value = contour.get_item("ContourData").value
    try:
        numbers = value.split(b"\\") if isinstance(value, bytes) else list(value)
        points = np.array(numbers, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError):
        raise _contour_error("has a contour whose points are no triples of numbers") from None
    if len(points) < 3 or not np.isfinite(points).all() or np.abs(points).max() > 1e5:
        raise _contour_error("has a contour with fewer than three points, or one that is not finite")
    return points


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
