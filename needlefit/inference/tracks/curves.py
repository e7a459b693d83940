"""What a model of tips must beat: curves that know neither tissue nor guide, fitted to the same runs.

A straight line leaves nothing to fit but each run's shift and slope. A parabola has one curvature for all
runs, toward the bevel. The scale of the noise is what they leave of the runs fitted to, so that what they
foretell is as wide as they deserve.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.tip_tracks import TipTrack
from needlefit.inference.tracks.evidence import TrackEvidence
from needlefit.inference.tracks.foresight import Drawn

Floats = NDArray[np.float64]

CURVES = ("straight", "constant_curvature")


def fit_curve(
    name: str, tuned: Sequence[TrackEvidence], held: Sequence[TipTrack], count: int, rng: np.random.Generator
) -> Drawn:
    """Return `count` draws of the curve `name` given the runs `tuned`: Student's t about least squares."""
    bent = np.concatenate([known.whitening @ _bow(known.track) for known in tuned])
    seen = np.concatenate([known.whitening @ known.track.tip for known in tuned])
    fitted = name == "constant_curvature"
    best = float(bent @ seen / (bent @ bent)) if fitted else 0.0
    squares, free = float(np.sum((seen - best * bent) ** 2)), len(seen) - fitted
    scale = np.sqrt(squares / rng.chisquare(free, size=count))
    curvature = best + fitted * scale / np.linalg.norm(bent) * rng.normal(size=count)
    return Drawn(
        tuple(np.outer(curvature, _bow(known.track)) for known in tuned),
        tuple(np.outer(curvature, _bow(track)) for track in held),
        scale,
    )


def _bow(track: TipTrack) -> Floats:
    """Return what a unit curvature toward the bevel does to the readings (n,), mm^2."""
    bow: Floats = track.side * track.depth**2 / 2
    return bow
