"""Check what an image header claims against the file size, before a native reader opens the file.

Parse and check the headers of NRRD, MetaImage and NIfTI files, before a native reader opens them.

NRRD: http://teem.sourceforge.net/nrrd/format.html. MetaImage: https://itk.org/Wiki/MetaIO/Documentation.
NIfTI, versions 1 and 2: https://nifti.nimh.nih.gov/nifti-1, nifti-2.

NRRD files of four axes, one with a single entry, hold one volume: a sequence of one.
"""

import gzip
import math
import re
import struct
import sys
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from needlefit.errors import DataError
from needlefit.imaging.volume import READABLE_VOLUMES, check_size, max_voxels
from needlefit.project.input_files import open_regular, path_exists
from needlefit.project.sandbox import MEMORY_VARIABLE, stated_memory_bytes

MAX_HEADER_BYTES = 4 * 2**20
# Longest line of a text header, but for the texts that programs add to NRRD (`key:=value`).
MAX_LINE_CHARS = 2048
MAX_NUMBER_CHARS = 64
MAX_AXES = 8
MAX_COMPONENTS = 256  # numbers of one voxel: channels of a picture
MAX_DEFLATION = 1032  # deflate makes nothing smaller than by this factor
MAX_EXPANSION = 200
# What unpacks to more than `MAX_EXPANSION` times its file may take so much memory, and no more: scans unpack
# to 2 to 5 times their file, segmentations to 20 to 200 times, a file made to fill the memory to 1000 times.
EXEMPT_BYTES = 2**30
MAX_SEGMENTS = 64  # layers of a segmentation; a volume with more labels is a scan
SEGMENTS_FIX = "name the layers from the outside inwards: FILE=segments:NAME,NAME"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf)|none", re.IGNORECASE)
_SEPARATORS = re.compile(r"[\s(),]+")


@dataclass(frozen=True)
class ImageHeader:
    """The claims of an image header: sizes and texts."""

    size: tuple[int, ...]  # voxels along each axis
    voxel_bytes: int  # size of one voxel in the file, unpacked
    packed_bytes: int  # size of the file that holds the voxels
    # What programs wrote beside what the format asks for, such as the segments of 3D Slicer.
    texts: Mapping[str, str] = field(default_factory=dict)

    @property
    def content_bytes(self) -> int:
        """Size of all voxels, unpacked."""
        return math.prod(self.size) * self.voxel_bytes

    @property
    def float_bytes(self) -> int:
        """Size of all voxels as float32."""
        return math.prod(self.size) * 4


def read_head(path: Path) -> tuple[bytes, int]:
    """Return the first bytes of a file, and the size of the whole file."""
    with open_regular(path, sys.maxsize) as file:
        return file.read(MAX_HEADER_BYTES), file.seek(0, 2)


def detached_data_size(path: Path, name: str) -> int:
    """Return the size of the separate file that holds the voxels of the header `path`.

    DataError if `name` is not the plain name of a regular file in the same folder.
    """
    plain = name.isprintable() and not any(sign in name for sign in '/\\:%"') and name not in ("", ".", "..")
    if not plain or name.split()[0].upper() == "LIST":
        raise DataError(
            "its header keeps the voxels in several files, or in another folder",
            where=str(path),
            expected="the plain name of one file in the same folder",
            fix="save the volume as one file (.nrrd, .nii.gz, .mha)",
        )
    if not path_exists(path.parent / name):
        raise DataError(
            f"its header is sound, but its voxels are not all there: there is no file {name}",
            where=str(path),
            expected="all voxels that the header promises, in this file or the one that it names",
            fix="copy the file of the voxels, too, or export the volume again",
        )
    with open_regular(path.parent / name, sys.maxsize) as file:
        return file.seek(0, 2)


