"""Read the needles of a DICOM RT structure set: its open contours, as centrelines.

pydicom reads it in a child process: a damaged file may provoke anything.
"""

from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import numpy as np

from needlefit.datasets.formats import FileFormat
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.project.input_files import read_bytes
from needlefit.project.reader_process import BYTES_PER_SECOND, READER_BYTES, Arrays, read_in_process

MAX_FILE_BYTES = 64 * 2**20  # largest structure set (bytes)
STRUCTURE_SET = "1.2.840.10008.5.1.4.1.1.481.3"  # SOP class of RT structure sets
RT_PLAN = "1.2.840.10008.5.1.4.1.1.481.5"  # SOP class of RT plans, brachytherapy among them
OPEN_KINDS = ("OPEN_PLANAR", "OPEN_NONPLANAR")
_EXPECTED = "an RT structure set with open contours"
_FIX = "export the needles as open contours, from entry to tip"
_PLAN_FIX = f"{_FIX}, or the channels as a CSV file with columns channel, x, y, z"


def read_curves(path: Path) -> tuple[dict[str, Points], list[str]]:
    """Return every open contour by the name of its region, LPS, mm, and what is left out.

    DataError if the file is missing, is no structure set, or holds no open contour, or pydicom is missing.
    """
    if find_spec("pydicom") is None:
        raise DataError(
            "is a DICOM file, and pydicom, which reads it, is not installed",
            fix="pip install 'needlefit[ct]'",
            where=path,
        )
    data = read_bytes(path, MAX_FILE_BYTES)
    reader, seconds = f"{__name__}:read_contours", len(data) / BYTES_PER_SECOND
    (names, left), contours = read_in_process(reader, path, {"path": str(path)}, READER_BYTES, seconds)
    if not contours:
        raise DataError("holds no open contour", expected=_EXPECTED, fix=_FIX, where=path)
    return {name: Points(path, contours[str(n)]) for n, name in enumerate(names)}, left


def read_contours(arrays: Arrays, path: str) -> tuple[list[str], list[str]]:
    """Add an array for every open contour, in the child process; return their names, and what is left."""
    import pydicom

    names: list[str] = []
    left: list[str] = []
    file = pydicom.dcmread(BytesIO(read_bytes(Path(path), MAX_FILE_BYTES)), force=True)
    kind = file.get("SOPClassUID")
    if kind == RT_PLAN:
        raise DataError("is an RT plan, which is not read", expected=_EXPECTED, fix=_PLAN_FIX, where=path)
    if kind != STRUCTURE_SET:
        raise DataError(
            "is no RT structure set",
            expected=_EXPECTED,
            fix=f"{_FIX}; scans are read by `needlefit reconstruct`",
            where=path,
        )
    regions = {
        int(contour.ROINumber): str(contour.get("ROIName", "")) for contour in file.StructureSetROISequence
    }
    for region in file.get("ROIContourSequence") or ():
        number = int(region.ReferencedROINumber)
        name = regions.get(number, "").strip() or f"region {number}"
        for contour in region.get("ContourSequence") or ():
            kind = contour.get("ContourGeometricType")
            if kind not in OPEN_KINDS:
                left.append(f"contour of {name} ({kind})")
                continue
            arrays[str(len(names))] = np.array(list(map(float, contour.ContourData))).reshape(-1, 3)
            names.append(name)
    numbered = [name if names.count(name) == 1 else f"{name} ({n})" for n, name in enumerate(names, 1)]
    return numbered, left


RTSTRUCT = FileFormat("rtstruct", (".dcm",), read_curves, in_scan=True)
