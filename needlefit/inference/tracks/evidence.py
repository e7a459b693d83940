"""One run made ready to be compared: what the tracker's frame leaves unknown is projected off.

A reading is t_i = y(d_i) + shift + slope d_i + noise. Shift and slope are of the tracker, not of the needle,
and known of no run: the limit of a flat prior of both, as of a free pose (docs/inference.md, section 3).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Noise
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import DataError
from needlefit.inference.likelihood.covariance import points_covariance
from needlefit.inference.likelihood.evidence import whiten

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TrackEvidence:
    """One run, ready to be compared.

    Attributes
    ----------
    track : Track
    covariance : (n, n) array
        Of the noise of its readings, mm^2, at scale 1.
    whitening : (n - 2, n) array
        Takes differences of tips to independent ones of unit variance, without what shift and slope can do.
    log_norm : float
    """

    track: TipTrack
    covariance: Floats
    whitening: Floats
    log_norm: float

    @property
    def frame(self) -> Floats:
        """What a unit shift (mm) and a unit slope of the tracker's frame do to the readings, (n, 2)."""
        return frame(self.track.depth)

    @cached_property
    def estimator(self) -> Floats:
        """Takes readings less deflections (n,) to the shift and slope (2,) that fit them best."""
        weighed = np.linalg.solve(self.covariance, self.frame)  # (n, 2)
        return np.asarray(np.linalg.solve(self.frame.T @ weighed, weighed.T), dtype=np.float64)


def frame(depth: Floats) -> Floats:
    """Return the columns (n, 2) of a shift and of a slope along `depth` (n,)."""
    return np.column_stack([np.ones(len(depth)), depth])


def track_evidence(track: TipTrack, noise: Noise) -> TrackEvidence:
    """Return the evidence of one run.

    Raises
    ------
    DataError
        If no noise of single readings is stated: without any, a likelihood has no width.
    """
    if noise.point_sd <= 0:
        raise DataError(
            f"no noise of the readings of {track.id} is stated", where="noise", expected="point_sd_mm above 0"
        )
    covariance = points_covariance(track.depth, noise)
    whitening, log_norm = whiten(covariance, frame(track.depth))
    return TrackEvidence(track, covariance, whitening, log_norm)
