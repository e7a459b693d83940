"""Solids of a scene, and the exact chords that rays cut from them.

Every solid is convex, so that a ray lies in it from one place to another. A bent needle is a chain of rods
with mitred joints: neighbours share the plane between them and overlap nowhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.geometry.frames import Frame, normalize
from needlefit.synthetic.projection.materials import Material

Reals = NDArray[np.floating[Any]]
"""Arrays over rays: in single precision where the rays are."""

FLAT = 1e-9
"""What is smaller counts as parallel: keeps divisions finite."""


@dataclass(frozen=True)
class Rays:
    """Rays in the planes of a scanner's slices; the arrays broadcast against each other.

    Attributes
    ----------
    frame : Frame
        Origin on the rotation's axis; z along it. Its axes may be left-handed, as those of voxels.
    cos, sin : arrays
        Of the angle under which the detector stands; a ray runs along (-sin, cos, 0).
    t, z : arrays
        Along the detector, and along the axis, mm.
    """

    frame: Frame
    cos: Reals
    sin: Reals
    t: Reals
    z: Reals

    def components(self, point: Floats, axis: Floats) -> tuple[Reals, Reals]:
        """Return how far each ray's foot lies from `point` along `axis`, mm, and its slope along `axis`."""
        # plain floats: a scalar of numpy would widen rays of single precision
        x, y, z = (self.frame.rotation.T @ axis).tolist()
        foot = float((self.frame.origin - point) @ axis)
        return self.t * (x * self.cos + y * self.sin) + (foot + z * self.z), y * self.cos - x * self.sin


Interval = tuple[Reals, Reals]
"""Where rays enter and leave, mm from their feet; the first is larger where they miss."""


@dataclass(frozen=True)
class Box:
    """A box: layers, plates, tables. `low`, `high` (3,) are its corners in `frame`, mm."""

    frame: Frame
    low: Floats
    high: Floats
    material: Material

    def interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave."""
        enter: Reals = np.array(-np.inf, dtype=rays.t.dtype)
        leave: Reals = -enter
        for n in range(3):
            at, slope = rays.components(self.frame.origin, self.frame.rotation[:, n])
            slope = np.where(np.abs(slope) < FLAT, FLAT, slope)
            one, other = (float(self.low[n]) - at) / slope, (float(self.high[n]) - at) / slope
            enter = np.maximum(enter, np.minimum(one, other))
            leave = np.minimum(leave, np.maximum(one, other))
        return enter, leave

    def bounds(self) -> Floats:
        """Return its corners (8, 3)."""
        corners = np.array(np.meshgrid(*np.column_stack([self.low, self.high]))).reshape(3, -1).T
        return self.frame.to_world(corners)


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid: balls, bones. `radii` (3,) along the axes of `frame`, whose origin is the centre, mm."""

    frame: Frame
    radii: Floats
    material: Material

    def interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave."""
        a: Reals = np.array(0.0, dtype=rays.t.dtype)
        b, c = a, a - 1
        for n in range(3):
            at, slope = rays.components(self.frame.origin, self.frame.rotation[:, n] / self.radii[n])
            a, b, c = a + slope**2, b + at * slope, c + at**2
        return _roots(a, b, c)

    def bounds(self) -> Floats:
        """Return the corners of a box around it (8, 3)."""
        return Box(self.frame, -self.radii, self.radii, self.material).bounds()


@dataclass(frozen=True)
class Rod:
    """A cylinder or tube between two planes: wires, hubs, pieces of a needle.

    Attributes
    ----------
    start, end : (3,) arrays
        Ends of its axis, mm.
    radius, bore : float
        Of its surface and of the hole along its axis, mm; the hole is open to whatever is around.
    cuts : tuple of (point, normal)
        Further planes; what lies on the side of the normal is cut off. Without them it ends flat.
    """

    start: Floats
    end: Floats
    radius: float
    material: Material
    bore: float = 0.0
    cuts: tuple[tuple[Floats, Floats], ...] = ()

    @property
    def axis(self) -> Floats:
        """Its direction (3,)."""
        return normalize(self.end - self.start)

    def interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave its outer surface."""
        return self._cut(rays, self.radius)

    def bore_interval(self, rays: Rays) -> Interval:
        """Return where rays enter and leave the hole."""
        return self._cut(rays, self.bore)

    def _cut(self, rays: Rays, radius: float) -> Interval:
        a: Reals = np.array(0.0, dtype=rays.t.dtype)
        b, c = a, a - radius**2
        for side in np.linalg.svd(self.axis[None])[2][1:]:
            at, slope = rays.components(self.start, side)
            a, b, c = a + slope**2, b + at * slope, c + at**2
        enter, leave = _roots(a, b, c)
        flat = ((self.start, -self.axis), (self.end, self.axis))
        for point, normal in self.cuts or flat:
            at, slope = rays.components(point, normal)
            slope = np.where(np.abs(slope) < FLAT, FLAT, slope)
            cross = -at / slope
            leave = np.where(slope > 0, np.minimum(leave, cross), leave)
            enter = np.where(slope > 0, enter, np.maximum(enter, cross))
        return enter, leave

    def bounds(self) -> Floats:
        """Return the corners of boxes around its ends (16, 3); the reach of oblique cuts is in them."""
        reach = np.full(
            3, self.radius * (1 + max((_overhang(self.axis, n) for _, n in self.cuts), default=0))
        )
        ends = [Frame(end, np.eye(3)) for end in (self.start, self.end)]
        return np.vstack([Box(frame, -reach, reach, self.material).bounds() for frame in ends])


