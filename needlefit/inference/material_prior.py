"""From a compression test to the prior of a layer.

Alpha carries over as it is: it has no unit, no geometry, and k(lambda) / k(1) depends on it alone. mu does
not. The test gives the shear modulus of the material; the model's mu is a foundation modulus, k(1) = 3 mu
being force per length per deflection, and what lies between the two is how the needle moves the tissue
around it. That factor is not in the test, so mu's prior is stated only by who states the factor.
"""

import math
from dataclasses import dataclass

import numpy as np

from needlefit.errors import ConfigError
from needlefit.inference.population import Material
from needlefit.schemas.medium import MaterialRecord, MediumRecord, ParameterRecord, PriorRecord

REACH = 4.0
"""A fixed alpha that a test says something of becomes free within this many standard deviations."""

SAME_LAW = "ogden"
"""The law that alpha and mu of a compression test belong to."""

DIGITS = ".6g"


@dataclass(frozen=True)
class Foundation:
    """What the user knows of mu of the model over mu of the material.

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


def prior_of_material(
    material: Material, foundation: Foundation | None
) -> tuple[PriorRecord, PriorRecord | None]:
    """Return the priors of alpha and, where its foundation factor is stated, of the model's mu (Pa).

    `material` must identify alpha.
    """
    log_mu, alpha = material.mean.tolist()
    sd = material.sds[1]
    of_alpha = PriorRecord(mean=_short(alpha), sd=_short(sd))
    if foundation is None:
        return of_alpha, None
    sd_mu = math.hypot(material.sds[0], math.log(foundation.spread))
    of_mu = PriorRecord(
        median=_short(foundation.factor * math.exp(log_mu) * 1e6),
        factor=_short(math.exp(sd_mu)),
        correlation=_short(float(np.clip(material.covariance[0, 1] / (sd_mu * sd), -0.99, 0.99))),
    )
    return of_alpha, of_mu


def with_material(medium: MediumRecord, layer: str, material: MaterialRecord) -> MediumRecord:
    """Return the medium in which one layer has the prior of a compression test.

    An alpha that the medium fixes becomes free within `REACH` standard deviations of its prior's mean.

    Raises
    ------
    ConfigError
        If there is no such layer, the medium's law is another one, or the layer's parameter is tied or fixed.
    """
    if layer not in {str(number) for number in range(1, medium.layers + 1)}:
        raise ConfigError(f"there is no layer `{layer}`", expected=f"a number from 1 to {medium.layers}")
    if medium.law != SAME_LAW:
        raise ConfigError(
            f"the medium's law is `{medium.law}`",
            expected=f"`{SAME_LAW}`: the prior is of its alpha",
        )
    table = dict(medium.parameters)
    for name, stated in ((f"mu{layer}_pa", material.mu_pa), (f"alpha{layer}", material.alpha)):
        if stated is not None and name in table:
            table[name] = _freed(name, table[name], stated)
    return medium.model_copy(update={"parameters": table})


def _freed(name: str, parameter: ParameterRecord, stated: PriorRecord) -> ParameterRecord:
    bounds = parameter.bounds
    if bounds is None and parameter.fixed is not None and stated.mean is not None and stated.sd is not None:
        bounds = (stated.mean - REACH * stated.sd, stated.mean + REACH * stated.sd)
    if bounds is None:
        state = "tied" if parameter.tie else "fixed"
        fix = (
            "give it bounds, or the prior to the layer that it is tied to"
            if parameter.tie
            else "give it bounds"
        )
        raise ConfigError(f"a prior is stated for {name}, which is {state}", fix=fix)
    return ParameterRecord(bounds=bounds, prior=stated)


def _short(value: float) -> float:
    return float(format(value, DIGITS))
