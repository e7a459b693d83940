"""Check the header of an image file, whatever its format."""

from pathlib import Path

from needlefit.imaging.headers.metaimage import check_metaimage
from needlefit.imaging.headers.nifti import check_nifti
from needlefit.imaging.headers.nrrd import check_nrrd
from needlefit.imaging.headers.promise import ImageHeader, check_expansion


def check_image_header(path: Path) -> ImageHeader:
    """Return the header of an image file, by the ending of its name, once it is found sound.

    Its numbers must be numbers, its sizes fit what the file holds, and its voxels lie in the file itself or
    in one beside it. What it means (coordinates, segments) is left to the reader.

    Raises
    ------
    DataError
        If the file is no such image, is cut short, claims more than it can hold or than is read, or keeps its
        voxels elsewhere.
    """
    name = path.name.lower()
    if name.endswith((".nii", ".nii.gz")):
        header = check_nifti(path)
    elif name.endswith((".nrrd", ".nhdr")):
        header = check_nrrd(path)
    else:
        header = check_metaimage(path)
    check_expansion(header, path)
    return header