Solid = Box | Ellipsoid | Rod


def make_ball(center: Floats, diameter: float, material: Material) -> Ellipsoid:
    """Return a ball."""
    return Ellipsoid(Frame(center, np.eye(3)), np.full(3, diameter / 2), material)


def make_needle(
    points: Floats,
    diameter: float,
    bevel_deg: float,
    bevel_toward: Floats,
    material: Material,
    bore: float = 0.0,
) -> list[Rod]:
    """Return the rods of a needle along `points` (N, 3) from base to tip, mm.

    Its point lies at the last of `points`, on the side `bevel_toward` (3,); `bevel_deg` is the angle of the
    face to the axis. `bore` is the diameter of the hole.
    """
    pieces = np.diff(points, axis=0)
    ways = pieces / np.linalg.norm(pieces, axis=1, keepdims=True)
    side = normalize(bevel_toward - (bevel_toward @ ways[-1]) * ways[-1], "the bevel's side")
    angle = np.radians(bevel_deg)
    face = (points[-1] + diameter / 2 * side, np.sin(angle) * ways[-1] - np.cos(angle) * side)
    joints = [normalize(one + other) for one, other in pairwise(ways)]
    planes = [(points[0], ways[0]), *zip(points[1:-1], joints, strict=True)]
    left = np.linalg.norm(points[-1] - points[1:], axis=1)
    rods = []
    for n, (start, end) in enumerate(pairwise(points)):
        cuts = [(planes[n][0], -planes[n][1]), *planes[n + 1 : n + 2]]
        if left[n] <= 2 * diameter / np.tan(angle):  # the face reaches back over several pieces
            cuts.append(face)
        rods.append(Rod(start, end, diameter / 2, material, bore / 2, tuple(cuts)))
    return rods


def interval_length(intervals: Sequence[Interval]) -> Reals:
    """Return how much of each ray lies in all `intervals`, mm."""
    enter, leave = intervals[0]
    for one, other in intervals[1:]:
        enter, leave = np.maximum(enter, one), np.minimum(leave, other)
    length: Reals = np.clip(leave - enter, 0, None)
    return length


def _roots(a: Reals, b: Reals, c: Reals) -> Interval:
    """Return the interval in which a x^2 + 2 b x + c is negative; a miss gives an empty one."""
    a = np.maximum(a, FLAT**2)
    root = b**2 - a * c
    wide = np.sqrt(np.clip(root, 0, None))
    hit = root > 0
    return np.where(hit, (-b - wide) / a, np.inf), np.where(hit, (-b + wide) / a, -np.inf)


def _overhang(axis: Floats, normal: Floats) -> float:
    """Return how far a plane reaches along a rod, in radii."""
    cosine = abs(float(axis @ normal))
    return float(np.sqrt(1 - min(cosine, 1.0) ** 2)) / max(cosine, 0.05)
