"""Write a DICOM segmentation (SEG, by highdicom) of labels on the slices of a series."""

import hashlib
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import highdicom
import numpy as np
import pydicom
from highdicom.seg import SegmentAlgorithmTypeValues, Segmentation, SegmentationTypeValues, SegmentDescription
from pydicom.sr.codedict import codes
from pydicom.sr.coding import Code

from needlefit.imaging.dicom.series import find_series, make_uid
from needlefit.imaging.dicom.stack import DicomSlice, stack_slices
from needlefit.imaging.refusals import refusal
from needlefit.imaging.volume import VoxelGrid
from needlefit.project.input_files import open_regular
from needlefit.project.sandbox import SandboxArrays


def write_segmentation(
    _results: SandboxArrays, path: str, series: str | None, labels: str, names: Sequence[str], out: str
) -> None:
    """Write a DICOM-SEG of labels 1, 2, ... on the slices of a series; in the child process.

    `labels`: a .npy file with the labels (K, J, I), on the grid on which the series is read.
    """
    slices, grid = stack_slices(find_series(Path(path), series))
    values = np.load(labels)
    content = hashlib.sha256(values.tobytes())
    sources = _read_sources(slices, grid)
    for text in (*names, *(str(one.get("SOPInstanceUID")) for one in sources)):
        content.update(f"{text}\n".encode())
    digest = content.hexdigest()
    if slices[0].frame is not None:  # its frames stand in an order of their own
        values = values[np.argsort([item.frame or 0 for item in slices])]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = Segmentation(
                sources,
                values,
                SegmentationTypeValues.BINARY,
                [_describe_segment(n, name) for n, name in enumerate(names, 1)],
                make_uid(digest, "segmentation series"),
                _SERIES_NUMBER,
                make_uid(digest, "segmentation"),
                1,
                "needlefit",
                "needlefit",
                _VERSION,
                "0",
                series_description="needlefit: needle and layers",
            )
            _fix_identity(found, sources[0], digest)
            found.save_as(out)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise refusal(f"""its headers do not suffice for a DICOM segmentation: {str(error)[:200]}
                expected: slices with StudyInstanceUID, FrameOfReferenceUID and SOPInstanceUID
                fix: export the series from the archive again, or use --export scene
                where: {path}""") from error


_SERIES_NUMBER = 9000
_VERSION = "1"  # what is written as software version: another release alone must not change the bytes
# Entries that the standard lets a file leave empty, but not out.
_EMPTY_ENTRIES = (
    *("PatientID", "PatientName", "PatientBirthDate", "PatientSex", "StudyID", "StudyDate", "StudyTime"),
    *("AccessionNumber", "ReferringPhysicianName"),
)


def _read_sources(slices: Sequence[DicomSlice], grid: VoxelGrid) -> list[pydicom.Dataset]:
    """Return the headers to which the segmentation refers: of each slice, or of one enhanced file."""
    found: list[pydicom.Dataset] = []
    for file in dict.fromkeys(item.file for item in slices):
        with open_regular(file, sys.maxsize) as content:
            data = pydicom.dcmread(content, stop_before_pixels=True)
        for name in _EMPTY_ENTRIES:
            if name not in data:
                setattr(data, name, "")
        if "SliceThickness" not in data:
            data.SliceThickness = float(f"{grid.spacing[2]:.6g}")
        found.append(data)
    return found


def _describe_segment(number: int, name: str) -> SegmentDescription:
    needle = name == "needle"
    return SegmentDescription(
        number,
        name[:64],
        codes.SCT.PhysicalObject if needle else codes.SCT.Tissue,
        Code("79068005", "SCT", "Needle") if needle else codes.SCT.Tissue,
        SegmentAlgorithmTypeValues.AUTOMATIC,
        algorithm_identification=highdicom.AlgorithmIdentificationSequence(
            "needlefit", codes.DCM.ArtificialIntelligence, _VERSION
        ),
    )


def _fix_identity(data: pydicom.Dataset, source: pydicom.Dataset, digest: str) -> None:
    """Replace what differs from run to run: times, and identifiers drawn at random."""
    organization = make_uid(digest, "dimensions")
    for item in (*data.DimensionOrganizationSequence, *data.DimensionIndexSequence):
        item.DimensionOrganizationUID = organization
    for item in data.get("ContributingEquipmentSequence") or ():
        item.pop("ContributionDateTime", None)
    date = str(source.get("StudyDate") or "") or "19700101"
    for key in ("ContentDate", "SeriesDate", "InstanceCreationDate"):
        if key in data or key == "ContentDate":
            setattr(data, key, date)
    for key in ("ContentTime", "SeriesTime", "InstanceCreationTime"):
        if key in data or key == "ContentTime":
            setattr(data, key, "000000")
