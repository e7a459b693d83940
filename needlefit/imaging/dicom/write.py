"""A volume as a DICOM series: plain CT slices, the same bytes for the same volume."""

import hashlib
import uuid
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.uid import UID, CTImageStorage, ExplicitVRLittleEndian
from pydicom.valuerep import DSfloat

from needlefit.imaging.volume import Volume, to_patient
from needlefit.project.replace import new_folder, require_new

_LEVELS = 2**16 - 1
_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_DNS, "needlefit")


def write_series(volume: Volume, folder: Path, description: str) -> None:
    """Write `volume` as the series of a new `folder`, a slice a file.

    Its UIDs are made of its content, and it bears no date, so that the same volume gives the same bytes.

    Raises
    ------
    ConfigError
        If the folder is there and not empty: a second series in it would make both unreadable.
    """
    require_new(folder)
    numbers, slope, intercept = _whole_numbers(volume.values)
    series = _series(volume, description, slope, intercept)
    content = hashlib.sha256(series.to_json().encode())
    content.update(np.ascontiguousarray(numbers, dtype="<i2").data)
    for array in (volume.origin, volume.spacing, volume.direction):
        content.update(np.asarray(array, dtype="<f8").tobytes())
    digest = content.hexdigest()
    with new_folder(folder) as fresh:
        for k, plane in enumerate(numbers):
            file = fresh / f"{k + 1:05d}.dcm"
            corner = to_patient(volume, [[0.0, 0.0, k]])[0]
            _slice(file, series, digest, k, corner, plane).save_as(file, enforce_file_format=True)


def _whole_numbers(values: NDArray[np.float32]) -> tuple[NDArray[np.int16], float, float]:
    """Return `values` as int16, with the slope and the intercept that give them back."""
    least, most = float(values.min()), float(values.max())
    limits = np.iinfo(np.int16)
    if limits.min <= least and most <= limits.max:
        whole = values.astype(np.int16)
        if np.array_equal(whole, values):
            return whole, 1.0, 0.0
    slope = float(DSfloat((most - least) / _LEVELS, auto_format=True)) or 1.0
    intercept = float(DSfloat(least - limits.min * slope, auto_format=True))
    planes = [np.rint((plane.astype(np.float64) - intercept) / slope) for plane in values]
    return np.array([np.clip(p, limits.min, limits.max).astype(np.int16) for p in planes]), slope, intercept


def _series(volume: Volume, description: str, slope: float, intercept: float) -> Dataset:
    """Return what all slices have in common."""
    data = Dataset()
    data.SpecificCharacterSet = "ISO_IR 192"
    data.ImageType = ["DERIVED", "SECONDARY", "AXIAL"]
    data.SOPClassUID = CTImageStorage
    data.StudyDate = data.StudyTime = data.AccessionNumber = data.ReferringPhysicianName = ""
    data.Modality, data.Manufacturer, data.SeriesDescription = "CT", "needlefit", description[:64]
    data.PatientName = data.PatientID = data.StudyID = "needlefit"
    data.PatientBirthDate = data.PatientSex = data.KVP = data.AcquisitionNumber = ""
    data.SeriesNumber, data.PatientPosition, data.PositionReferenceIndicator = 1, "HFS", ""
    data.SliceThickness = _decimal(volume.spacing[2])
    data.ImageOrientationPatient = [_decimal(x) for x in volume.direction[:, :2].T.ravel()]
    data.PixelSpacing = [_decimal(volume.spacing[1]), _decimal(volume.spacing[0])]
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.Rows, data.Columns = volume.values.shape[1:]
    data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 1
    data.RescaleSlope, data.RescaleIntercept, data.RescaleType = _decimal(slope), _decimal(intercept), "HU"
    return data


def _slice(
    file: Path, series: Dataset, digest: str, k: int, corner: NDArray[np.float64], plane: NDArray[np.int16]
) -> FileDataset:
    """Return the file of slice `k`, whose first voxel stands at `corner`, LPS, mm."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = CTImageStorage
    meta.MediaStorageSOPInstanceUID = _uid(digest, f"slice {k}")
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    meta.ImplementationClassUID = _uid("", "implementation")
    meta.ImplementationVersionName = "NEEDLEFIT"
    data = FileDataset(str(file), series, file_meta=meta, preamble=b"\0" * 128)
    data.SOPInstanceUID = meta.MediaStorageSOPInstanceUID
    data.StudyInstanceUID, data.SeriesInstanceUID = _uid(digest, "study"), _uid(digest, "series")
    data.FrameOfReferenceUID = _uid(digest, "frame of reference")
    data.InstanceNumber = k + 1
    data.ImagePositionPatient = [_decimal(x) for x in corner]
    data.PixelData = plane.astype("<i2").tobytes()
    data["PixelData"].VR = "OW"
    return data


def _decimal(value: float) -> DSfloat:
    """Return `value` in the 16 characters that DICOM has for a number."""
    return DSfloat(float(value) + 0.0, auto_format=True)


def _uid(digest: str, part: str) -> UID:
    """Return the UID of a part of the series with this content."""
    return UID(f"2.25.{uuid.uuid5(_NAMESPACE, f'{digest} {part}').int}")
