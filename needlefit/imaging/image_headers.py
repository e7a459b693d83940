"""Check what the headers of NRRD, MetaImage and NIfTI files claim, before a native reader opens the files.

NRRD: http://teem.sourceforge.net/nrrd/format.html. MetaImage: https://itk.org/Wiki/MetaIO/Documentation.
NIfTI, versions 1 and 2: https://nifti.nimh.nih.gov/nifti-1, nifti-2.
"""

import gzip
import math
import re
import struct
import sys
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from needlefit.errors import DataError
from needlefit.imaging.refusals import located, refusal
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
# What unpacks to more than `MAX_EXPANSION` times its file may take `EXEMPT_BYTES` of memory, and no more:
# scans unpack to 2 to 5 times their file, segmentations to 20 to 200 times, a file made to fill the memory to
# 1000 times.
MAX_EXPANSION, EXEMPT_BYTES = 200, 2**30
MAX_SEGMENTS = 64  # layers of a segmentation; a volume with more labels is a scan
SEGMENTS_FIX = "name the layers from the outside inwards: FILE=segments:NAME,NAME"
MAX_FILE_BYTES, MAX_SKIPPED_LINES = 2**40, 2**24

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


def check_image_header(path: Path) -> ImageHeader:
    """Check the header of an image file by the ending of its name, and return it.

    Its numbers must be numbers, its sizes fit what the file holds, and its voxels lie in the file itself or
    in one beside it. What it means (coordinates, segments) is left to the reader.

    DataError if the file is no such image, is cut short, claims more than it can hold or than is read, or
    keeps its voxels elsewhere.
    """
    name = path.name.lower()
    with located(path):
        if name.endswith((".nii", ".nii.gz")):
            header = check_nifti(path)
        else:
            header = (check_nrrd if name.endswith((".nrrd", ".nhdr")) else check_metaimage)(path)
        check_expansion(header)
    return header


def check_expansion(header: ImageHeader) -> None:
    """Refuse a small file that would fill the memory, unless the user has stated how much it may take."""
    large = header.content_bytes + header.float_bytes > EXEMPT_BYTES
    if large and header.content_bytes > MAX_EXPANSION * header.packed_bytes and stated_memory_bytes() is None:
        raise refusal(f"""unpacks from {header.packed_bytes / 2**20:.3g} MiB to
                {header.content_bytes / 2**30:.3g} GiB
            expected: at most {MAX_EXPANSION} times its size, or {EXEMPT_BYTES / 2**30:.0f} GiB in memory
            fix: if you trust the file, set {MEMORY_VARIABLE} to the GiB that it may take""")


