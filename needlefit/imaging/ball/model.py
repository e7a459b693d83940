"""What a scanner shows of a ball beside a face of whatever it sits on.

The ball is convolved with a Gaussian (closed form) and averaged over each voxel; where it is, it takes the
place of the background. The background is two levels with a soft step between them, as a marker glued on a
phantom has it: a ramp or one level are steps that are wide or small. All is cut where the scanner's numbers
end.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, ndtr

Floats = NDArray[np.float64]

FINE = 0.02
"""Spacing of the table of the ball's profile, mm."""

CENTER, HEIGHT, BLUR, LEVEL, STEP, FACE, OFFSET = slice(0, 3), 3, 4, 5, 6, slice(7, 10), 10
"""What the 11 parameters are: centre of the ball, mm; logarithms of its own HU and of its blur, mm; the
background's lower level and its step, HU; the step's direction over its width, 1/mm, and its offset."""


@dataclass(frozen=True)
class Near:
    """Voxels around a ball.

    Attributes
    ----------
    places : (N, 3) array
        From the blob's middle along the grid's axes, mm.
    values : (N,) array
        HU.
    spacing : (3,) array
        Of the grid, mm.
    ceiling : float
        Where the scanner's numbers end, HU; inf if they do not.
    """

    places: Floats
    values: Floats
    spacing: Floats
    ceiling: float


def look(near: Near, radius: float, theta: Floats) -> tuple[Floats, Floats]:
    """Return what is shown (N,), HU, of a ball of `radius` (mm), and its derivatives (N, 11)."""
    part, moved, wider = _ball(near, radius, theta[CENTER], float(np.exp(theta[BLUR])))
    around, turned = _background(near.places, theta)
    height, void = float(np.exp(theta[HEIGHT])), 1 - part
    over = height - around
    shown = around + over * part
    slopes = np.column_stack(
        [moved * over[:, None], part * height, wider * over, void, turned * void[:, None]]
    )
    slopes[shown > near.ceiling] = 0.0
    return np.minimum(shown, near.ceiling), slopes


def profile(r: Floats, radius: float, blur: float) -> Floats:
    """Return a ball of height 1 convolved with a Gaussian of deviation `blur`, at distances `r` (N,) > 0."""
    s = np.sqrt(2) * blur
    inner, outer = (radius - r) / s, (radius + r) / s
    rim = blur / (np.sqrt(2 * np.pi) * r) * (np.exp(-(inner**2)) - np.exp(-(outer**2)))
    return np.asarray((erf(inner) + erf(outer)) / 2 - rim)


def _ball(near: Near, radius: float, center: Floats, blur: float) -> tuple[Floats, Floats, Floats]:
    """Return the part of each voxel that is ball (N,), the mean of its eight Gauss points.

    Also its derivatives by the centre (N, 3), 1/mm, and by the logarithm of the blur (N,).
    """
    r = np.arange(FINE / 2, 2 * float(np.linalg.norm(near.places, axis=1).max()) + 1, FINE)
    table = profile(r, radius, blur)
    steep, spread = np.gradient(table, FINE), (profile(r, radius, 1.001 * blur) - table) / 0.001
    count = len(near.places)
    part, moved, wider = np.zeros(count), np.zeros((count, 3)), np.zeros(count)
    for corner in np.ndindex(2, 2, 2):
        d = near.places - center + (np.array(corner) - 0.5) * near.spacing / np.sqrt(3)
        far = np.maximum(np.sqrt(np.einsum("ni,ni->n", d, d)), FINE / 2)
        part += np.interp(far, r, table) / 8
        moved -= (np.interp(far, r, steep) / far / 8)[:, None] * d
        wider += np.interp(far, r, spread) / 8
    return part, moved, wider


def _background(places: Floats, theta: Floats) -> tuple[Floats, Floats]:
    """Return the background (N,), HU, and its derivatives by step, face and offset (N, 5)."""
    depth = places @ theta[FACE] + theta[OFFSET]
    beyond = ndtr(depth)
    rise = theta[STEP] * np.exp(-(depth**2) / 2) / np.sqrt(2 * np.pi)
    turned = np.column_stack([beyond, rise[:, None] * places, rise])
    return theta[LEVEL] + theta[STEP] * beyond, turned
