"""Write volumes: NRRD, NIfTI and MetaImage files, and DICOM series as scanners write them, a file a slice."""

import hashlib
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813 - as its documentation calls it
from pydicom.uid import CTImageStorage, generate_uid

from needlefit.imaging.volume import Volume
from needlefit.project.folders import replace_file, replace_folder

DATE = "20000101"  # of every series: today's would change the bytes


def write_volume(volume: Volume, path: Path, description: str = "") -> None:
    """Write a volume, whole or not at all; the same volume gives the same bytes.

    `path`: a .nrrd, .nii, .nii.gz or .mha file, which is replaced, or a new folder for a DICOM series.
    `description`: what the volume is, e.g. that it is synthetic; stands in the file's header.

    Values are kept to the bit (DICOM: in whole HU), as int16 if that is exact, compressed unless it is .nii.
    NIfTI stores its geometry in single precision (1e-5 mm), the others in double.
    """
    if not path.suffix:
        write_series(volume, path, description)
        return
    with np.errstate(invalid="ignore"):  # what does not fit is seen by the comparison
        whole = volume.values.astype(np.int16)
    image = sitk.GetImageFromArray(whole if np.array_equal(whole, volume.values) else volume.values)
    image.SetOrigin(volume.origin.tolist())
    image.SetSpacing(volume.spacing.tolist())
    image.SetDirection(volume.direction.ravel().tolist())
    if description:
        image.SetMetaData("ITK_FileNotes" if ".nii" in path.name.lower() else "description", description)
    with replace_file(path) as fresh:
        sitk.WriteImage(image, str(fresh), useCompression=True, compressionLevel=1)


def write_series(volume: Volume, folder: Path, description: str) -> None:
    """Write a volume into the new `folder`, in whole HU; the same volume gives the same bytes.

    `description`: what the series is, e.g. that it is synthetic. ConfigError if `folder` holds something.
    """
    # Identifiers are made of the content: random ones would change the bytes.
    numbers = np.clip(np.rint(volume.values), -(2**15), 2**15 - 1).astype(np.int16)
    content = [description, hashlib.sha256(numbers.tobytes()).hexdigest()]
    content += [repr(part.tolist()) for part in (volume.origin, volume.spacing, volume.direction)]
    series = {
        "0008|0016": CTImageStorage,
        "0008|0020": DATE,
        "0008|0030": "000000",
        "0008|0060": "CT",
        "0008|103e": description[:64],
        "0010|0020": "needlefit",
        "0018|5100": "HFS",
        **{
            tag: generate_uid(entropy_srcs=[*content, tag]) for tag in ("0020|000d", "0020|000e", "0020|0052")
        },
        "0020|0037": "\\".join(f"{x:.9f}" for x in volume.direction[:, :2].T.ravel()),
        "0028|1052": "0",
        "0028|1053": "1",
        "0028|1054": "HU",
    }
    writer = sitk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    with replace_folder(folder, is_result=False) as fresh:
        for k, plane in enumerate(numbers, start=1):
            corner = volume.origin + (k - 1) * volume.spacing[2] * volume.direction[:, 2]
            place = {
                "0008|0018": generate_uid(entropy_srcs=[*content, str(k)]),
                "0020|0013": str(k),
                "0020|0032": "\\".join(f"{x:.6f}" for x in corner),
            }
            image = sitk.GetImageFromArray(plane[None])
            image.SetSpacing(volume.spacing.tolist())
            for tag, text in (series | place).items():
                image.SetMetaData(tag, text)
            writer.SetFileName(str(fresh / f"{k:05d}.dcm"))
            writer.Execute(image)