def choose_segments(present: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return the places of the segments that are named, in that order; all where none is.

    DataError if a name is not there or twice, or there are no segments or too many.
    """
    chosen = [] if names else list(range(len(present)))
    for name in names:
        found = [n for n, one in enumerate(present) if one.casefold() == name.casefold()]
        if len(found) != 1:
            raise refusal(f"""holds {len(found) or "no"} segment{"s" * (len(found) > 1)} called {name!r}
                expected: one of {", ".join(present[:MAX_SEGMENTS])}
                fix: correct the name""")
        chosen += found
    if not 1 <= len(chosen) <= MAX_SEGMENTS:
        raise refusal(f"""holds {len(chosen)} segments
            expected: 1 to {MAX_SEGMENTS} layers
            fix: {SEGMENTS_FIX}""")
    return chosen


def unreadable_image(reason: str) -> DataError:
    """Return the error for a header that is not one of an image."""
    return refusal(f"""cannot be read as a volume: {reason}
        expected: {READABLE_VOLUMES}
        fix: check that the file is whole and its name ends as its format wants; export it again""")


def missing_voxels(
    what: str = "its voxels are damaged or not all there",
    fix: str = "the file is cut short or damaged: copy or export it again",
) -> DataError:
    """Return the error for voxels that a header promises."""
    return refusal(f"""its header is sound, but {what}
        expected: all voxels that the header promises, in this file or the one that it names
        fix: {fix}""")


def parse_count(text: str, least: int, greatest: int) -> int:
    """Return a whole number of a header; refuse one outside the limits."""
    if re.fullmatch(r"-?[0-9]{1,19}", text.strip()) and least <= int(text) <= greatest:
        return int(text)
    raise unreadable_image("a count in its header is no whole number, or claims too much")


def _require_fields(fields: Mapping[str, str], names: Sequence[str]) -> None:
    for name in names:
        if name not in fields:
            raise unreadable_image(f"its header has no `{name}`")


def _parse_sizes(text: str, axes: int) -> tuple[int, ...]:
    found = tuple(parse_count(part, 1, 2**40) for part in text.split())
    if len(found) != axes:
        raise unreadable_image(f"its header has {len(found)} sizes for {axes} axes")
    _check_sizes(found)
    return found


def _check_sizes(size: tuple[int, ...]) -> None:
    """Refuse more voxels than can be read."""
    if len(size) == 3:
        check_size((size[0], size[1], size[2]))
    elif math.prod(size) > max_voxels():
        raise unreadable_image(f"its header claims {math.prod(size):.3g} voxels")


def _check_stored(header: ImageHeader, found: int, packing: str) -> None:
    """Refuse a file whose bytes `found` cannot hold the voxels; `packing`: raw, text, hex, gzip or bzip2."""
    content, voxels = header.content_bytes, header.float_bytes // 4
    # a text needs one digit and one space per voxel, except after the last; hex needs two digits per byte
    least = {"raw": content, "text": 2 * voxels - 1, "hex": 2 * content, "gzip": content // MAX_DEFLATION}
    if found < least.get(packing, 1):
        raise missing_voxels()


def _read_head(path: Path) -> tuple[bytes, int]:
    """Return the first bytes of a file, and the size of the whole file."""
    with open_regular(path, sys.maxsize) as file:
        return file.read(MAX_HEADER_BYTES), file.seek(0, 2)


def _detached_data_size(path: Path, name: str) -> int:
    """Return the size of the separate file, beside the header `path`, that holds the voxels."""
    plain = name.isprintable() and not any(sign in name for sign in '/\\:%"') and name not in ("", ".", "..")
    if not plain or name.split()[0].upper() == "LIST":
        raise refusal("""its header keeps the voxels in several files, or in another folder
            expected: the plain name of one file in the same folder
            fix: save the volume as one file (.nrrd, .nii.gz, .mha)""")
    if not path_exists(path.parent / name):
        raise missing_voxels(
            f"its voxels are not all there: there is no file {name}",
            "copy the file of the voxels, too, or export the volume again",
        )
    with open_regular(path.parent / name, sys.maxsize) as file:
        return file.seek(0, 2)


def _add_field(fields: dict[str, str], name: str, value: str, line: int, numbers: set[str]) -> None:
    """Add a field of a text header; refuse one that is there, is too long, or holds no plain numbers."""
    if name in fields or len(name) + len(value) > MAX_LINE_CHARS:
        what = f"`{name}` a second time" if name in fields else f"more than {MAX_LINE_CHARS} characters"
        raise unreadable_image(f"line {line} of its header holds {what}")
    fields[name] = value
    for text in filter(None, _SEPARATORS.split(value) if name in numbers else ()):
        if len(text) > MAX_NUMBER_CHARS or not _NUMBER.fullmatch(text):
            raise unreadable_image(f"line {line} of its header holds what is no number")


_NRRD_TYPES = {
    "char, signed char, int8, int8_t, uchar, unsigned char, uint8, uint8_t": 1,
    "short, short int, signed short, signed short int, int16, int16_t": 2,
    "ushort, unsigned short, unsigned short int, uint16, uint16_t": 2,
    "int, signed int, int32, int32_t, uint, unsigned int, uint32, uint32_t, float": 4,
    "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t": 8,
    "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t, double": 8,
}
NRRD_VOXEL_BYTES = {name: size for names, size in _NRRD_TYPES.items() for name in names.split(", ")}
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


def check_nrrd(path: Path) -> ImageHeader:
    """Return the header of a `.nrrd` or `.nhdr` file; DataError as `check_image_header`."""
    fields, texts, _, end, size = _read_nrrd(path)
    _require_fields(fields, ("type", "dimension", "sizes", "encoding"))
    voxel_bytes = NRRD_VOXEL_BYTES.get(fields["type"].lower())
    packing = NRRD_PACKINGS.get(fields["encoding"].lower())
    if voxel_bytes is None or packing is None:
        raise unreadable_image(f"its {'encoding' if voxel_bytes else 'type'} is none that is read")
    if packing == "bzip2":
        raise refusal("""its voxels are packed with bzip2, which is not read
            expected: encoding: raw, text, hex or gzip
            fix: save it again with gzip, as 3D Slicer does by default, or without compression""")
    axes = parse_count(fields["dimension"], 1, MAX_AXES)
    skip = parse_count(fields.get("byte skip", "0"), -1, MAX_FILE_BYTES)
    parse_count(fields.get("line skip", "0"), 0, MAX_SKIPPED_LINES)
    counts = _parse_sizes(fields["sizes"], axes)
    if "data file" in fields:
        size, end = _detached_data_size(path, fields["data file"]), 0
    header = ImageHeader(counts, voxel_bytes, size, texts)
    _check_stored(header, size - end - (max(skip, 0) if packing == "raw" else 0), packing)
    return header


def _read_nrrd(path: Path) -> tuple[dict[str, str], dict[str, str], int, int, int]:
    """Return the fields of the format, the texts that programs added (`key:=value`), and three numbers.

    These are the lines before the voxels, and the bytes before them and of the file. The header ends at a
    blank line, or with the file.
    """
    head, size = _read_head(path)
    if re.match(rb"NRRD000\d\r?\n", head) is None:
        raise unreadable_image("it does not begin as NRRD does")
    blank = re.search(rb"\n\r?\n", head)
    if blank is None and len(head) < size:
        raise unreadable_image(f"its header is longer than {MAX_HEADER_BYTES / 2**20:.0f} MiB")
    lines = (head[: blank.start()] if blank else head).decode("utf-8", "replace").split("\n")
    fields: dict[str, str] = {}
    texts: dict[str, str] = {}
    for number, line in enumerate((line.rstrip("\r") for line in lines[1:]), 2):
        if not line or line.startswith("#"):
            continue
        name, colon, value = line.partition(": ")
        name = NRRD_ALIASES.get(name.lower(), name.lower())
        if colon and name in NRRD_NUMBER_FIELDS | NRRD_TEXT_FIELDS:
            _add_field(fields, name, value.strip(), number, NRRD_NUMBER_FIELDS)
            if name == "data file" and value.split()[:1] == ["LIST"]:
                break  # what follows are names of files; `_detached_data_size` refuses several
        elif ":=" in line:
            key, _, text = line.partition(":=")
            texts[key] = text
        else:
            raise unreadable_image(f"line {number} of its header is no field of NRRD")
    return fields, texts, len(lines) + 1, blank.end() if blank else len(head), size


NRRD_AXES_OF_SINGLE_VOLUME = 4
_AXIS_STEP = re.compile(r"none|\([^)]*\)", re.IGNORECASE)


def single_volume_header(path: Path) -> str:
    """Return a detached header (`.nhdr`) for a file of one volume, its fourth axis marked as a list.

    SimpleITK reads a list of one as a volume, and refuses an axis of another kind, or of none. Empty where
    the file has other axes than three of space and one of a single entry.
    """
    fields, _, header_lines, _, _ = _read_nrrd(path)
    steps, counts = _AXIS_STEP.findall(fields.get("space directions", "")), fields.get("sizes", "").split()
    outside = [n for n, step in enumerate(steps) if step.lower() == "none"]
    if not len(counts) == len(steps) == NRRD_AXES_OF_SINGLE_VOLUME or len(outside) != 1:
        return ""
    beside = fields.pop("data file", "")
    file = str((path.parent / beside if beside else path).resolve())
    named = file.isprintable() and "%" not in file and (beside or "line skip" not in fields)
    if counts[outside[0]] != "1" or not named:  # a header cannot name every file
        return ""
    if not beside:
        fields["line skip"] = str(header_lines)
    fields["kinds"] = " ".join("list" if n == outside[0] else "domain" for n in range(len(counts)))
    lines = [f"{name}: {value}" for name, value in fields.items()]
    return "\n".join(["NRRD0005", *lines, f"data file: {file}", ""])


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


def check_metaimage(path: Path) -> ImageHeader:
    """Return the header of a `.mha` or `.mhd` file; DataError as `check_image_header`."""
    head, size = _read_head(path)
    fields: dict[str, str] = {}
    end, number = 0, 0
    while "ElementDataFile" not in fields and end < len(head):
        number += 1
        begin, end = end, head.find(b"\n", end, end + MAX_LINE_CHARS) + 1
        if not end and len(head) - begin > MAX_LINE_CHARS:
            raise unreadable_image(f"line {number} of its header is longer than {MAX_LINE_CHARS} characters")
        end = end or len(head)
        line = head[begin:end].decode("utf-8", "replace").strip()
        name, sign, value = (part.strip() for part in line.partition("="))
        if line and not sign:
            raise unreadable_image(f"line {number} of its header is no field of MetaImage")
        if line:
            _add_field(fields, name, value, number, METAIMAGE_NUMBER_FIELDS)
    _require_fields(fields, ("NDims", "DimSize", "ElementType", "ElementDataFile"))
    if fields.get("ObjectType", "Image") != "Image" or fields["ElementType"] not in METAIMAGE_VOXEL_BYTES:
        raise unreadable_image("its ObjectType or ElementType is none of an image")
    axes = parse_count(fields["NDims"], 1, MAX_AXES)
    components = parse_count(fields.get("ElementNumberOfChannels", "1"), 1, MAX_COMPONENTS)
    skip = parse_count(fields.get("HeaderSize", "0"), -1, MAX_FILE_BYTES)
    parse_count(fields.get("CompressedDataSize", "0"), 0, MAX_FILE_BYTES)
    counts = _parse_sizes(fields["DimSize"], axes)
    if fields["ElementDataFile"].upper() != "LOCAL":
        size, end = _detached_data_size(path, fields["ElementDataFile"]), max(skip, 0)
    header = ImageHeader(counts, METAIMAGE_VOXEL_BYTES[fields["ElementType"]] * components, size, fields)
    plain = "raw" if _is_true(fields.get("BinaryData", "True")) else "text"
    _check_stored(header, size - end, "gzip" if _is_true(fields.get("CompressedData", "")) else plain)
    return header


def _is_true(text: str) -> bool:
    return text[:1] in ("T", "t", "1")


MAX_NIFTI_OFFSET_BYTES = 64 * 2**20  # where the voxels begin: extensions may stand before them
NIFTI_VOXEL_BITS = {
    **{2: 8, 4: 16, 8: 32, 16: 32, 32: 64, 64: 64, 128: 24, 256: 8, 512: 16, 768: 32, 1024: 64},
    **{1280: 64, 1536: 128, 1792: 128, 2048: 256, 2304: 32},
}
# By the size of the header, which stands first: the signature and its place, then place and form, as of
# `struct`, of the sizes, of the type of numbers, and of where the voxels begin.
NIFTI_LAYOUTS = {
    348: ((344, b"n+1\0"), (40, "8h"), (70, "2h"), (108, "f")),
    540: ((4, b"n+2\0\r\n\x1a\n"), (16, "8q"), (12, "2h"), (168, "q")),
}


def check_nifti(path: Path) -> ImageHeader:
    """Return the header of a `.nii` or `.nii.gz` file; DataError as `check_image_header`."""
    packed = path.name.lower().endswith(".gz")
    with open_regular(path, sys.maxsize) as file:
        try:
            head = (gzip.GzipFile(fileobj=file) if packed else file).read(max(NIFTI_LAYOUTS))
        except (EOFError, OSError, zlib.error):
            raise unreadable_image("it is no gzip file, or damaged at its beginning") from None
        size = file.seek(0, 2)
    head = head.ljust(max(NIFTI_LAYOUTS), b"\0") if len(head) >= min(NIFTI_LAYOUTS) else b""
    # the header begins with its own size: 348 or 540 in the right byte order
    order = "<" if int.from_bytes(head[:4], "little") in NIFTI_LAYOUTS else ">"
    layout = NIFTI_LAYOUTS.get(struct.unpack_from(f"{order}i", head)[0]) if head else None
    if layout is None or not head.startswith(layout[0][1], layout[0][0]):
        raise unreadable_image("it does not begin as a NIfTI file that holds its own voxels does")
    (axes, *counts), (kind, bits), (start,) = (
        struct.unpack_from(order + form, head, place) for place, form in layout[1:]
    )
    if not 1 <= axes <= 7 or min(counts[:axes]) < 1:
        raise unreadable_image("its header has no sizes")
    if NIFTI_VOXEL_BITS.get(kind) != bits:
        raise unreadable_image("its header has no type of numbers, or two")
    if not 0 <= start <= MAX_NIFTI_OFFSET_BYTES:  # NaN is neither
        raise unreadable_image("its header does not say where its voxels begin")
    _check_sizes(tuple(counts[:axes]))
    header = ImageHeader(tuple(counts[:axes]), bits // 8, size)
    _check_stored(header, size if packed else size - int(start), "gzip" if packed else "raw")
    return header
