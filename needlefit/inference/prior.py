"""The stated prior: a Gaussian in theta, within the flat bounds."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import ConfigError
from needlefit.inference.ties import dimension
from needlefit.schemas.medium import ParameterRecord, PriorRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior of some parameters, in their coordinates of theta.

    Attributes
    ----------
    names : tuple of str
        Q of them.
    mean : (Q,) array
        Of the logarithm; of alpha itself.
    whitening : (Q, Q) array
        What takes deviations from the mean to independent ones of unit variance.
    """

    names: tuple[str, ...] = ()
    mean: tuple[float, ...] = ()
    whitening: tuple[tuple[float, ...], ...] = ()

    def residuals(self, values: Mapping[str, float]) -> Floats:
        """Return the whitened deviations (Q,) of `values` (Pa, mm) from the prior mean."""
        if not self.names:
            return np.empty(0)
        off = [
            to_coordinate(name, values[name]) - mean for name, mean in zip(self.names, self.mean, strict=True)
        ]
        white: Floats = np.array(self.whitening) @ np.array(off)
        return white

    def log_density(self, values: Mapping[str, float]) -> float:
        """Return the logarithm of the density of `values`, not normalised: 0 at its peak."""
        white = self.residuals(values)
        return -0.5 * float(white @ white)

    def slopes(self, names: Sequence[str]) -> Floats:
        """Return the derivatives (Q, P) of `residuals` by theta of the free parameters `names`."""
        # a fixed parameter has no column: its residual is constant
        chosen = np.array([[float(name == own) for name in names] for own in self.names])  # (Q, P)
        if not self.names:
            return np.zeros((0, len(names)))
        slopes: Floats = np.array(self.whitening) @ chosen
        return slopes

    def information(self, names: Sequence[str]) -> Floats:
        """Return the precision (P, P) of theta of the free parameters `names`; 0 where nothing is stated."""
        slopes = self.slopes(names)
        precision: Floats = slopes.T @ slopes
        return precision

    def sd(self, name: str) -> float:
        """Return the standard deviation of one parameter's coordinate; infinite where nothing is stated."""
        if name not in self.names:
            return math.inf
        spread = np.linalg.inv(np.array(self.whitening))
        return float(np.linalg.norm(spread[self.names.index(name)]))

    def describe(self, name: str) -> str:
        """Describe the prior of one parameter as the end of a sentence; empty if there is none."""
        if name not in self.names:
            return ""
        mean, sd = self.mean[self.names.index(name)], self.sd(name)
        if dimension(name) == "exponent":
            known = f"{mean:.3g} +- {sd:.2g}"
        else:
            known = f"{math.exp(mean):.3g}, within a factor of {math.exp(sd):.2g}"
        return f"; stated before: {known} (counts in the posterior, not in the errors minimised)"


def make_prior(table: Mapping[str, ParameterRecord]) -> Prior:
    """Return the prior that the parameters of a medium state.

    Raises
    ------
    ConfigError
        If a prior is of the wrong kind, peaks outside the bounds, or its correlation has no partner.
    """
    stated = {name: record.prior for name, record in table.items() if record.prior is not None}
    for name, one in stated.items():
        _check(name, one, table[name].bounds, stated)
    if not stated:
        return Prior()
    names = tuple(stated)
    sds = [_sd(one) for one in stated.values()]
    correlations = np.eye(len(names))
    for k, (name, one) in enumerate(stated.items()):
        if one.correlation:
            j = names.index(_alpha_of(name))
            correlations[j, k] = correlations[k, j] = one.correlation
    peaks = np.array([to_coordinate(name, _peak(one)) for name, one in stated.items()])
    return make_gaussian_prior(names, peaks, correlations * np.outer(sds, sds))


def make_gaussian_prior(names: Sequence[str], mean: Floats, covariance: Floats) -> Prior:
    """Return a Gaussian prior with `mean` (Q,) and `covariance` (Q, Q) in theta's coordinates of `names`."""
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    return Prior(tuple(names), tuple(mean.tolist()), tuple(tuple(row) for row in whitening.tolist()))


def _check(
    name: str, one: PriorRecord, bounds: tuple[float, float] | None, stated: Mapping[str, PriorRecord]
) -> None:
    key = f"parameters.{name}.prior"
    normal = dimension(name) == "exponent"
    if normal != (one.mean is not None):
        expected = "mean and sd" if normal else "median and factor: it is positive"
        raise ConfigError("is a prior of the wrong kind", key=key, expected=expected)
    if bounds is not None and not bounds[0] <= _peak(one) <= bounds[1]:
        raise ConfigError(
            f"peaks at {_peak(one):g}, outside the bounds {bounds[0]:g} to {bounds[1]:g}",
            key=key,
            fix="widen the bounds, or look whether prior and bounds mean the same unit",
        )
    if one.correlation and (dimension(name) != "modulus" or _alpha_of(name) not in stated):
        expected = "a prior of mu whose layer's alpha has a prior too"
        raise ConfigError("states a correlation that has no partner", key=key, expected=expected)


def _alpha_of(mu: str) -> str:
    return mu.replace("mu", "alpha").removesuffix("_pa")


def to_coordinate(name: str, value: float) -> float:
    """Return the coordinate of a parameter in theta: the logarithm of its value, or alpha itself."""
    return value if dimension(name) == "exponent" else math.log(value)


def _peak(one: PriorRecord) -> float:
    return float(one.mean if one.mean is not None else one.median or math.nan)


def _sd(one: PriorRecord) -> float:
    return float(one.sd if one.sd is not None else math.log(one.factor or math.nan))
