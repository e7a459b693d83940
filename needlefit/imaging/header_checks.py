"""Check what an image header claims against the file size, before a native reader opens the file."""

import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from needlefit.errors import DataError
from needlefit.imaging.volume import READABLE_VOLUMES, check_size, max_voxels
from needlefit.project.input_files import open_regular, path_exists
from needlefit.project.sandbox import MEMORY_VARIABLE, stated_memory_bytes

MAX_HEADER_BYTES = 4 * 2**20
MAX_LINE_CHARS = 2048
"""Longest line of a text header, but for the texts that programs add to NRRD (`key:=value`)."""

MAX_NUMBER_CHARS = 64
MAX_AXES = 8
MAX_COMPONENTS = 256
"""Numbers of one voxel: channels of a picture."""

MAX_DEFLATION = 1032
"""Deflate makes nothing smaller than by this factor."""

MAX_EXPANSION = 200
EXEMPT_BYTES = 2**30
"""What unpacks to more than `MAX_EXPANSION` times its file may take so much memory, and no more: scans unpack
to 2 to 5 times their file, segmentations to 20 to 200 times, a file made to fill the memory to 1000 times."""

MAX_SEGMENTS = 64
"""Layers of a segmentation; a volume with more labels is a scan."""

SEGMENTS_FIX = "name the layers from the outside inwards: FILE=segments:NAME,NAME"

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(nan|inf)|none", re.IGNORECASE)
_SEPARATORS = re.compile(r"[\s(),]+")


@dataclass(frozen=True)
class ImageHeader:
    """The claims of an image header: sizes and texts.

    Attributes
    ----------
    size : tuple of int
        Voxels along each axis.
    voxel_bytes : int
        Size of one voxel in the file, unpacked.
    packed_bytes : int
        Size of the file that holds the voxels.
    texts : mapping of str
        What programs wrote beside what the format asks for, such as the segments of 3D Slicer.
    """

    size: tuple[int, ...]
    voxel_bytes: int
    packed_bytes: int
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

    Raises
    ------
    DataError
        If `name` is not the plain name of a regular file in the same folder.
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

    Raises
    ------
    DataError
        If a name is not there or twice, or there are no segments or too many.
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
