"""Predict the later readings of a run from its first ones, by draws of a model or by baseline curves.

Given the deflections y of one draw of the parameters, the readings of a run are Gaussian,

    t = y + F n + noise,        n = (shift, slope),   shift free,   slope ~ N(m, v)

with m and v from the runs fitted to: m the mean of the slopes that y leaves in k of them, v what their
scatter s^2, of f degrees of freedom, says of one more run, s^2 (1 + 1/k) f / (f - 2), the variance of
Student's t; f is k - 1 where all runs are taken. Conditioned on the first readings this is Gaussian again.
What the run does further on enters nowhere.

Baselines: curves without tissue or guide, fitted to the same runs.

A straight line leaves nothing to fit but each run's shift and slope. A parabola has one curvature for all
runs, toward the bevel; these and others are entries of `inference.baselines`. The scale of the noise is what
they leave of the runs fitted to, so that what they predict is as wide as their residuals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.tip_tracks import TipTrack
from needlefit.errors import ConfigError
from needlefit.inference.baselines import BASELINES, Baseline
from needlefit.inference.likelihood.observation import Observation, whiten

SHIFT_SD_MM = 100.0
"""Prior deviation of a shift, mm: no reading lies as far from another."""

MIN_TUNED_RUNS = 4
"""Runs from whose scatter the slope of a further one is estimated."""


@dataclass(frozen=True)
class TrackDraws:
    """B draws of a model: the deflections of some runs, and the scale of the noise.

    Attributes
    ----------
    tuned, held_out : tuples of (B, n) arrays
        Deflections at the readings of the runs fitted to, and of those predicted, mm.
    scale : (B,) array
        What the stated deviations of the noise are multiplied by.
    alike : bool
        Whether the slope of a run is estimated from those alone whose guide moved, or rested, as in it.
    """

    tuned: tuple[Floats, ...]
    held_out: tuple[Floats, ...]
    scale: Floats
    alike: bool = False


@dataclass(frozen=True)
class SlopeMoments:
    """Mean and variance (B,) of the slope of a further run in the tracker's frame."""

    mean: Floats
    variance: Floats


def estimate_slopes(
    drawn: TrackDraws, tuned: Sequence[Observation], further: Insertion | None = None
) -> SlopeMoments:
    """Estimate the slope of another run from the runs fitted to, for every draw.

    Where runs alike tell it, their scatter is taken from both kinds, each about its own mean.

    Raises
    ------
    ConfigError
        If there are too few runs to take a scatter from.
    """
    k = len(tuned)
    if k < MIN_TUNED_RUNS:
        raise ConfigError(
            f"{k} runs say too little of the slope of another one",
            expected=f"at least {MIN_TUNED_RUNS} runs to fit to",
            fix="tune on more runs",
        )
    pairs = zip(tuned, drawn.tuned, strict=True)
    each = np.array([(one.measured[:, 1] - y) @ one.estimator[1] for one, y in pairs])  # (k, B)
    kinds = np.array([_is_guided(one.insertion) for one in tuned])
    apart = drawn.alike and k > MIN_TUNED_RUNS and np.any(kinds == _is_guided(further))
    kinds, like = (kinds, kinds == _is_guided(further)) if apart else (np.full(k, False), np.full(k, True))
    squares = sum(len(one) * one.var(axis=0) for one in (each[kinds], each[~kinds]) if len(one))
    freedom = k - len(set(kinds.tolist()))
    variance = squares / freedom * (1 + 1 / like.sum()) * freedom / (freedom - 2)
    return SlopeMoments(each[like].mean(axis=0), variance)


def _is_guided(insertion: Insertion | None) -> bool:
    return isinstance(insertion, TipTrack) and insertion.guided


def predict_readings(
    observation: Observation,
    deflection: Floats,
    scale: Floats,
    slope: SlopeMoments,
    observed_count: int,
    rng: np.random.Generator,
) -> Floats:
    """Return draws (B, n - observed_count) of the readings of a run after the first `observed_count`, mm.

    Parameters
    ----------
    deflection : (B, n) array
        Of the run's tip, one row a draw.
    """
    design = observation.free  # (n, 2)
    spread = np.zeros((len(scale), 2, 2))
    spread[:, 0, 0], spread[:, 1, 1] = SHIFT_SD_MM**2, slope.variance
    noise = observation.point_covariance * scale[:, None, None] ** 2
    total = noise + design @ spread @ design.T  # (B, n, n)
    mean = deflection + slope.mean[:, None] * design[:, 1]
    # conditioning of a joint Gaussian: gain^T takes the residuals of the first readings to the later ones
    gain = np.linalg.solve(
        total[:, :observed_count, :observed_count], total[:, :observed_count, observed_count:]
    )  # (B, k, n - k)
    off = observation.measured[:, 1][:observed_count] - mean[:, :observed_count]
    centre = mean[:, observed_count:] + np.einsum("bk,bkr->br", off, gain)
    remaining = (
        total[:, observed_count:, observed_count:]
        - gain.transpose(0, 2, 1) @ total[:, :observed_count, observed_count:]
    )
    root = np.linalg.cholesky(remaining)
    drawn: Floats = centre + np.einsum("brs,bs->br", root, rng.normal(size=centre.shape))
    return drawn


def draw_baseline(
    baseline: Baseline,
    tuned: Sequence[Observation],
    held_out: Sequence[Insertion],
    count: int,
    rng: np.random.Generator,
) -> TrackDraws:
    """Return `count` draws of a baseline given the runs `tuned`: Student's t about least squares.

    Raises
    ------
    ValueError
        If the baseline has no `track_basis`.
    """
    if baseline.track_basis is None:
        raise ValueError(f"the baseline {baseline.name} predicts no tip tracks")
    with BASELINES.plugin_error_context(baseline.name):
        known = [_find_basis(baseline, one.insertion) for one in tuned]  # each (n, P)
        further = [_find_basis(baseline, track) for track in held_out]
    session = baseline.track_slope == "session"
    white = [whiten(one.covariance(), one.free[:, :1])[0] if session else one.whitening for one in tuned]
    basis = np.concatenate([one @ columns for one, columns in zip(white, known, strict=True)])
    used = np.linalg.norm(basis, axis=0) > 0  # without a moved guide its effects are not known: taken as none
    basis, known, further = basis[:, used], [one[:, used] for one in known], [one[:, used] for one in further]
    measured = np.concatenate([one @ seen.measured[:, 1] for one, seen in zip(white, tuned, strict=True)])
    unknowns = basis.shape[1]
    best = np.linalg.solve(basis.T @ basis, basis.T @ measured)
    squares = float(np.sum((measured - basis @ best) ** 2))
    # the order of the draws matters for the result: scale first, then coefficients. A straight line, which
    # has none, draws and drops one of them.
    scale = np.sqrt(squares / rng.chisquare(len(measured) - unknowns, size=count))
    normal = rng.normal(size=(max(1, unknowns), count))[:unknowns]
    root = np.linalg.cholesky(np.linalg.inv(basis.T @ basis))
    coefficients = best + (scale * (root @ normal)).T  # (B, P)
    return TrackDraws(
        tuple(coefficients @ columns.T for columns in known),
        tuple(coefficients @ columns.T for columns in further),
        scale,
        baseline.track_slope == "alike",
    )


def _find_basis(baseline: Baseline, track: Insertion) -> Floats:
    """Return the deflections (n, P) by unit coefficients; where runs share a slope, it is the last one."""
    assert baseline.track_basis is not None
    columns = baseline.track_basis(track)
    return np.column_stack([columns, track.planar[:, 0]]) if baseline.track_slope == "session" else columns