def add_field(fields: dict[str, str], name: str, value: str, where: tuple[Path, int]) -> None:
    """Add a field of a text header; refuse a repeated field, or one that is too long."""
    path, line = where
    if name in fields or len(name) + len(value) > MAX_LINE_CHARS:
        what = f"`{name}` a second time" if name in fields else f"more than {MAX_LINE_CHARS} characters"
        raise unreadable_image_error(path, f"line {line} of its header holds {what}")
    fields[name] = value


def check_numbers(value: str, where: tuple[Path, int]) -> None:
    """Refuse a field that does not hold plain numbers."""
    path, line = where
    for text in filter(None, _SEPARATORS.split(value)):
        if len(text) > MAX_NUMBER_CHARS or not _NUMBER.fullmatch(text):
            raise unreadable_image_error(path, f"line {line} of its header holds what is no number")


def parse_count(text: str, least: int, greatest: int, path: Path) -> int:
    """Return a whole number of a header; refuse one outside the limits."""
    if re.fullmatch(r"-?[0-9]{1,19}", text.strip()) and least <= int(text) <= greatest:
        return int(text)
    raise unreadable_image_error(path, "a count in its header is no whole number, or claims too much")


def parse_sizes(text: str, axes: int, path: Path) -> tuple[int, ...]:
    """Return the number of voxels along each axis."""
    found = tuple(parse_count(part, 1, 2**40, path) for part in text.split())
    if len(found) != axes:
        raise unreadable_image_error(path, f"its header has {len(found)} sizes for {axes} axes")
    check_sizes(found, path)
    return found


def check_sizes(size: tuple[int, ...], path: Path) -> None:
    """Refuse more voxels than can be read."""
    if len(size) == 3:
        check_size((size[0], size[1], size[2]), str(path))
    elif math.prod(size) > max_voxels():
        raise unreadable_image_error(path, f"its header claims {math.prod(size):.3g} voxels")


