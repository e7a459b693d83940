"""What is foretold of a run: its first readings say how it lies in the tracker's frame, the rest is ahead.

Given the deflections y of one draw of the parameters, the readings of a run are Gaussian,

    t = y + F n + noise,        n = (shift, slope),   shift free,   slope ~ N(m, v)

with m and v from the runs fitted to: m the mean of the slopes that y leaves in them, v what their scatter s^2
says of one more run, s^2 (1 + 1/k) (k - 1) / (k - 3), the variance of Student's t for k runs. Conditioned on
the first readings this is Gaussian again. What the run does further on enters nowhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError
from needlefit.inference.tracks.evidence import TrackEvidence

Floats = NDArray[np.float64]

FREE = 100.0
"""Prior deviation of a shift, mm: no reading lies as far from another."""

FEWEST = 4
"""Runs from whose scatter the slope of a further one is told."""


@dataclass(frozen=True)
class Drawn:
    """B draws of a model: what it makes of some runs, and the scale of the noise.

    Attributes
    ----------
    tuned, held : tuples of (B, n) arrays
        Deflections at the readings of the runs fitted to, and of those foretold, mm.
    scale : (B,) array
        What the stated deviations of the noise are multiplied by.
    """

    tuned: tuple[Floats, ...]
    held: tuple[Floats, ...]
    scale: Floats


@dataclass(frozen=True)
class Slopes:
    """Mean and variance (B,) of a further run's slope in the tracker's frame."""

    mean: Floats
    variance: Floats


def slopes(drawn: Drawn, tuned: Sequence[TrackEvidence]) -> Slopes:
    """Return what the runs fitted to say of the slope of another one, for every draw.

    Raises
    ------
    ConfigError
        If there are too few runs to take a scatter from.
    """
    k = len(tuned)
    if k < FEWEST:
        raise ConfigError(
            f"{k} runs say too little of the slope of another one",
            expected=f"at least {FEWEST} runs to fit to",
            fix="tune on more runs",
        )
    pairs = zip(tuned, drawn.tuned, strict=True)
    each = np.array([(known.track.tip - y) @ known.estimator[1] for known, y in pairs])  # (k, B)
    inflated = (1 + 1 / k) * (k - 1) / (k - 3)
    return Slopes(each.mean(axis=0), inflated * each.var(axis=0, ddof=1))


def ahead(
    known: TrackEvidence,
    deflection: Floats,
    scale: Floats,
    slope: Slopes,
    placed: int,
    rng: np.random.Generator,
) -> Floats:
    """Return draws (B, n - placed) of the readings of a run after its first `placed` ones, mm.

    Parameters
    ----------
    deflection : (B, n) array
        Of the run's tip, one row a draw.
    """
    design = known.frame  # (n, 2)
    spread = np.zeros((len(scale), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = FREE**2, slope.variance
    noise = known.covariance * scale[:, None, None] ** 2
    total = noise + design @ spread @ design.T  # (B, n, n)
    mean = deflection + slope.mean[:, None] * design[:, 1]
    gain = np.linalg.solve(total[:, :placed, :placed], total[:, :placed, placed:])  # (B, k, n - k)
    off = known.track.tip[:placed] - mean[:, :placed]
    centre = mean[:, placed:] + np.einsum("bk,bkr->br", off, gain)
    left = total[:, placed:, placed:] - gain.transpose(0, 2, 1) @ total[:, :placed, placed:]
    root = np.linalg.cholesky(left)
    drawn: Floats = centre + np.einsum("brs,bs->br", root, rng.normal(size=centre.shape))
    return drawn
