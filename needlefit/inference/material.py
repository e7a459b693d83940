"""Pool the specimens of a compression test, and turn the result into the prior of a layer.

The needle goes into a specimen that no machine compressed. What is known of it is the mean of those that
were, its own uncertainty, and the spread between specimens, as a rule far larger than the noise within one:

    theta_i = theta + between + within,   theta = (ln mu, alpha)

The scatter S of m estimates holds both; what a further specimen may be is S (1 + 1 / m), exactly as wide
whatever the share of each. The spread alone, S less the mean covariance within, is given too.

From the test to the prior of a layer:

Alpha carries over as it is: it has no unit, no geometry, and k(lambda) / k(1) depends on it alone. mu does
not. The test gives the shear modulus of the material; the model's mu is a foundation modulus, k(1) = 3 mu
being force per length per deflection, and what lies between the two is how the needle moves the tissue
around it. That factor is not in the test, so mu's prior is stated only by who states the factor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from needlefit.arrays import Floats
from needlefit.datasets.compression import CompressionTest
from needlefit.errors import ConfigError
from needlefit.inference.parameters import state_usual_bounds
from needlefit.inference.specimen_fit import (
    NORMAL_95_HALF_WIDTH_SD,
    UPPER_QUANTILE_95,
    SpecimenFit,
    fit_specimen,
)
from needlefit.schemas.medium import MaterialRecord, MediumRecord, ParameterRecord, PriorRecord


@dataclass(frozen=True)
class MaterialEstimate:
    """The predicted distribution of a further specimen, given those of one compression test.

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
        few specimens that determine the scatter. With a single specimen its own alone, widened for the few
        independent points that determine its noise.
    """

    fits: tuple[SpecimenFit, ...]
    pooled: tuple[str, ...]
    mean: Floats
    between: Floats
    covariance: Floats

    @property
    def alpha_identified(self) -> bool:
        """Whether any specimen identifies alpha."""
        return bool(self.pooled)

    @property
    def sds(self) -> tuple[float, float]:
        """Standard deviations of ln mu and alpha of a further specimen."""
        return math.sqrt(self.covariance[0, 0]), math.sqrt(self.covariance[1, 1])


def fit_material(test: CompressionTest) -> MaterialEstimate:
    """Fit every specimen of a test, and pool those that identify alpha.

    Raises
    ------
    FitError
        If some specimen cannot be fitted at all.
    """
    fits = tuple(fit_specimen(specimen, test.measure) for specimen in test.specimens)
    identified_fits = [fit for fit in fits if fit.identified]
    mean, between, covariance = pool(
        [np.array([math.log(fit.mu), fit.alpha]) for fit in identified_fits],
        [fit.covariance for fit in identified_fits],
    )
    if len(identified_fits) == 1:
        covariance = identified_fits[0].small_sample_factor ** 2 * covariance
    return MaterialEstimate(
        fits, tuple(fit.specimen.name for fit in identified_fits), mean, between, covariance
    )


def pool(estimates: Sequence[Floats], covariances: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
    """Pool estimates (P,): return mean (P,), covariance between them, and covariance of a further one, (P,
    P).

    Where there are none all are NaN; of a single one nothing can be known between.
    """
    count = len(estimates)
    if count == 0:
        return np.full(2, np.nan), np.full((2, 2), np.nan), np.full((2, 2), np.nan)
    if count == 1:
        return estimates[0], np.full_like(covariances[0], np.nan), covariances[0]
    scatter = np.cov(np.array(estimates).T)
    # few specimens determine the scatter badly: Student's quantile makes the 95 % interval hold
    small_sample_factor = stdtrit(count - 1, UPPER_QUANTILE_95) / NORMAL_95_HALF_WIDTH_SD
    mean: Floats = np.mean(estimates, axis=0)
    between = _nearest_positive(scatter - np.mean(covariances, axis=0))
    return mean, between, small_sample_factor**2 * (1 + 1 / count) * scatter


def _nearest_positive(matrix: Floats) -> Floats:
    """Return the nearest matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh(matrix)
    nearest: Floats = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return nearest


