"""Along which part of a curve a surface runs around it."""

import numpy as np
from numpy.typing import ArrayLike

from needlefit.geometry.crossings import ray_hits
from needlefit.geometry.curves import arc_length, at_arc
from needlefit.geometry.frames import Floats
from needlefit.geometry.plane import any_normal
from needlefit.geometry.surfaces import Surface

RAYS = 12
"""Directions across the curve in which the surface is looked for."""

MISSED = 1
"""So many may miss a surface that runs around; a plane is missed by half of them."""


def enclosed_length(points: ArrayLike, surface: Surface, radius: float, step: float = 0.5) -> float:
    """Return along how much of a polyline (N, 3) a surface is nearer than `radius` on all sides, mm.

    Parameters
    ----------
    step : float
        Distance of the stations at which that is asked, mm.
    """
    curve = np.asarray(points, dtype=np.float64)
    stations = np.arange(step / 2, float(arc_length(curve)[-1]), step)
    triangles = np.asarray(surface.mesh.triangles, dtype=np.float64)
    low, high = triangles.min(axis=1) - radius, triangles.max(axis=1) + radius
    count = 0
    for centre, tangent in zip(at_arc(curve, stations), _tangents(curve, stations, step), strict=True):
        near = ((centre >= low) & (centre <= high)).all(axis=1)
        count += near.any() and ray_hits(centre, radius * _around(tangent), triangles[near]) >= RAYS - MISSED
    return count * step


def _tangents(curve: Floats, stations: Floats, step: float) -> Floats:
    ahead = at_arc(curve, stations + step / 2) - at_arc(curve, stations - step / 2)
    tangents: Floats = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    return tangents


def _around(tangent: Floats) -> Floats:
    """Return unit vectors (RAYS, 3) perpendicular to `tangent` (3,), evenly around it."""
    angle = 2 * np.pi * np.arange(RAYS) / RAYS
    u = any_normal(tangent)
    directions: Floats = np.outer(np.cos(angle), u) + np.outer(np.sin(angle), np.cross(tangent, u))
    return directions
