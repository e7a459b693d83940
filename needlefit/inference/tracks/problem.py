"""A fit to tip tracks: its observations, and the methods that searches and samplers need.

The unknown frame of the tracker is projected out of each run.

A reading is t_i = y(d_i) + shift + slope d_i + noise. Shift and slope are of the tracker, not of the needle,
and known of no run: the limit of a flat prior of both, as of a free pose (docs/inference.md, section 3).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Noise
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import ConfigError, DataError
from needlefit.inference.likelihood.observation import points_covariance, whiten
from needlefit.inference.parameters import NOISE_SCALE_BOUNDS, Parameters, Theta
from needlefit.inference.ties import NOISE_SCALE
from needlefit.inference.tracks.simulation import Values, simulate_tips
from needlefit.mechanics.needle import Needle
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import ObjectiveName

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TrackObservation:
    """One run, prepared for comparison with simulated tips.

    Attributes
    ----------
    track : TipTrack
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
        """The change (n, 2) of the readings by a unit shift (mm) and a unit slope of the tracker's frame."""
        return frame_columns(self.track.depth)

    @cached_property
    def estimator(self) -> Floats:
        """Matrix (2, n) that gives the best shift and slope for readings minus deflections (n,)."""
        weighted = np.linalg.solve(self.covariance, self.frame)  # (n, 2)
        return np.asarray(np.linalg.solve(self.frame.T @ weighted, weighted.T), dtype=np.float64)


def frame_columns(depth: Floats) -> Floats:
    """Return the columns (n, 2) of a shift and of a slope along `depth` (n,)."""
    return np.column_stack([np.ones(len(depth)), depth])


def make_track_observation(track: TipTrack, noise: Noise) -> TrackObservation:
    """Return the observation of one run.

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
    whitening, log_norm = whiten(covariance, frame_columns(track.depth))
    return TrackObservation(track, covariance, whitening, log_norm)


DIFFERENCE_STEP = 1e-3
"""Step of the central differences, in theta: errors of 1e-6 from the step, 1e-4 mm at most from solves."""

SCALE_MARGIN = 0.99
"""Part of the smallest noise scale at which its residual begins."""


@dataclass(frozen=True)
class TrackProblem:
    """Some runs with one needle, the model of a medium, and the parameters that are searched.

    Attributes
    ----------
    needle : Needle
    tracks : tuple of TipTrack
        The ones fitted to.
    medium : MediumRecord
    parameters : Parameters
        With `guide_distance_mm`, and a noise scale if it is estimated.
    noise : Noise
    """

    needle: Needle
    tracks: tuple[TipTrack, ...]
    medium: MediumRecord
    parameters: Parameters
    noise: Noise

    def __post_init__(self) -> None:
        if not self.tracks:
            raise ConfigError("no run is selected to fit to", expected="at least one")
        if "guide_distance_mm" not in self.parameters.names:
            raise ConfigError(
                "the medium says nothing of the guide",
                key="parameters",
                expected="guide_distance_mm: from the guide to the skin, free or fixed",
            )

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return self.parameters.lower

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return self.parameters.upper

    @property
    def squares(self) -> bool:
        """Whether the log posterior is a constant minus half the residuals' squares."""
        return True

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of theta."""
        return self.parameters.free

    def values(self, theta: Theta) -> dict[str, float]:
        """Return every parameter's value (Pa, mm)."""
        return self.parameters.values(theta)

    @cached_property
    def observations(self) -> tuple[TrackObservation, ...]:
        """The observation of each run; computed once."""
        return tuple(make_track_observation(track, self.noise) for track in self.tracks)

    def tips(self, sets: Sequence[Values], jobs: int = 1) -> tuple[Floats, ...]:
        """Return the simulated tips (B, n) of every run, mm."""
        return simulate_tips(sets, self.medium, self.needle, self.tracks, jobs)

    def log_posterior(self, theta: Theta) -> float:
        """Return the log of the unnormalised posterior density; -inf outside, NaN where a solve fails."""
        return float(self.log_posteriors(np.array([theta]))[0])

    def log_posteriors(self, thetas: Floats, jobs: int = 1) -> Floats:
        """Return `log_posterior` (W,) of many thetas (W, P) at once, on `jobs` threads."""
        density = np.full(len(thetas), -np.inf)
        inside = np.flatnonzero(np.all((thetas >= self.lower) & (thetas <= self.upper), axis=1))
        if len(inside):
            sets = [self.values(thetas[w]) for w in inside]
            density[inside] = self._log_densities(sets, jobs)
        return density

    def gradient(self, theta: Theta) -> tuple[float, Floats]:
        """Return `log_posterior` and its gradient (P,); NaN where a solve fails."""
        residuals, slopes = self.jacobian(theta)
        return self.log_posterior(theta), -(residuals @ slopes)

    def residuals(self, theta: Theta) -> Floats:
        """Return whitened residuals (R,): of the runs, of the noise scale if it is free, of the prior."""
        found: Floats = self._residuals([self.values(theta)])[0]
        return found

    def jacobian(self, theta: Theta) -> tuple[Floats, Floats]:
        """Return the residuals (R,) and their derivatives (R, P), by central differences of one batch."""
        at = np.asarray(theta, dtype=np.float64)
        moves = DIFFERENCE_STEP * np.eye(len(at))
        found = self._residuals([self.values(one) for one in (at, *(at + moves), *(at - moves))])
        plus, minus = np.split(found[1:], 2)
        return found[0], (plus - minus).T / (2 * DIFFERENCE_STEP)

    def approach(self, minimized: ObjectiveName) -> None:
        """Return None: no depth is uncertain, so no easier posterior exists."""

    def _log_densities(self, sets: Sequence[Values], jobs: int) -> Floats:
        prior = np.array([self.parameters.prior.log_density(values) for values in sets])
        scales = np.array([_scale(values) for values in sets])
        norm = sum(observation.log_norm for observation in self.observations) - self._rows * np.log(scales)
        off = np.sum(self._white(sets, jobs) ** 2, axis=1) / scales**2
        density: Floats = prior + norm - 0.5 * off
        return density

    @property
    def _rows(self) -> int:
        return sum(len(observation.whitening) for observation in self.observations)

    def _white(self, sets: Sequence[Values], jobs: int = 1) -> Floats:
        """Return the whitened differences (B, R) of all runs, at noise scale 1."""
        pairs = zip(self.observations, self.tips(sets, jobs), strict=True)
        return np.concatenate(
            [(tip - observation.track.tip) @ observation.whitening.T for observation, tip in pairs], axis=1
        )

    def _residuals(self, sets: Sequence[Values]) -> Floats:
        scales = np.array([[_scale(values)] for values in sets])
        parts = [self._white(sets) / scales]
        if NOISE_SCALE in self.names:
            # 1 keeps it from 0, where its derivative would be infinite, and differences step over the bound
            parts.append(
                np.sqrt(1.0 + 2 * self._rows * np.log(scales / (SCALE_MARGIN * NOISE_SCALE_BOUNDS[0])))
            )
        parts.append(np.array([self.parameters.prior.residuals(values) for values in sets]))
        return np.concatenate(parts, axis=1)


def _scale(values: Values) -> float:
    return values.get(NOISE_SCALE, 1.0)