def check_stored(header: ImageHeader, found: int, packing: str, path: Path) -> None:
    """Refuse a file whose bytes `found` cannot hold the voxels; `packing`: raw, text, hex, gzip or bzip2."""
    content, voxels = header.content_bytes, header.float_bytes // 4
    # a text needs one digit and one space per voxel, except after the last; hex needs two digits per byte
    least = {"raw": content, "text": 2 * voxels - 1, "hex": 2 * content, "gzip": content // MAX_DEFLATION}
    if found < least.get(packing, 1):
        raise truncated_voxels_error(path)


def check_expansion(header: ImageHeader, path: Path) -> None:
    """Refuse a small file that would fill the memory, unless the user has stated how much it may take."""
    memory = header.content_bytes + header.float_bytes
    if memory > EXEMPT_BYTES and header.content_bytes > MAX_EXPANSION * header.packed_bytes:
        if stated_memory_bytes() is not None:
            return
        raise DataError(
            f"unpacks from {header.packed_bytes / 2**20:.3g} MiB to {header.content_bytes / 2**30:.3g} GiB",
            where=str(path),
            expected=f"at most {MAX_EXPANSION} times its size, or {EXEMPT_BYTES / 2**30:.0f} GiB in memory",
            fix=f"if you trust the file, set {MEMORY_VARIABLE} to the GiB that it may take",
        )


def choose_segments(present: Sequence[str], names: Sequence[str], path: Path) -> list[int]:
    """Return the places of the segments that are named, in that order; all where none is.

    DataError if a name is not there or twice, or there are no segments or too many.
    """
    chosen = []
    for name in names:
        found = [n for n, one in enumerate(present) if one.casefold() == name.casefold()]
        if len(found) != 1:
            raise DataError(
                f"holds {len(found) or 'no'} segment{'s' * (len(found) > 1)} called {name!r}",
                where=str(path),
                expected=f"one of {', '.join(present[:MAX_SEGMENTS])}",
                fix="correct the name",
            )
        chosen += found
    chosen = chosen if names else list(range(len(present)))
    if not 1 <= len(chosen) <= MAX_SEGMENTS:
        raise DataError(
            f"holds {len(chosen)} segments",
            where=str(path),
            expected=f"1 to {MAX_SEGMENTS} layers",
            fix=SEGMENTS_FIX,
        )
    return chosen


def unreadable_image_error(path: Path, reason: str) -> DataError:
    """Return the error for a header that is not one of an image."""
    return DataError(
        f"cannot be read as a volume: {reason}",
        where=str(path),
        expected=READABLE_VOLUMES,
        fix="check that the file is whole and its name ends as its format wants; export it again",
    )


def truncated_voxels_error(path: Path) -> DataError:
    """Return the error for missing voxels."""
    return DataError(
        "its header is sound, but its voxels are damaged or not all there",
        where=str(path),
        expected="all voxels that the header promises, in this file or the one that it names",
        fix="the file is cut short or damaged: copy or export it again",
    )


NRRD_TYPES = (
    (1, "char, signed char, int8, int8_t, uchar, unsigned char, uint8, uint8_t"),
    (2, "short, short int, signed short, signed short int, int16, int16_t"),
    (2, "ushort, unsigned short, unsigned short int, uint16, uint16_t"),
    (4, "int, signed int, int32, int32_t, uint, unsigned int, uint32, uint32_t, float"),
    (8, "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t"),
    (8, "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t, double"),
)
NRRD_VOXEL_BYTES = {name: size for size, names in NRRD_TYPES for name in names.split(", ")}
NRRD_PACKINGS = {
    **{"raw": "raw", "txt": "text", "text": "text", "ascii": "text", "hex": "hex"},
    **{"gz": "gzip", "gzip": "gzip", "bz2": "bzip2", "bzip2": "bzip2"},
}
NRRD_NUMBER_FIELDS = {
    *("number", "dimension", "space dimension", "sizes", "spacings", "thicknesses", "axis mins", "axis maxs"),
    *("space directions", "min", "max", "old min", "old max", "line skip", "byte skip", "space origin"),
    "measurement frame",
}
NRRD_TEXT_FIELDS = {
    *("content", "type", "space", "centers", "kinds", "labels", "units", "endian", "encoding"),
    *("sample units", "space units", "data file"),
}
NRRD_ALIASES = {
    name.replace(" ", ""): name
    for name in ("axis mins", "axis maxs", "old min", "old max", "line skip", "byte skip", "sample units")
} | {"datafile": "data file", "centerings": "centers"}
MAX_SKIPPED_BYTES, MAX_SKIPPED_LINES = 2**40, 2**24


def check_nrrd(path: Path) -> ImageHeader:
    """Return the header of a `.nrrd` or `.nhdr` file; DataError as `check_image_header`."""
    head, size = read_head(path)
    lines, end = _nrrd_lines(path, head, size)
    fields, texts = _nrrd_fields(path, lines)
    missing = [name for name in ("type", "dimension", "sizes", "encoding") if name not in fields]
    if missing:
        raise unreadable_image_error(path, f"its header has no `{missing[0]}`")
    voxel_bytes, packing = (
        NRRD_VOXEL_BYTES.get(fields["type"].lower()),
        NRRD_PACKINGS.get(fields["encoding"].lower()),
    )
    if voxel_bytes is None or packing is None:
        raise unreadable_image_error(
            path, f"its {'encoding' if voxel_bytes else 'type'} is none that is read"
        )
    if packing == "bzip2":
        raise DataError(
            "its voxels are packed with bzip2, which is not read",
            where=str(path),
            expected="encoding: raw, text, hex or gzip",
            fix="save it again with gzip, as 3D Slicer does by default, or without compression",
        )
    axes = parse_count(fields["dimension"], 1, MAX_AXES, path)
    skip = parse_count(fields.get("byte skip", "0"), -1, MAX_SKIPPED_BYTES, path)
    parse_count(fields.get("line skip", "0"), 0, MAX_SKIPPED_LINES, path)
    counts = parse_sizes(fields["sizes"], axes, path)
    if "data file" in fields:
        size, end = detached_data_size(path, fields["data file"]), 0
    header = ImageHeader(counts, voxel_bytes, size, texts)
    check_stored(header, size - end - (max(skip, 0) if packing == "raw" else 0), packing, path)
    return header


def header_fields(path: Path) -> tuple[dict[str, str], int]:
    """Return the fields of an NRRD header, and the number of lines before its voxels."""
    head, size = read_head(path)
    lines, _ = _nrrd_lines(path, head, size)
    return _nrrd_fields(path, lines)[0], len(lines) + 2  # the first line, and the blank one


def _nrrd_lines(path: Path, head: bytes, size: int) -> tuple[list[str], int]:
    """Return the lines of the header behind the first, and where it ends: at a blank line or the end."""
    if re.match(rb"NRRD000\d\r?\n", head) is None:
        raise unreadable_image_error(path, "it does not begin as NRRD does")
    blank = re.search(rb"\n\r?\n", head)
    if blank is None and len(head) < size:
        raise unreadable_image_error(path, f"its header is longer than {MAX_HEADER_BYTES / 2**20:.0f} MiB")
    text = head[: blank.start()] if blank else head
    lines = text.decode("utf-8", "replace").split("\n")[1:]
    return [line.rstrip("\r") for line in lines], blank.end() if blank else len(head)


def _nrrd_fields(path: Path, lines: Iterable[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the fields of the format, and the texts that programs added (`key:=value`)."""
    fields: dict[str, str] = {}
    texts: dict[str, str] = {}
    for number, line in enumerate(lines, 2):
        if not line or line.startswith("#"):
            continue
        name, colon, value = line.partition(": ")
        name = NRRD_ALIASES.get(name.lower(), name.lower())
        if colon and name in NRRD_NUMBER_FIELDS | NRRD_TEXT_FIELDS:
            add_field(fields, name, value.strip(), (path, number))
            if name in NRRD_NUMBER_FIELDS:
                check_numbers(value, (path, number))
            if name == "data file" and value.split()[:1] == ["LIST"]:
                break  # what follows are names of files; `detached_data_size` refuses several
        elif ":=" in line:
            key, _, text = line.partition(":=")
            texts[key] = text
        else:
            raise unreadable_image_error(path, f"line {number} of its header is no field of NRRD")
    return fields, texts


METAIMAGE_VOXEL_BYTES = {
    **dict.fromkeys(("MET_CHAR", "MET_UCHAR"), 1),
    **dict.fromkeys(("MET_SHORT", "MET_USHORT"), 2),
    **dict.fromkeys(("MET_INT", "MET_UINT", "MET_LONG", "MET_ULONG", "MET_FLOAT"), 4),
    **dict.fromkeys(("MET_LONG_LONG", "MET_ULONG_LONG", "MET_DOUBLE"), 8),
}
METAIMAGE_NUMBER_FIELDS = {
    *("NDims", "DimSize", "TransformMatrix", "Rotation", "Orientation", "Offset", "Position", "Origin"),
    *("CenterOfRotation", "ElementSpacing", "ElementSize", "HeaderSize", "CompressedDataSize", "ID"),
    *("ParentID", "ElementNumberOfChannels", "ElementMin", "ElementMax", "Color", "SequenceID"),
}
METAIMAGE_REQUIRED_FIELDS = ("NDims", "DimSize", "ElementType", "ElementDataFile")
MAX_FILE_BYTES = 2**40


def check_metaimage(path: Path) -> ImageHeader:
    """Return the header of a `.mha` or `.mhd` file; DataError as `check_image_header`."""
    head, size = read_head(path)
    fields, end = _metaimage_fields(path, head)
    missing = [name for name in METAIMAGE_REQUIRED_FIELDS if name not in fields]
    if missing:
        raise unreadable_image_error(path, f"its header has no `{missing[0]}`")
    if fields.get("ObjectType", "Image") != "Image" or fields["ElementType"] not in METAIMAGE_VOXEL_BYTES:
        raise unreadable_image_error(path, "its ObjectType or ElementType is none of an image")
    axes = parse_count(fields["NDims"], 1, MAX_AXES, path)
    components = parse_count(fields.get("ElementNumberOfChannels", "1"), 1, MAX_COMPONENTS, path)
    skip = parse_count(fields.get("HeaderSize", "0"), -1, MAX_FILE_BYTES, path)
    parse_count(fields.get("CompressedDataSize", "0"), 0, MAX_FILE_BYTES, path)
    counts = parse_sizes(fields["DimSize"], axes, path)
    if fields["ElementDataFile"].upper() != "LOCAL":
        size, end = detached_data_size(path, fields["ElementDataFile"]), max(skip, 0)
    header = ImageHeader(counts, METAIMAGE_VOXEL_BYTES[fields["ElementType"]] * components, size, fields)
    check_stored(header, size - end, _metaimage_packing(fields), path)
    return header


def _metaimage_fields(path: Path, head: bytes) -> tuple[dict[str, str], int]:
    """Return the fields up to ElementDataFile, the last one, and where the voxels begin behind it."""
    fields: dict[str, str] = {}
    end, number = 0, 0
    while "ElementDataFile" not in fields and end < len(head):
        number += 1
        begin, end = end, head.find(b"\n", end, end + MAX_LINE_CHARS) + 1
        if not end and len(head) - begin > MAX_LINE_CHARS:
            raise unreadable_image_error(
                path, f"line {number} of its header is longer than {MAX_LINE_CHARS} characters"
            )
        end = end or len(head)
        line = head[begin:end].decode("utf-8", "replace").strip()
        name, sign, value = (part.strip() for part in line.partition("="))
        if not line:
            continue
        if not sign:
            raise unreadable_image_error(path, f"line {number} of its header is no field of MetaImage")
        add_field(fields, name, value, (path, number))
        if name in METAIMAGE_NUMBER_FIELDS:
            check_numbers(value, (path, number))
    return fields, end


def _metaimage_packing(fields: Mapping[str, str]) -> str:
    if _is_true(fields.get("CompressedData", "")):
        return "gzip"
    return "raw" if _is_true(fields.get("BinaryData", "True")) else "text"


def _is_true(text: str) -> bool:
    return text[:1] in ("T", "t", "1")


MAX_NIFTI_OFFSET_BYTES = 64 * 2**20  # where the voxels begin: extensions may stand before them
NIFTI_VOXEL_BITS = {
    **{2: 8, 4: 16, 8: 32, 16: 32, 32: 64, 64: 64, 128: 24, 256: 8, 512: 16, 768: 32, 1024: 64},
    **{1280: 64, 1536: 128, 1792: 128, 2048: 256, 2304: 32},
}


@dataclass(frozen=True)
class _NiftiLayout:
    """Where a version of the format has its entries: places, and forms as of `struct`."""

    signature: tuple[int, bytes]
    sizes: tuple[int, str]
    type: int
    start: tuple[int, str]


# By the size of the header, which stands first.
NIFTI_LAYOUTS = {
    348: _NiftiLayout((344, b"n+1\0"), (40, "8h"), 70, (108, "f")),
    540: _NiftiLayout((4, b"n+2\0\r\n\x1a\n"), (16, "8q"), 12, (168, "q")),
}


def check_nifti(path: Path) -> ImageHeader:
    """Return the header of a `.nii` or `.nii.gz` file; DataError as `check_image_header`."""
    packed = path.name.lower().endswith(".gz")
    head, size = _nifti_head(path, packed)
    # the header begins with its own size: 348 or 540 in the right byte order
    order = "<" if int.from_bytes(head[:4], "little") in NIFTI_LAYOUTS else ">"
    layout = NIFTI_LAYOUTS.get(struct.unpack_from(f"{order}i", head)[0]) if head else None
    if layout is None or not head.startswith(layout.signature[1], layout.signature[0]):
        raise unreadable_image_error(path, "it does not begin as a NIfTI file that holds its own voxels does")
    axes, *counts = struct.unpack_from(order + layout.sizes[1], head, layout.sizes[0])
    kind, bits = struct.unpack_from(f"{order}2h", head, layout.type)
    (start,) = struct.unpack_from(order + layout.start[1], head, layout.start[0])
    if not 1 <= axes <= 7 or min(counts[:axes]) < 1:
        raise unreadable_image_error(path, "its header has no sizes")
    if NIFTI_VOXEL_BITS.get(kind) != bits:
        raise unreadable_image_error(path, "its header has no type of numbers, or two")
    if not 0 <= start <= MAX_NIFTI_OFFSET_BYTES:  # NaN is neither
        raise unreadable_image_error(path, "its header does not say where its voxels begin")
    check_sizes(tuple(counts[:axes]), path)
    header = ImageHeader(tuple(counts[:axes]), bits // 8, size)
    check_stored(header, size if packed else size - int(start), "gzip" if packed else "raw", path)
    return header


def _nifti_head(path: Path, packed: bool) -> tuple[bytes, int]:
    """Return the first bytes, unpacked, none if there is no header, and the size of the file."""
    with open_regular(path, sys.maxsize) as file:
        try:
            head = (gzip.GzipFile(fileobj=file) if packed else file).read(max(NIFTI_LAYOUTS))
        except (EOFError, OSError, zlib.error):
            raise unreadable_image_error(path, "it is no gzip file, or damaged at its beginning") from None
        size = file.seek(0, 2)
    return head.ljust(max(NIFTI_LAYOUTS), b"\0") if len(head) >= min(NIFTI_LAYOUTS) else b"", size


NRRD_AXES_OF_SINGLE_VOLUME = 4
_AXIS_STEP = re.compile(r"none|\([^)]*\)", re.IGNORECASE)


def single_volume_header(path: Path) -> str:
    """Return a detached header (`.nhdr`) for a file of one volume, its fourth axis marked as a list.

    SimpleITK reads a list of one as a volume, and refuses an axis of another kind, or of none. Empty where
    the file has other axes than three of space and one of a single entry.
    """
    fields, header_lines = header_fields(path)
    steps, counts = _AXIS_STEP.findall(fields.get("space directions", "")), fields.get("sizes", "").split()
    outside = [n for n, step in enumerate(steps) if step.lower() == "none"]
    if (
        len(counts) != NRRD_AXES_OF_SINGLE_VOLUME
        or len(steps) != NRRD_AXES_OF_SINGLE_VOLUME
        or len(outside) != 1
        or counts[outside[0]] != "1"
    ):
        return ""
    beside = fields.pop("data file", "")
    file = str((path.parent / beside if beside else path).resolve())
    if not file.isprintable() or "%" in file or (not beside and "line skip" in fields):
        return ""  # a header cannot name such a file
    if not beside:
        fields["line skip"] = str(header_lines)
    fields["kinds"] = " ".join(
        "list" if n == outside[0] else "domain" for n in range(NRRD_AXES_OF_SINGLE_VOLUME)
    )
    lines = [f"{name}: {value}" for name, value in fields.items()]
    return "\n".join(["NRRD0005", *lines, f"data file: {file}", ""])


def check_image_header(path: Path) -> ImageHeader:
    """Check the header of an image file by the ending of its name, and return it.

    Its numbers must be numbers, its sizes fit what the file holds, and its voxels lie in the file itself or
    in one beside it. What it means (coordinates, segments) is left to the reader.

    DataError if the file is no such image, is cut short, claims more than it can hold or than is read, or
    keeps its voxels elsewhere.
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
