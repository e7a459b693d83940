"""Needles as bodies: a closed tube along a curve, and its PLY file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from needlefit.errors import DataError
from needlefit.geometry.frames import PARALLEL, unit

Floats = NDArray[np.float64]

FACETS = 12
"""Corners of a cross-section."""


def tube(points: ArrayLike, half_widths: ArrayLike, toward: ArrayLike) -> trimesh.Trimesh:
    """Return a closed tube with elliptic cross-sections, its triangles turned outward.

    Parameters
    ----------
    points : (N, 3) array
        Its axis, mm; neighbours differ.
    half_widths : (N, 2) array, or what broadcasts to it
        Semi-axes of each cross-section, mm: along `toward`, and across it.
    toward : (3,) array
        The first semi-axis, as far as it is normal to the curve.

    Raises
    ------
    DataError
        If there are fewer than two points, two neighbours coincide, or the curve runs along `toward`.
    """
    axis = np.asarray(points, dtype=np.float64)
    count = len(axis)
    if count < 2 or not np.isfinite(axis).all():
        raise DataError(f"a tube along {count} points", expected="two finite points or more")
    first, second = _cross_sections(axis, toward)
    widths = np.broadcast_to(np.asarray(half_widths, dtype=np.float64), (count, 2))
    angle = 2 * np.pi * np.arange(FACETS) / FACETS
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)  # (FACETS, 2)
    arms = np.stack([first, second], axis=1) * widths[:, :, None]  # (N, 2, 3)
    vertices = axis[:, None, :] + np.einsum("fk,nkd->nfd", rim, arms)  # (N, FACETS, 3)
    ends = np.stack([axis[0], axis[-1]])
    return trimesh.Trimesh(np.vstack([vertices.reshape(-1, 3), ends]), _faces(count), process=False)


def write_ply(mesh: trimesh.Trimesh, path: Path, comments: Sequence[str] = ()) -> None:
    """Write a mesh in LPS as binary PLY, float32; the same mesh gives the same bytes.

    The header says `SPACE=LPS`, which 3D Slicer reads; `comments` stand beside it.
    """
    data: bytes = trimesh.exchange.ply.export_ply(mesh, encoding="binary", vertex_normal=False)
    head, said, body = data.partition(b"\nformat binary_little_endian 1.0\n")
    lines = "".join(f"comment {line}\n" for line in ("SPACE=LPS", *comments))
    path.write_bytes(head + said + lines.encode("ascii", "replace") + body)


def _cross_sections(axis: Floats, toward: ArrayLike) -> tuple[Floats, Floats]:
    """Return the two unit normals (N, 3) of each cross-section; with the tangent they are right-handed."""
    steps = np.diff(axis, axis=0)
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    if not (lengths > 0).all():
        raise DataError(
            "two neighbouring points of a curve coincide",
            expected="points that differ",
            fix="remove the repeated points",
        )
    steps = steps / lengths
    tangents = np.vstack([steps[:1], steps[1:] + steps[:-1], steps[-1:]])
    first = unit(toward) - tangents * (
        (tangents @ unit(toward)) / np.maximum(np.sum(tangents**2, axis=1), PARALLEL)
    ).reshape(-1, 1)
    size = np.linalg.norm(first, axis=1, keepdims=True)
    if not (size > PARALLEL).all():
        raise DataError(
            "the curve runs along the direction that its cross-sections are to have",
            expected="a direction across the needle",
        )
    first = first / size
    second = np.cross(tangents, first)
    return first, second / np.linalg.norm(second, axis=1, keepdims=True)


def _faces(count: int) -> NDArray[np.int64]:
    """Return the triangles of `count` rims, one after the other, and of the two caps."""
    i = np.arange(FACETS)
    j = (i + 1) % FACETS
    side = np.vstack([np.column_stack([i, j, j + FACETS]), np.column_stack([i, j + FACETS, i + FACETS])])
    wall = (side[None] + FACETS * np.arange(count - 1)[:, None, None]).reshape(-1, 3)
    last, centre = FACETS * (count - 1), FACETS * count
    bottom = np.column_stack([j, i, np.full(FACETS, centre)])
    top = np.column_stack([i + last, j + last, np.full(FACETS, centre + 1)])
    return np.vstack([wall, bottom, top])
