"""Render slices of the scan along and across the needle, in the axes of the constraint frame."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame
from needlefit.imaging.reconstruction import ScanView
from needlefit.imaging.volume import Volume, to_index

PIXEL_MM = 0.3  # edge of a pixel, mm: finer than the voxels of a cone-beam scan
# Places along the third axis over which a picture is averaged, mm: the slab holds the needle whole, and its
# mean quiets the noise so that layers show.
SLAB_OFFSETS_MM = np.arange(-1.2, 1.3, 0.4)
# How far pictures reach before the entry, beyond the tip and to the sides of the needle, mm.
ENTRY_MARGIN_MM, TIP_MARGIN_MM, SIDE_MARGIN_MM = 35.0, 10.0, 10.0
# Where the picture across the needle is taken, mm back from the tip: there even a long bevel is whole.
TIP_SECTION_OFFSET_MM = 4.0


def render_views(volume: Volume, patient: Frame, frame: Frame, needle: ArrayLike) -> tuple[ScanView, ...]:
    """Return three images: the bending plane (x, y), across it (x, z), and near the tip (y, z).

    `patient`: the scan's axes and origin in the world.
    `frame`: C in the world.
    `needle`: (N, 3); the whole needle from base to tip, LPS, mm.
    """
    local, turned = _to_constraint_frame(patient, frame, needle)
    x, (y, z) = _pixels_along(local), (_pixels_across(local, side, SIDE_MARGIN_MM) for side in (1, 2))
    end = np.full(len(y), local[-1, 0] - TIP_SECTION_OFFSET_MM)
    return (
        render_bending_plane(volume, patient, frame, needle),
        _average_slab(volume, turned, "xzy", (x, z, np.interp(x, local[:, 0], local[:, 1]))),
        _average_slab(volume, turned, "yzx", (y, z, end)),
    )


def render_bending_plane(
    volume: Volume, patient: Frame, frame: Frame, needle: ArrayLike, beside: float = SIDE_MARGIN_MM
) -> ScanView:
    """Return the image of the bending plane (x, y), `beside` mm wide to both sides; see `render_views`."""
    local, turned = _to_constraint_frame(patient, frame, needle)
    x, y = _pixels_along(local), _pixels_across(local, 1, beside)
    return _average_slab(volume, turned, "xyz", (x, y, np.interp(x, local[:, 0], local[:, 2])))


def _to_constraint_frame(patient: Frame, frame: Frame, needle: ArrayLike) -> tuple[Floats, Frame]:
    """Return the needle (N, 3) in C, in the order of its x, and C in the scan's LPS."""
    local = frame.to_local(patient.to_world(needle))
    turned = Frame(patient.to_local(frame.origin[None])[0], patient.rotation.T @ frame.rotation)
    return local[np.argsort(local[:, 0])], turned


def _pixels_along(local: Floats) -> Floats:
    """Return the columns of a picture along a needle in C (N, 3)."""
    return _pixels(max(-ENTRY_MARGIN_MM, float(local[0, 0]) - 2.0), float(local[-1, 0]) + TIP_MARGIN_MM)


def _pixels_across(local: Floats, axis: int, beside: float) -> Floats:
    """Return the pixels along one of the axes across a needle in C (N, 3), from `beside` mm before it on."""
    side = local[local[:, 0] >= -ENTRY_MARGIN_MM, axis]
    return _pixels(float(side.min()) - beside, float(side.max()) + beside)


def _pixels(low: float, high: float) -> Floats:
    """Return the centres of the pixels from `low` to about `high`, mm."""
    return low + PIXEL_MM * (np.arange(max(1, round((high - low) / PIXEL_MM)), dtype=np.float64) + 0.5)


def _average_slab(volume: Volume, frame: Frame, axes: str, places: tuple[Floats, Floats, Floats]) -> ScanView:
    """Return the mean brightness over a slab.

    `frame`: C in the scan's LPS.
    `axes`: C's axes to the right, upwards, and through the slab.
    `places`: columns (W,), rows (H,), and where the slab's middle lies in each column (W,), mm in C.
    """
    right, up, middle = places
    points = np.empty((len(up), len(right), len(SLAB_OFFSETS_MM), 3))
    order = ["xyz".index(axis) for axis in axes]
    points[..., order[0]] = right[None, :, None]
    points[..., order[1]] = up[:, None, None]
    points[..., order[2]] = middle[None, :, None] + SLAB_OFFSETS_MM
    index = to_index(volume, frame.to_world(points.reshape(-1, 3)))[:, ::-1].T
    values = map_coordinates(volume.values, index, order=1, cval=np.nan, output=np.float32)
    mean = values.reshape(points.shape[:3]).mean(axis=2)
    half = PIXEL_MM / 2
    extent = (right[0] - half, right[-1] + half, up[0] - half, up[-1] + half)
    left, rightmost, bottom, top = (float(edge) for edge in extent)
    return ScanView((axes[0], axes[1]), mean, (left, rightmost, bottom, top))
