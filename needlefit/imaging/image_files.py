"""Read NRRD and MetaImage files by SimpleITK, which works in LPS."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK as sitk

from needlefit.errors import located, refusal
from needlefit.imaging.volume import (
    VoxelGrid,
    check_expansion,
    check_grid,
    fill_unknown,
    grid_to_json,
    missing_voxels,
    not_one_volume,
    orthogonalize,
    unreadable_header,
)
from needlefit.project.reader_process import Arrays, allow_memory

IMAGE_IOS = {".nrrd": "NrrdImageIO", ".nhdr": "NrrdImageIO", ".mha": "MetaImageIO", ".mhd": "MetaImageIO"}
# What states where voxels stand, by the end of a file's name: the spellings of each key; SimpleITK makes up
# what is not stated.
_NRRD_KEYS = (("space directions",), ("space origin",))
_META_KEYS = (
    ("ElementSpacing", "ElementSize"),
    ("Offset", "Position", "Origin"),
    ("TransformMatrix", "Rotation", "Orientation"),
)
PLACE_KEYS = {".nrrd": _NRRD_KEYS, ".nhdr": _NRRD_KEYS, ".mha": _META_KEYS, ".mhd": _META_KEYS}
MAX_HEADER_BYTES = 2**20
_COMPLEX = (sitk.sitkComplexFloat32, sitk.sitkComplexFloat64)

sitk.ProcessObject.SetGlobalWarningDisplay(False)  # errors are reported once, by our own messages


def read_image(arrays: Arrays, path: str, stored: int, labels: bool = False) -> dict[str, Any]:
    """Read an NRRD or MetaImage file: add the array "values"; return its grid, warnings, and segments' texts.

    `stored`: bytes of the file, with that of its voxels.
    `labels`: whether the file holds labels.

    DataError if the file is none, is cut short, has not three dimensions, does not say in which coordinate
    system it stands, or claims an absurd size.
    """
    notes: list[str] = []
    with located(path):
        reader = sitk.ImageFileReader()
        reader.SetImageIO(IMAGE_IOS[Path(path).suffix.lower()])
        reader.SetFileName(path)
        try:
            reader.ReadImageInformation()
        except RuntimeError as error:
            if "number of domain axes" in str(error):
                raise not_one_volume("more than three dimensions") from error
            raise unreadable_header(_last_line(error)) from error
        bits = re.search(r"(\d+)-bit", sitk.GetPixelIDValueAsString(reader.GetPixelID()))
        parts = 2 if reader.GetPixelID() in _COMPLEX else reader.GetNumberOfComponents()
        if reader.GetDimension() != 3 or bits is None or parts != 1:
            size = " x ".join(map(str, reader.GetSize()))
            if labels and parts != 1:
                raise refusal(f"""its segments overlap, or once did: they lie in {parts} layers
                    expected: every voxel in one layer
                    fix: in the Segment Editor set "Modify other segments" to "Overwrite all", collapse the
                        layers of the segmentation, and save it again""")
            raise not_one_volume(f"{size} voxels of {parts} number{'s' * (parts > 1)}")
        _require_place(Path(path))
        columns, rows, slices = reader.GetSize()
        origin, spacing, direction = map(
            np.array, (reader.GetOrigin(), reader.GetSpacing(), reader.GetDirection())
        )
        grid = VoxelGrid((columns, rows, slices), origin, spacing, direction.reshape(3, 3))
        check_grid(grid)
        content, memory = (math.prod(grid.size) * size for size in (int(bits[1]) // 8, 4))
        check_expansion(content, memory, stored)
        texts = {key: reader.GetMetaData(key) for key in reader.GetMetaDataKeys()}
        space = texts.get("NRRD_space", "")  # where there is none SimpleITK makes up the patient's left
        # MetaImage is LPS by its definition
        if reader.GetImageIO() == "NrrdImageIO" and space != "left-posterior-superior":
            stated = f"its space is {space}, which does not describe the patient"
            raise refusal(f"""{stated if space else "does not state its space"}
                expected: `space: left-posterior-superior` or another anatomical one in the header
                fix: export it from a program that knows the patient's axes, such as 3D Slicer""")
        allow_memory(2 * (content + memory) + stored)  # a buffer, one to convert into
        try:
            image = reader.Execute()
        except RuntimeError as error:
            raise missing_voxels(f" ({_last_line(error)})") from error
        # SimpleITK's arrays are indexed k, j, i: the reverse of its sizes
        values = sitk.GetArrayViewFromImage(image).astype(np.float32)
        fill_unknown(values, notes, labels=labels)
    arrays["values"] = values
    grid = replace(grid, direction=orthogonalize(grid.direction))
    segments = {key: text for key, text in texts.items() if re.fullmatch(r"Segment\d{1,4}_\w+", key)}
    return {**grid_to_json(grid), "texts": segments, "warnings": notes}


def _require_place(path: Path) -> None:
    """DataError if the header of a file does not state where its voxels stand."""
    keys = _read_keys(path)
    lacking = [names[0] for names in PLACE_KEYS[path.suffix.lower()] if not {*names} & keys]
    if lacking:
        raise refusal(f"""does not state where its voxels stand: {", ".join(lacking)} missing in the header
            expected: spacing (mm), place and axes of the voxels
            fix: export it again from a program that knows them; or write what was measured into the header
                ({", ".join(f"`{name}`" for name in lacking)})""")


def _read_keys(path: Path) -> set[str]:
    """Return the keys of the header of an NRRD or MetaImage file."""
    with path.open("rb") as file:
        lines = file.read(MAX_HEADER_BYTES).split(b"\n")
    separator, keys = ("=" if path.suffix.lower() in (".mha", ".mhd") else ":"), set[str]()
    for line in lines:
        key, found, _ = line.decode("latin-1").partition(separator)
        keys.add(key.strip())
        # voxels may follow: behind an empty line, or behind the key of their place
        if key.strip() == "ElementDataFile" or not (found or line.startswith((b"#", b"NRRD"))):
            break
    return keys


def _last_line(error: Exception) -> str:
    """Return the last line of an error of SimpleITK, which names the cause, without addresses of memory."""
    return re.sub(r"\w+\(0x[0-9a-f]+\): ", "", str(error).strip().splitlines()[-1])[:200]
