"""DICOM slices made entry by entry, as a scanner would, so that a test can spoil any one of them."""

import io
from pathlib import Path

import numpy as np
import SimpleITK as sitk
from pydicom import dcmread
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

COUNT, ROWS, COLUMNS = 6, 64, 48
STEP, ROW_STEP, COLUMN_STEP = 0.9, 0.5, 0.4
ORIGIN = (-10.0, 20.0, 30.0)
SERIES, FRAME = generate_uid(entropy_srcs=["series"]), generate_uid(entropy_srcs=["frame"])
NUMBERS = np.arange(COUNT * ROWS * COLUMNS, dtype=np.int16).reshape(COUNT, ROWS, COLUMNS)


def a_slice(k, plane=None, **entries):
    """Return slice `k` of a plain axial series; `entries` replace or, with None, remove what it says."""
    plane = NUMBERS[k] if plane is None else plane
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    elements = {
        "SOPClassUID": CTImageStorage,
        "SOPInstanceUID": generate_uid(entropy_srcs=[str(k), str(entries)]),
        "SeriesInstanceUID": SERIES,
        "SeriesNumber": 3,
        "SeriesDescription": "needle",
        "FrameOfReferenceUID": FRAME,
        "Modality": "CT",
        "ImageType": ["ORIGINAL", "PRIMARY", "AXIAL"],
        "ImagePositionPatient": [ORIGIN[0], ORIGIN[1], round(ORIGIN[2] + STEP * k, 6)],
        "ImageOrientationPatient": [1, 0, 0, 0, 1, 0],
        "PixelSpacing": [ROW_STEP, COLUMN_STEP],
        "Rows": plane.shape[0],
        "Columns": plane.shape[1],
        "SamplesPerPixel": 1,
        "PhotometricInterpretation": "MONOCHROME2",
        "BitsAllocated": 16,
        "BitsStored": 16,
        "HighBit": 15,
        "PixelRepresentation": 1,
        "RescaleSlope": 1,
        "RescaleIntercept": 0,
    } | entries
    for name, value in elements.items():
        if value is not None:
            setattr(data, name, value)
    data.file_meta.MediaStorageSOPClassUID = elements["SOPClassUID"]
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID
    data.PixelData = plane.tobytes()
    data["PixelData"].VR = "OW"
    return data


def save(folder: Path, slices, order=None):
    """Write slices into `folder`; `order` gives the number in the name of each file."""
    folder.mkdir(parents=True, exist_ok=True)
    slices = list(slices)
    for number, data in zip(order or range(len(slices)), slices, strict=True):
        data.save_as(folder / f"{number:03d}.dcm", enforce_file_format=True)
    return folder


def save_volume(folder: Path, volume):
    """Write a volume of whole HU as a series."""
    first, second = volume.direction[:, :2].T.tolist()
    pages = []
    for k, plane in enumerate(volume.values.astype(np.int16)):
        corner = volume.origin + k * volume.spacing[2] * volume.direction[:, 2]
        place = {
            "ImagePositionPatient": [f"{x:.9g}" for x in corner],
            "PixelSpacing": [f"{x:.9g}" for x in volume.spacing[[1, 0]]],
        }
        axes = [f"{x:.9f}" for x in (*first, *second)]
        pages.append(a_slice(k, plane, ImageOrientationPatient=axes, **place))
    return save(folder, pages)


def series(**entries):
    return [a_slice(k, **entries) for k in range(COUNT)]


def packed_as(data, compressor, folder):
    """Return a slice whose voxels SimpleITK has compressed."""
    image = sitk.GetImageFromArray(np.frombuffer(data.PixelData, "<i2").reshape(1, data.Rows, data.Columns))
    file = str(folder / "packed.dcm")
    writer = sitk.ImageFileWriter()
    writer.SetImageIO("GDCMImageIO")
    writer.SetCompressor(compressor)
    writer.UseCompressionOn()
    writer.SetFileName(file)
    writer.Execute(image)
    packed = dcmread(io.BytesIO(Path(file).read_bytes()))
    Path(file).unlink()
    data.file_meta.TransferSyntaxUID = packed.file_meta.TransferSyntaxUID
    data["PixelData"] = packed["PixelData"]
    return data
