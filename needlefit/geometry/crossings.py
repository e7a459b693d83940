"""Find where a centreline crosses layer surfaces, the layers between, and where a surface encloses it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needlefit.arrays import Bools, Floats, Ints
from needlefit.geometry.curves import arc_length, interpolate_at_arc, make_normal
from needlefit.geometry.surfaces import BLOCK_PAIRS, Surface

# distance along the curve (mm) below which two hits of one surface are one: its triangles share edges
SAME_HIT_MM = 1e-6
# relative slack at the edges of triangles and ends of segments: an edge is hit twice rather than never
EDGE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Crossings:
    """The layers along a curve, and the crossings between them."""

    arc: Floats  # (m,); arc length from the first point at which the layer changes, mm, increasing
    points: Floats  # (m, 3); the same places in the world, mm
    sequence: tuple[int, ...]  # the m + 1 layer numbers met, beginning with that of the first point


@dataclass(frozen=True)
class PathCrossings:
    """The layers along each of B curves, and the crossings between them: at most M on a curve."""

    arc: Floats  # (B, M); as of `Crossings`; NaN behind the last crossing of a curve
    points: Floats  # (B, M, 3); NaN behind the last one
    layers: Ints  # (B, M + 1); the layer numbers met; 0 behind the last one


def find_crossings(points: ArrayLike, surfaces: Sequence[Surface]) -> Crossings:
    """Return the places where the polyline `points` (N, 3) passes from one layer to another.

    A place belongs to the solid that contains it (the last listed, if several do), else to the layer into
    which the last sheet crossed leads, whichever way it was crossed, else to layer 1. A touch is no
    crossing, and a crossing that does not change the layer is not listed.
    """
    crossed = find_path_crossings(np.asarray(points, dtype=np.float64)[None], surfaces)
    return Crossings(crossed.arc[0], crossed.points[0], tuple(crossed.layers[0].tolist()))


def find_path_crossings(curves: Floats, surfaces: Sequence[Surface]) -> PathCrossings:
    """Return what `find_crossings` returns of each of B polylines (B, N, 3)."""
    along, hits = _measure_arcs(curves), list[tuple[Ints, Floats, Ints]]()
    # each curve begins in layer 1; a solid leads nowhere: which stretches lie in it is asked below
    hits.append((np.arange(len(curves)), np.zeros(len(curves)), np.ones(len(curves), dtype=np.int64)))
    for surface in surfaces:
        curve, arc = _find_passages(curves, along, surface)
        hits.append((curve, arc, np.full(len(arc), surface.into if surface.kind == "sheet" else 0)))
    curve, start, into = (np.concatenate(parts) for parts in zip(*hits, strict=True))
    order = np.lexsort((start, curve))  # stable
    curve, start, into = curve[order], start[order], into[order]
    last = np.append(np.diff(curve) > 0, True)
    end = np.where(last, along[curve, -1], np.append(start[1:], 0.0))
    layer = into[np.maximum.accumulate(np.where(into > 0, np.arange(len(into)), 0))]
    solids = [surface for surface in surfaces if surface.kind == "solid"]
    # The layer is constant between two hits, so the middle of each stretch decides it; at the hits themselves
    # rounding would.
    middles = _interpolate(curves, along, curve, (start + end) / 2) if solids else np.empty((0, 3))
    for surface in solids:
        layer[surface.contains(middles)] = surface.into
    longer = end - start >= SAME_HIT_MM
    longer |= last & (np.bincount(curve, longer)[curve] == 0)  # of a curve without length
    kept = np.flatnonzero(longer)
    changes = (np.diff(layer[kept], prepend=0) != 0) | (np.diff(curve[kept], prepend=-1) != 0)
    kept = kept[changes]
    rows, starts = curve[kept], start[kept]
    place = np.arange(len(kept)) - np.searchsorted(rows, rows)
    count, crossed = int(place.max()), place > 0
    arcs, layers = np.full((len(curves), count), np.nan), np.zeros((len(curves), count + 1), dtype=np.int64)
    points = np.full((len(curves), count, 3), np.nan)
    layers[rows, place] = layer[kept]
    where = rows[crossed], place[crossed] - 1
    arcs[where] = starts[crossed]
    points[where] = _interpolate(curves, along, rows[crossed], starts[crossed])
    return PathCrossings(arcs, points, layers)


def _measure_arcs(curves: Floats) -> Floats:
    """Return the arc lengths (B, N) of the points of curves (B, N, 3)."""
    steps = np.linalg.norm(np.diff(curves, axis=1), axis=2)
    return np.cumsum(np.concatenate([np.zeros((len(steps), 1)), steps], axis=1), axis=1)


def _interpolate(curves: Floats, along: Floats, rows: Ints, arc: Floats) -> Floats:
    """Return the points (K, 3) at arc lengths (K,) of the curves numbered `rows` (K,)."""
    after = np.clip((along[rows] <= arc[:, None]).sum(axis=1), 1, curves.shape[1] - 1)
    first, begin = curves[rows, after - 1], along[rows, after - 1]
    span = np.maximum(along[rows, after] - begin, np.finfo(np.float64).tiny)
    slopes: Floats = (curves[rows, after] - first) / span[:, None]
    return slopes * (arc - begin)[:, None] + first


def find_surface_hits(curve: Floats, surface: Surface) -> Floats:
    """Return the arc lengths (m,), increasing, at which the polyline `curve` (N, 3) passes through a surface.

    A place where it meets triangles from both sides (it touches an edge, or a point of the curve lies on
    the surface and the curve turns back) is no passage through a sheet; for a solid the question is
    settled by which stretches lie inside.
    """
    return _find_passages(curve[None], _measure_arcs(curve[None]), surface)[1]


def _find_passages(curves: Floats, along: Floats, surface: Surface) -> tuple[Ints, Floats]:
    """Return the passages of curves (B, N, 3) through a surface: the numbers of the curves, and arc lengths.

    They are in the order of the curves, and along each.
    """
    curve, arc, sign = _find_triangle_hits(curves, along, surface)
    if not len(arc):
        return curve, arc
    order = np.lexsort((arc, curve))
    curve, arc, sign = curve[order], arc[order], sign[order]
    first = np.flatnonzero(np.append(True, (np.diff(curve) > 0) | (np.diff(arc) > SAME_HIT_MM)))
    if surface.kind == "sheet":
        first = first[np.abs(np.add.reduceat(sign, first)) == np.diff(np.append(first, len(arc)))]
    return curve[first], arc[first]


def count_ray_hits(start: Floats, rays: Floats, triangles: Floats) -> int:
    """Return how many segments from `start` (3,) along `rays` (N, 3) hit one of the triangles (M, 3, 3)."""
    hit, _, _ = _intersect(start, rays[:, None], triangles)
    return int(hit.any(axis=1).sum())


def _find_triangle_hits(curves: Floats, along: Floats, surface: Surface) -> tuple[Ints, Floats, Floats]:
    """Return of every hit of segment and triangle the curve, arc length and side (+1: along the normal).

    Only those are intersected whose boxes overlap: first the boxes of a step of all curves are asked.
    """
    low = np.minimum(curves[:, :-1], curves[:, 1:]) - SAME_HIT_MM  # (B, N - 1, 3)
    high = np.maximum(curves[:, :-1], curves[:, 1:]) + SAME_HIT_MM
    least, greatest = surface.extents
    near = (greatest >= low.min(axis=(0, 1))).all(axis=1) & (least <= high.max(axis=(0, 1))).all(axis=1)
    near = np.flatnonzero(near)
    least, greatest, hits = least[near], greatest[near], list[tuple[Ints, Floats, Floats]]()
    hits.append((np.empty(0, dtype=np.int64), np.empty(0), np.empty(0)))
    size = max(1, BLOCK_PAIRS // max(1, len(near) * len(curves)))
    for first in range(0, low.shape[1] if len(near) else 0, size):
        some = slice(first, first + size)
        step, triangle = np.nonzero(_overlap(low[:, some].min(0), high[:, some].max(0), least, greatest))
        step += first
        touch = (low[:, step] <= greatest[triangle]) & (least[triangle] <= high[:, step])
        curve, pair = np.nonzero(touch.all(axis=2))
        step, triangle = step[pair], near[triangle[pair]]
        start, end = curves[curve, step], curves[curve, step + 1]
        hit, fraction, sign = _intersect(start, end - start, surface.triangles[triangle])
        curve, step, fraction = curve[hit], step[hit], np.clip(fraction[hit], 0.0, 1.0)
        begin, end = along[curve, step], along[curve, step + 1]
        hits.append((curve, begin + fraction * (end - begin), sign[hit]))
    curve, arc, sign = (np.concatenate(parts) for parts in zip(*hits, strict=True))
    return curve, arc, sign


def _overlap(low: Floats, high: Floats, least: Floats, greatest: Floats) -> Bools:
    """Return which boxes (N, M) overlap: of ends (N, 3) and (M, 3)."""
    apart = np.zeros((len(low), len(least)), dtype=np.bool_)
    for axis in range(3):
        apart |= (low[:, None, axis] > greatest[:, axis]) | (least[:, axis] > high[:, None, axis])
    return ~apart


def _intersect(starts: Floats, steps: Floats, triangles: Floats) -> tuple[Bools, Floats, Floats]:
    """Intersect segments `starts + t steps` (..., 3) with triangles (..., 3, 3): which hit, t and side.

    Moller and Trumbore's test: with edges e1, e2 of a triangle at a, solve  start + t step = a + u e1 + v e2.
    """
    a = triangles[..., 0, :]
    e1, e2, offset = triangles[..., 1, :] - a, triangles[..., 2, :] - a, starts - a
    normal, turn = _cross(e1, e2), _cross(offset, steps)
    slope = np.sum(steps * normal, axis=-1)  # minus the determinant
    scale = np.linalg.norm(steps, axis=-1) * np.linalg.norm(normal, axis=-1)
    parallel = np.abs(slope) <= 1e-12 * scale
    safe = np.where(parallel, 1.0, slope)
    t, u, v = (np.sum(product, axis=-1) / safe for product in (-offset * normal, -turn * e2, turn * e1))
    inside = (
        (u >= -EDGE_TOLERANCE)
        & (v >= -EDGE_TOLERANCE)
        & (u + v <= 1 + EDGE_TOLERANCE)
        & (t >= -EDGE_TOLERANCE)
        & (t <= 1 + EDGE_TOLERANCE)
    )
    return inside & ~parallel, t, np.sign(slope)


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the cross product of vectors (..., 3): a seventh of the time of `np.cross` for a few."""
    after, before = [1, 2, 0], [2, 0, 1]
    return a.take(after, -1) * b.take(before, -1) - a.take(before, -1) * b.take(after, -1)


ENCLOSURE_RAYS = 12  # number of directions across the curve in which the surface is searched
# largest number of directions that may miss a surface that encloses the curve; half of them miss a plane
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
