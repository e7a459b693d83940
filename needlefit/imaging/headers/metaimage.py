"""MetaImage headers (https://itk.org/Wiki/MetaIO/Documentation)."""

from collections.abc import Mapping
from pathlib import Path

from needlefit.imaging.headers.promise import (
    MAX_AXES,
    MAX_COMPONENTS,
    MAX_LINE_CHARS,
    ImageHeader,
    check_numbers,
    check_stored,
    head_of,
    no_image,
    put,
    size_beside,
    sizes,
    whole,
)

VOXEL_BYTES = {
    **dict.fromkeys(("MET_CHAR", "MET_UCHAR"), 1),
    **dict.fromkeys(("MET_SHORT", "MET_USHORT"), 2),
    **dict.fromkeys(("MET_INT", "MET_UINT", "MET_LONG", "MET_ULONG", "MET_FLOAT"), 4),
    **dict.fromkeys(("MET_LONG_LONG", "MET_ULONG_LONG", "MET_DOUBLE"), 8),
}
NUMBERS = {
    *("NDims", "DimSize", "TransformMatrix", "Rotation", "Orientation", "Offset", "Position", "Origin"),
    *("CenterOfRotation", "ElementSpacing", "ElementSize", "HeaderSize", "CompressedDataSize", "ID"),
    *("ParentID", "ElementNumberOfChannels", "ElementMin", "ElementMax", "Color", "SequenceID"),
}
REQUIRED = ("NDims", "DimSize", "ElementType", "ElementDataFile")
MAX_FILE_BYTES = 2**40


def check_metaimage(path: Path) -> ImageHeader:
    """Return the header of a `.mha` or `.mhd` file; DataError as `check_image_header`."""
    head, size = head_of(path)
    fields, end = _fields(path, head)
    missing = [name for name in REQUIRED if name not in fields]
    if missing:
        raise no_image(path, f"its header has no `{missing[0]}`")
    if fields.get("ObjectType", "Image") != "Image" or fields["ElementType"] not in VOXEL_BYTES:
        raise no_image(path, "its ObjectType or ElementType is none of an image")
    axes = whole(fields["NDims"], 1, MAX_AXES, path)
    components = whole(fields.get("ElementNumberOfChannels", "1"), 1, MAX_COMPONENTS, path)
    skip = whole(fields.get("HeaderSize", "0"), -1, MAX_FILE_BYTES, path)
    whole(fields.get("CompressedDataSize", "0"), 0, MAX_FILE_BYTES, path)
    counts = sizes(fields["DimSize"], axes, path)
    if fields["ElementDataFile"].upper() != "LOCAL":
        size, end = size_beside(path, fields["ElementDataFile"]), max(skip, 0)
    header = ImageHeader(counts, VOXEL_BYTES[fields["ElementType"]] * components, size, fields)
    check_stored(header, size - end, _packing(fields), path)
    return header


def _fields(path: Path, head: bytes) -> tuple[dict[str, str], int]:
    """Return the fields up to ElementDataFile, the last one, and where the voxels begin behind it."""
    fields: dict[str, str] = {}
    end, number = 0, 0
    while "ElementDataFile" not in fields and end < len(head):
        number += 1
        begin, end = end, head.find(b"\n", end, end + MAX_LINE_CHARS) + 1
        if not end and len(head) - begin > MAX_LINE_CHARS:
            raise no_image(path, f"line {number} of its header is longer than {MAX_LINE_CHARS} characters")
        end = end or len(head)
        line = head[begin:end].decode("utf-8", "replace").strip()
        name, sign, value = (part.strip() for part in line.partition("="))
        if not line:
            continue
        if not sign:
            raise no_image(path, f"line {number} of its header is no field of MetaImage")
        put(fields, name, value, (path, number))
        if name in NUMBERS:
            check_numbers(value, (path, number))
    return fields, end


def _packing(fields: Mapping[str, str]) -> str:
    if _true(fields.get("CompressedData", "")):
        return "gzip"
    return "raw" if _true(fields.get("BinaryData", "True")) else "text"


def _true(text: str) -> bool:
    return text[:1] in ("T", "t", "1")
