"""NRRD headers (http://teem.sourceforge.net/nrrd/format.html)."""

import re
from collections.abc import Iterable
from pathlib import Path

from needlefit.errors import DataError
from needlefit.imaging.headers.promise import (
    MAX_AXES,
    MAX_HEADER_BYTES,
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

TYPES = (
    (1, "char, signed char, int8, int8_t, uchar, unsigned char, uint8, uint8_t"),
    (2, "short, short int, signed short, signed short int, int16, int16_t"),
    (2, "ushort, unsigned short, unsigned short int, uint16, uint16_t"),
    (4, "int, signed int, int32, int32_t, uint, unsigned int, uint32, uint32_t, float"),
    (8, "longlong, long long, long long int, signed long long, signed long long int, int64, int64_t"),
    (8, "ulonglong, unsigned long long, unsigned long long int, uint64, uint64_t, double"),
)
VOXEL_BYTES = {name: size for size, names in TYPES for name in names.split(", ")}
PACKINGS = {
    **{"raw": "raw", "txt": "text", "text": "text", "ascii": "text", "hex": "hex"},
    **{"gz": "gzip", "gzip": "gzip", "bz2": "bzip2", "bzip2": "bzip2"},
}
NUMBERS = {
    *("number", "dimension", "space dimension", "sizes", "spacings", "thicknesses", "axis mins", "axis maxs"),
    *("space directions", "min", "max", "old min", "old max", "line skip", "byte skip", "space origin"),
    "measurement frame",
}
TEXTS = {
    *("content", "type", "space", "centers", "kinds", "labels", "units", "endian", "encoding"),
    *("sample units", "space units", "data file"),
}
ALIASES = {
    name.replace(" ", ""): name
    for name in ("axis mins", "axis maxs", "old min", "old max", "line skip", "byte skip", "sample units")
} | {"datafile": "data file", "centerings": "centers"}
MAX_SKIPPED_BYTES, MAX_SKIPPED_LINES = 2**40, 2**24


def check_nrrd(path: Path) -> ImageHeader:
    """Return the header of a `.nrrd` or `.nhdr` file; DataError as `check_image_header`."""
    head, size = head_of(path)
    lines, end = _lines(path, head, size)
    fields, texts = _fields(path, lines)
    missing = [name for name in ("type", "dimension", "sizes", "encoding") if name not in fields]
    if missing:
        raise no_image(path, f"its header has no `{missing[0]}`")
    voxel_bytes, packing = VOXEL_BYTES.get(fields["type"].lower()), PACKINGS.get(fields["encoding"].lower())
    if voxel_bytes is None or packing is None:
        raise no_image(path, f"its {'encoding' if voxel_bytes else 'type'} is none that is read")
    if packing == "bzip2":
        raise DataError(
            "its voxels are packed with bzip2, which is not read",
            where=str(path),
            expected="encoding: raw, text, hex or gzip",
            mend="save it again with gzip, as 3D Slicer does by default, or without compression",
        )
    axes = whole(fields["dimension"], 1, MAX_AXES, path)
    skip = whole(fields.get("byte skip", "0"), -1, MAX_SKIPPED_BYTES, path)
    whole(fields.get("line skip", "0"), 0, MAX_SKIPPED_LINES, path)
    counts = sizes(fields["sizes"], axes, path)
    if "data file" in fields:
        size, end = size_beside(path, fields["data file"]), 0
    header = ImageHeader(counts, voxel_bytes, size, texts)
    check_stored(header, size - end - (max(skip, 0) if packing == "raw" else 0), packing, path)
    return header


def header_fields(path: Path) -> tuple[dict[str, str], int]:
    """Return the fields of a header, and the number of lines up to its voxels."""
    head, size = head_of(path)
    lines, _ = _lines(path, head, size)
    return _fields(path, lines)[0], len(lines) + 2  # the first line, and the blank one


def _lines(path: Path, head: bytes, size: int) -> tuple[list[str], int]:
    """Return the lines of the header behind the first, and where it ends: at a blank line or the end."""
    if re.match(rb"NRRD000\d\r?\n", head) is None:
        raise no_image(path, "it does not begin as NRRD does")
    blank = re.search(rb"\n\r?\n", head)
    if blank is None and len(head) < size:
        raise no_image(path, f"its header is longer than {MAX_HEADER_BYTES / 2**20:.0f} MiB")
    text = head[: blank.start()] if blank else head
    lines = text.decode("utf-8", "replace").split("\n")[1:]
    return [line.rstrip("\r") for line in lines], blank.end() if blank else len(head)


def _fields(path: Path, lines: Iterable[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return the fields of the format, and the texts that programs added (`key:=value`)."""
    fields: dict[str, str] = {}
    texts: dict[str, str] = {}
    for number, line in enumerate(lines, 2):
        if not line or line.startswith("#"):
            continue
        name, colon, value = line.partition(": ")
        name = ALIASES.get(name.lower(), name.lower())
        if colon and name in NUMBERS | TEXTS:
            put(fields, name, value.strip(), (path, number))
            if name in NUMBERS:
                check_numbers(value, (path, number))
            if name == "data file" and value.split()[:1] == ["LIST"]:
                break  # what follows are names of files; `size_beside` refuses several
        elif ":=" in line:
            key, _, text = line.partition(":=")
            texts[key] = text
        else:
            raise no_image(path, f"line {number} of its header is no field of NRRD")
    return fields, texts
