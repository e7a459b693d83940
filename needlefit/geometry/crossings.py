"""Find where a centreline crosses layer surfaces, the layers between, and where a surface encloses it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Floats
from needlefit.geometry.curves import arc_length, interpolate_at_arc, make_normal
from needlefit.geometry.surfaces import Surface

# Hits of one surface closer than this along the curve, mm, are one: its triangles share edges.
SAME_HIT_MM = 1e-6
# Relative slack at the edges of triangles and ends of segments: an edge is hit twice rather than never.
EDGE_TOLERANCE = 1e-9
BLOCK_PAIRS = 200_000  # segment-triangle pairs tested at once; bounds the memory


@dataclass(frozen=True)
class Crossings:
    """The layers along a curve, and the crossings between them."""

    arc: Floats  # (m,); arc length from the first point at which the layer changes, mm, increasing
    points: Floats  # (m, 3); the same places in the world, mm
    sequence: tuple[int, ...]  # the m + 1 layer numbers met, beginning with that of the first point


def find_crossings(points: ArrayLike, surfaces: Sequence[Surface]) -> Crossings:
    """Return the places where the polyline `points` (N, 3) passes from one layer to another.

    A place belongs to the solid that contains it (the last listed, if several do), else to the layer into
    which the last sheet crossed leads, whichever way it was crossed, else to layer 1. A touch is no
    crossing, and a crossing that does not change the layer is not listed.
    """
    curve = np.asarray(points, dtype=np.float64)
    length = float(arc_length(curve)[-1])
    hits = [(arc, surface) for surface in surfaces for arc in find_surface_hits(curve, surface)]
    hits.sort(key=lambda hit: hit[0])
    stops = [0.0, *(arc for arc, _ in hits), length]
    # The layer is constant between two hits, so the middle of each stretch decides it; at the hits themselves
    # rounding would.
    middles = interpolate_at_arc(curve, (np.array(stops[:-1]) + np.array(stops[1:])) / 2)
    solids = np.zeros(len(middles), dtype=np.int64)
    for surface in surfaces:
        if surface.kind == "solid":
            solids[surface.contains(middles)] = surface.into
    arcs: list[float] = []
    sequence: list[int] = []
    sheet = 1
    for n, (start, end) in enumerate(pairwise(stops)):
        if n and hits[n - 1][1].kind == "sheet":
            sheet = hits[n - 1][1].into
        layer = int(solids[n]) or sheet
        if end - start < SAME_HIT_MM or (sequence and layer == sequence[-1]):
            continue
        if sequence:
            arcs.append(start)
        sequence.append(layer)
    return Crossings(
        np.array(arcs), interpolate_at_arc(curve, arcs).reshape(-1, 3), tuple(sequence) or (sheet,)
    )


def find_surface_hits(curve: Floats, surface: Surface) -> Floats:
    """Return the arc lengths (m,), increasing, at which the polyline `curve` (N, 3) passes through a surface.

    A place where it meets triangles from both sides (it touches an edge, or a point of the curve lies on
    the surface and the curve turns back) is no passage through a sheet; for a solid the question is
    settled by which stretches lie inside.
    """
    arc, sign = _find_triangle_hits(curve, surface)
    order = np.argsort(arc, kind="stable")
    arc, sign = arc[order], sign[order]
    groups = np.split(np.arange(len(arc)), np.flatnonzero(np.diff(arc) > SAME_HIT_MM) + 1) if len(arc) else []
    through = [g for g in groups if surface.kind == "solid" or abs(sign[g].sum()) == len(g)]
    return np.array([arc[g[0]] for g in through])


def count_ray_hits(start: Floats, rays: Floats, triangles: Floats) -> int:
    """Return how many segments from `start` (3,) along `rays` (N, 3) hit one of the triangles (M, 3, 3)."""
    segment, _, _ = _intersect(np.broadcast_to(start, rays.shape), rays, triangles)
    return len(np.unique(segment))


def _find_triangle_hits(curve: Floats, surface: Surface) -> tuple[Floats, Floats]:
    """Return arc length and side (+1: along the triangle's normal) of every hit of segment and triangle."""
    low, high = curve.min(axis=0) - SAME_HIT_MM, curve.max(axis=0) + SAME_HIT_MM
    least, greatest = surface.extents
    triangles = surface.triangles[(greatest >= low).all(axis=1) & (least <= high).all(axis=1)]
    if len(triangles) == 0:
        return np.empty(0), np.empty(0)
    along, step = arc_length(curve), max(1, BLOCK_PAIRS // len(triangles))
    arcs, signs = [], []
    for first in range(0, len(curve) - 1, step):
        starts, ends = curve[first : first + step + 1][:-1], curve[first + 1 : first + step + 1]
        segment, fraction, sign = _intersect(starts, ends - starts, triangles)
        lengths = np.diff(along)[first + segment]
        arcs.append(along[first + segment] + fraction * lengths)
        signs.append(sign)
    return np.concatenate(arcs), np.concatenate(signs)


def _intersect(starts: Floats, steps: Floats, triangles: Floats) -> tuple[np.ndarray, Floats, Floats]:
    """Intersect segments `starts + t steps` (N, 3) with triangles (M, 3, 3): segment, t and side of each hit.

    Moller and Trumbore's test: with edges e1, e2 of a triangle at a, solve  start + t step = a + u e1 + v e2.
    """
    a = triangles[:, 0]
    e1, e2 = triangles[:, 1] - a, triangles[:, 2] - a
    offset = starts[:, None] - a  # (N, M, 3)
    normal = np.cross(e1, e2)  # (M, 3)
    slope = steps @ normal.T  # (N, M), minus the determinant
    turn = np.cross(offset, steps[:, None])
    scale = np.linalg.norm(steps, axis=1)[:, None] * np.linalg.norm(normal, axis=1)
    parallel = np.abs(slope) <= 1e-12 * scale
    safe = np.where(parallel, 1.0, slope)
    t = -np.einsum("nmk,mk->nm", offset, normal) / safe
    u = -np.einsum("nmk,mk->nm", turn, e2) / safe
    v = np.einsum("nmk,mk->nm", turn, e1) / safe
    inside = (
        (u >= -EDGE_TOLERANCE)
        & (v >= -EDGE_TOLERANCE)
        & (u + v <= 1 + EDGE_TOLERANCE)
        & (t >= -EDGE_TOLERANCE)
        & (t <= 1 + EDGE_TOLERANCE)
    )
    segment, triangle = np.nonzero(inside & ~parallel)
    fraction = np.clip(t[segment, triangle], 0.0, 1.0)
    return segment, fraction, np.sign(slope[segment, triangle])


ENCLOSURE_RAYS = 12  # number of directions across the curve in which the surface is searched
# Number of directions that may miss a surface that encloses the curve; a plane is missed by half of them.
MAX_MISSED_RAYS = 1


def measure_enclosed_length(points: ArrayLike, surface: Surface, radius: float) -> float:
    """Return the length of a polyline (N, 3) on which a surface is nearer than `radius` on all sides, mm."""
    step = 0.5  # mm, between the stations at which that is asked
    curve = np.asarray(points, dtype=np.float64)
    stations = np.arange(step / 2, float(arc_length(curve)[-1]), step)
    triangles = surface.triangles
    low, high = triangles.min(axis=1) - radius, triangles.max(axis=1) + radius
    count = 0
    ahead = interpolate_at_arc(curve, stations + step / 2) - interpolate_at_arc(curve, stations - step / 2)
    tangents: Floats = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    for centre, tangent in zip(interpolate_at_arc(curve, stations), tangents, strict=True):
        near = ((centre >= low) & (centre <= high)).all(axis=1)
        count += (
            near.any()
            and count_ray_hits(centre, radius * _make_radial_directions(tangent), triangles[near])
            >= ENCLOSURE_RAYS - MAX_MISSED_RAYS
        )
    return count * step


def _make_radial_directions(tangent: Floats) -> Floats:
    """Return unit vectors (RAYS, 3) perpendicular to `tangent` (3,), evenly around it."""
    angle = 2 * np.pi * np.arange(ENCLOSURE_RAYS) / ENCLOSURE_RAYS
    u = make_normal(tangent)
    return np.outer(np.cos(angle), u) + np.outer(np.sin(angle), np.cross(tangent, u))
