"""NIfTI headers, versions 1 and 2 (https://nifti.nimh.nih.gov/nifti-1, nifti-2)."""

import gzip
import struct
import sys
import zlib
from dataclasses import dataclass
from pathlib import Path

from needlefit.imaging.headers.promise import (
    ImageHeader,
    check_sizes,
    check_stored,
    no_image,
)
from needlefit.project.reading import opened

MAX_OFFSET_BYTES = 64 * 2**20
"""Where the voxels begin: extensions may stand before them."""

VOXEL_BITS = {
    **{2: 8, 4: 16, 8: 32, 16: 32, 32: 64, 64: 64, 128: 24, 256: 8, 512: 16, 768: 32, 1024: 64},
    **{1280: 64, 1536: 128, 1792: 128, 2048: 256, 2304: 32},
}


@dataclass(frozen=True)
class _Layout:
    """Where a version of the format has its entries: places, and forms as of `struct`."""

    signature: tuple[int, bytes]
    sizes: tuple[int, str]
    type: int
    start: tuple[int, str]


LAYOUTS = {
    348: _Layout((344, b"n+1\0"), (40, "8h"), 70, (108, "f")),
    540: _Layout((4, b"n+2\0\r\n\x1a\n"), (16, "8q"), 12, (168, "q")),
}
"""By the size of the header, which stands first."""


def check_nifti(path: Path) -> ImageHeader:
    """Return the header of a `.nii` or `.nii.gz` file; DataError as `check_image_header`."""
    packed = path.name.lower().endswith(".gz")
    head, size = _head(path, packed)
    order = "<" if int.from_bytes(head[:4], "little") in LAYOUTS else ">"
    layout = LAYOUTS.get(struct.unpack_from(f"{order}i", head)[0]) if head else None
    if layout is None or not head.startswith(layout.signature[1], layout.signature[0]):
        raise no_image(path, "it does not begin as a NIfTI file that holds its own voxels does")
    axes, *counts = struct.unpack_from(order + layout.sizes[1], head, layout.sizes[0])
    kind, bits = struct.unpack_from(f"{order}2h", head, layout.type)
    (start,) = struct.unpack_from(order + layout.start[1], head, layout.start[0])
    if not 1 <= axes <= 7 or min(counts[:axes]) < 1:
        raise no_image(path, "its header has no sizes")
    if VOXEL_BITS.get(kind) != bits:
        raise no_image(path, "its header has no type of numbers, or two")
    if not 0 <= start <= MAX_OFFSET_BYTES:  # NaN is neither
        raise no_image(path, "its header does not say where its voxels begin")
    check_sizes(tuple(counts[:axes]), path)
    header = ImageHeader(tuple(counts[:axes]), bits // 8, size)
    check_stored(header, size if packed else size - int(start), "gzip" if packed else "raw", path)
    return header


def _head(path: Path, packed: bool) -> tuple[bytes, int]:
    """Return the first bytes, unpacked, none if there is no header, and the size of the file."""
    with opened(path, sys.maxsize) as file:
        try:
            head = (gzip.GzipFile(fileobj=file) if packed else file).read(max(LAYOUTS))
        except (EOFError, OSError, zlib.error):
            raise no_image(path, "it is no gzip file, or damaged at its beginning") from None
        size = file.seek(0, 2)
    return head.ljust(max(LAYOUTS), b"\0") if len(head) >= min(LAYOUTS) else b"", size
