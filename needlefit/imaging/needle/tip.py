"""Find the needle's tip: fit the image of a bevelled rod to the voxels around the end, and check it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.imaging.needle.axis_spline import AxisSpline, axis_frames, axis_sd
from needlefit.imaging.needle.tip_problem import EDGE_SD_MM, ROLL, TIP, TipProblem, U, V
from needlefit.imaging.sphere_profile import PointSpread
from needlefit.imaging.volume import Volume
from needlefit.schemas.reconstruction import ScannedNeedleRecord

TipSource = Literal["model", "threshold", "hand"]

MIN_BEVEL_PROBABILITY = 0.95
"""Probability from which on the side of the bevel is stated."""


@dataclass(frozen=True)
class TipFit:
    """The fitted tip.

    Attributes
    ----------
    at : float
        Along the spine, mm.
    point : (3,) array
        In the patient, mm; beside the spine, if the rod swung.
    sd : (2,) array
        Deviations along the needle, and across it in either direction, mm.
    bevel : (3,) array
        Unit vector across the needle to the side of the bevel's point; nan for a blunt end, or if its
        probability is below `MIN_BEVEL_PROBABILITY`.
    bevel_probability : float
        That the likeliest side is right, within 90 degrees; nan for a blunt end.
    disagreement : float
        By how much a threshold sees the needle end later than it sees the fitted model end, mm.
    source : str
        What the place along comes from: "model", "threshold" where the model is not to be trusted, or "hand".
    hidden_length : float
        Length of the needle along which rays run that may hide its end, mm.
    """

    at: float
    point: Floats
    sd: Floats
    bevel: Floats
    bevel_probability: float
    disagreement: float
    source: TipSource
    hidden_length: float = 0.0


def fit_tip(
    volume: Volume,
    axis: AxisSpline,
    needle: ScannedNeedleRecord,
    guess: float,
    spread: PointSpread | None = None,
    *,
    rough: bool = False,
) -> TipFit:
    """Fit the tip near `guess` (mm along the axis) by least squares over the voxels around it.

    The tip is where the axis ends that reaches as far as the bevel's point does. The rod is moved along the
    axis, rolled about it, and swung across it from the last cross-section on; the bevel's angle is the
    recipe's within its deviation.

    `spread` is the scanner's, as balls in the same volume show it; `rough`: whether the place to a fraction
    of a millimetre is enough.
    """
    problem = TipProblem(volume, axis, needle, guess, spread)
    best = problem.fit(rough=rough)
    covariance = problem.covariance(best)
    variance = np.diag(covariance)
    away = problem.threshold_disagreement(best.x)
    parts = [np.sqrt(variance[TIP]), EDGE_SD_MM, DISAGREEMENT_SD * away, HIDDEN_END_SD_PER_MM * problem.ray]
    along = float(np.linalg.norm(parts))
    heel = float(axis_sd(axis, np.array([axis.length]))[0])  # from where the rod swings
    across = float(np.hypot(np.sqrt(variance[[U, V]].mean()), heel))
    at = float(best.x[TIP])
    source: TipSource = "model"
    if not rough and not (along <= MAX_MODEL_SD_MM and abs(away) <= MAX_DISAGREEMENT_MM):
        at, along, source = _end_by_threshold(at, away, volume)
    there = axis_frames(axis, np.array([at]))
    u, v, roll = there.u[0], there.v[0], best.x[ROLL]
    probability = problem.bevel_probability(best, covariance) if problem.rolled and not rough else np.nan
    sided = probability >= MIN_BEVEL_PROBABILITY and source == "model"
    bevel = np.cos(roll) * u + np.sin(roll) * v if sided else np.full(3, np.nan)
    point = there.origins[0] + best.x[U] * u + best.x[V] * v
    return TipFit(at, point, np.array([along, across]), bevel, float(probability), away, source, problem.ray)


def _end_by_threshold(at: float, away: float, volume: Volume) -> tuple[float, float, TipSource]:
    """Return where a threshold sees the end, its deviation, mm, and the source.

    Raises
    ------
    DataError
        If a threshold sees no end either.
    """
    if not np.isfinite(away):
        raise DataError(
            "the end of the needle does not show: no section near it is as bright as half the shaft",
            where="tip of the needle",
            expected="a needle that ends in the tissue, in the volume",
            fix="check that the scan holds the tip, away from other metal; or give a mask of the needle",
        )
    sd = np.linalg.norm([MAX_MODEL_SD_MM, DISAGREEMENT_SD * away, float(volume.spacing.max()) / 2])
    return at + away, float(sd), "threshold"


HIDDEN_END_SD_PER_MM = 0.02
"""Deviation of the place along, in parts of the length of the needle that rays pass: they harden, and
hide its end. Set as `BEVEL_RAY_MM`."""

DISAGREEMENT_SD = 0.5
"""Deviation of the place along, in parts of the disagreement with a threshold."""

MAX_MODEL_SD_MM, MAX_DISAGREEMENT_MM = 1.0, 1.5
"""Deviation along, and disagreement with a threshold, up to which the model's tip is taken, mm."""
