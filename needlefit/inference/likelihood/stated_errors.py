"""What the errors of an observation are made of: noise of points, an error of the model, what is stated."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.errors import DataError
from needlefit.project.toml import locate_key
from needlefit.schemas.recipe import LikelihoodRecord

PLAIN_LIKELIHOOD = LikelihoodRecord(bevel_spread=0.0)  #: likelihood in which all insertions have the same b


@dataclass(frozen=True)
class Discrepancy:
    """A smooth misfit of the model, independent between insertions: a Gaussian process along the needle."""

    #: sd, length: its standard deviation and the length over which it fades, mm
    sd: float
    length: float

    def covariance(self, s: Floats) -> Floats:
        """Return its covariance (K, K), mm^2, at arc lengths `s` (K,)."""
        apart = (s[:, None] - s) / self.length
        return self.sd**2 * np.exp(-0.5 * apart**2)


@dataclass(frozen=True)
class StatedErrors:
    """What the errors of an observation are made of, beside what its insertion states.

    Attributes
    ----------
    noise : Noise
        That of the dataset, or what replaces it.
    insertions : int
        So many are fitted together: they share the bias of an unknown measurement.
    model_error : Discrepancy or None
        Added to the errors of the measurement.
    smoothed : bool
        Whether the smoothing that the dataset states is applied to the simulation; else the stored points are
        taken as the needle's own.
    respond : callable or None
        Gives how points read at s (K,) change with the gain of each of M moves of the guide, (M, K, 3), mm.
    """

    dataset: Dataset
    noise: Noise
    likelihood: LikelihoodRecord = PLAIN_LIKELIHOOD
    insertions: int = 1
    model_error: Discrepancy | None = None
    smoothed: bool = False
    respond: Callable[[Insertion, Floats], Floats] | None = None

    @property
    def bevels_vary(self) -> bool:
        """Whether the bevel may differ between insertions."""
        return self.likelihood.bevel_spread > 0


def points_covariance(s: Floats, noise: Noise, sd: Floats | None = None) -> Floats:
    """Return the covariance (K, K), mm^2, of points at arc lengths `s` (K,).

    `sd` (K,), mm, is the deviation of each point's shared part; by default that of `noise` for all.
    """
    deviation = np.full(len(s), noise.correlated_sd) if sd is None else sd
    shared = np.outer(deviation, deviation) * noise.correlate(s)
    return noise.point_sd**2 * np.eye(len(s)) + shared


def no_errors_error(dataset: Dataset, insertion: Insertion) -> DataError:
    """Return the error of a dataset whose noise leaves the points of an insertion without errors."""
    return DataError(
        f"the noise stated by `{dataset.name}` leaves the points of `{insertion.id}` without errors",
        where=locate_key(dataset.path, "noise.point_sd_mm"),
        expected="noise.point_sd_mm above 0",
        fix="write how well a point is known, per axis",
    )