ALPHA_REACH_SD = 4.0
"""A fixed alpha that a test identifies becomes free within this many standard deviations."""

TEST_LAW = "ogden"
"""The law that alpha and mu of a compression test belong to."""

NUMBER_FORMAT = ".6g"


@dataclass(frozen=True)
class MaterialFoundation:
    """The user's factor between the mu of the model and the shear modulus of the material.

    Attributes
    ----------
    factor : float
        Its median.
    spread : float
        Known within this factor, above 1: a standard deviation of the logarithm.
    """

    factor: float
    spread: float

    def __post_init__(self) -> None:
        if not (self.factor > 0 and self.spread > 1 and math.isfinite(self.factor * self.spread)):
            raise ConfigError(
                f"a foundation factor of {self.factor:g} within a factor of {self.spread:g} cannot be",
                where="--foundation",
                expected="FACTOR above 0 and SPREAD above 1, e.g. 0.2 5",
            )


def make_material_prior(
    material: MaterialEstimate, foundation: MaterialFoundation | None
) -> tuple[PriorRecord, PriorRecord | None]:
    """Return the priors of alpha and, where its foundation factor is stated, of the model's mu (Pa).

    `material` must identify alpha.
    """
    log_mu, alpha = material.mean.tolist()
    sd = material.sds[1]
    of_alpha = PriorRecord(mean=_round(alpha), sd=_round(sd))
    if foundation is None:
        return of_alpha, None
    sd_mu = math.hypot(material.sds[0], math.log(foundation.spread))
    of_mu = PriorRecord(
        median=_round(foundation.factor * math.exp(log_mu) * 1e6),
        factor=_round(math.exp(sd_mu)),
        # a correlation of exactly 1 would make the covariance singular
        correlation=_round(float(np.clip(material.covariance[0, 1] / (sd_mu * sd), -0.99, 0.99))),
    )
    return of_alpha, of_mu


def set_material_prior(medium: MediumRecord, layer: str, material: MaterialRecord) -> MediumRecord:
    """Return the medium with the prior of a compression test on one layer.

    An alpha that the medium fixes becomes free within `ALPHA_REACH_SD` standard deviations of its prior's
    mean.

    Raises
    ------
    ConfigError
        If there is no such layer, the medium's law is another one, or the layer's parameter is tied or fixed.
    """
    if layer not in {str(number) for number in range(1, medium.layers + 1)}:
        raise ConfigError(f"there is no layer `{layer}`", expected=f"a number from 1 to {medium.layers}")
    if medium.law != TEST_LAW:
        raise ConfigError(
            f"the medium's law is `{medium.law}`",
            expected=f"`{TEST_LAW}`: the prior is of its alpha",
        )
    table = state_usual_bounds(medium) | medium.parameters
    for name, stated in ((f"mu{layer}_pa", material.mu_pa), (f"alpha{layer}", material.alpha)):
        if stated is not None and name in table:
            table[name] = _free_parameter(name, table[name], stated)
    return medium.model_copy(update={"parameters": table})


def _free_parameter(name: str, parameter: ParameterRecord, stated: PriorRecord) -> ParameterRecord:
    bounds = parameter.bounds
    if bounds is None and parameter.fixed is not None and stated.mean is not None and stated.sd is not None:
        bounds = (stated.mean - ALPHA_REACH_SD * stated.sd, stated.mean + ALPHA_REACH_SD * stated.sd)
    if bounds is None:
        state = "tied" if parameter.tie else "fixed"
        fix = (
            "give it bounds, or the prior to the layer that it is tied to"
            if parameter.tie
            else "give it bounds"
        )
        raise ConfigError(f"a prior is stated for {name}, which is {state}", fix=fix)
    return ParameterRecord(bounds=bounds, prior=stated)


def _round(value: float) -> float:
    return float(format(value, NUMBER_FORMAT))
