"""Several specimens of one material: their mean, their spread, and what a further specimen may be.

The needle goes into a specimen that no machine compressed. What is known of it is the mean of those that
were, its own uncertainty, and the spread between specimens, as a rule far larger than the noise within one:

    theta_i = theta + between + within,   theta = (ln mu, alpha)

The scatter S of m estimates holds both; what a further specimen may be is S (1 + 1 / m), exactly as wide
whatever the share of each. The spread alone, S less the mean covariance within, is told besides.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from needlefit.datasets.compression import CompressionTest
from needlefit.inference.material import NORMAL, TWO_SIDED, SpecimenFit, fit_specimen

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """What the specimens of one test say of a further specimen.

    Attributes
    ----------
    fits : tuple of SpecimenFit
        One of each specimen.
    pooled : tuple of str
        The specimens whose alpha the test identifies: mean and spread are theirs.
    mean : (2,) array
        Of ln mu (mu in MPa) and alpha; NaN if no specimen identifies alpha.
    between : (2, 2) array
        Covariance between specimens, by moments; NaN with fewer than two.
    covariance : (2, 2) array
        Of a further specimen about `mean`, widened so that 1.96 standard deviations are 95 % in spite of the
        few specimens that tell the scatter. With a single specimen its own alone, widened for the few
        independent points that tell its noise.
    """

    fits: tuple[SpecimenFit, ...]
    pooled: tuple[str, ...]
    mean: Floats
    between: Floats
    covariance: Floats

    @property
    def alpha_identified(self) -> bool:
        """Whether alpha is known at all."""
        return bool(self.pooled)

    @property
    def sds(self) -> tuple[float, float]:
        """Standard deviations of ln mu and alpha of a further specimen."""
        return math.sqrt(self.covariance[0, 0]), math.sqrt(self.covariance[1, 1])


def fit_material(test: CompressionTest) -> Material:
    """Fit every specimen of a test, and pool those that identify alpha.

    Raises
    ------
    FitError
        If some specimen cannot be fitted at all.
    """
    fits = tuple(fit_specimen(specimen, test.measure) for specimen in test.specimens)
    kept = [fit for fit in fits if fit.identified]
    mean, between, covariance = pool(
        [np.array([math.log(fit.mu), fit.alpha]) for fit in kept], [fit.covariance for fit in kept]
    )
    if len(kept) == 1:
        covariance = kept[0].few ** 2 * covariance
    return Material(fits, tuple(fit.specimen.name for fit in kept), mean, between, covariance)


def pool(estimates: Sequence[Floats], covariances: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """Return mean (P,), covariance between, and covariance of a further one, (P, P), of estimates (P,).

    Where there are none all are NaN; of a single one nothing can be known between.
    """
    count = len(estimates)
    if count == 0:
        return np.full(2, np.nan), np.full((2, 2), np.nan), np.full((2, 2), np.nan)
    if count == 1:
        return estimates[0], np.full_like(covariances[0], np.nan), covariances[0]
    scatter = np.cov(np.array(estimates).T)
    few = student.ppf(TWO_SIDED, count - 1) / NORMAL
    mean: Floats = np.mean(estimates, axis=0)
    between = _positive(scatter - np.mean(covariances, axis=0))
    return mean, between, few**2 * (1 + 1 / count) * scatter


def _positive(matrix: Floats) -> Floats:
    """Return the nearest matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh(matrix)
    nearest: Floats = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return nearest
