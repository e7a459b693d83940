"""The prior that a medium states of its parameters: Gaussians in theta, and ties with a spread."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.inference.parameter_names import dimension, is_shape_parameter, to_coordinate
from needlefit.schemas.medium import ParameterRecord, PriorRecord


@dataclass(frozen=True)
class SoftTie:
    """Says that ln(value / (factor * source's)) is normal about 0 with deviation ln `spread`."""

    name: str
    source: str
    factor: float
    spread: float


@dataclass(frozen=True)
class Prior:
    """A Gaussian prior of some parameters, in their coordinates of theta."""

    names: tuple[str, ...] = ()  #: q of them
    #: (R, Q) what takes logarithms, and shape parameters themselves, to independent numbers of unit variance;
    #: R < Q where only combinations are stated, as by a tie
    whitening: tuple[tuple[float, ...], ...] = ()
    centre: tuple[float, ...] = ()  #: (R,) their means
    ties: tuple[SoftTie, ...] = ()  #: those among it, for print

    def residuals(self, values: Mapping[str, float]) -> Floats:
        """Return the whitened deviations (R,) of `values` (Pa, mm) from the prior mean."""
        if not self.names:
            return np.empty(0)
        coordinates = np.array([to_coordinate(name, values[name]) for name in self.names])
        return np.array(self.whitening) @ coordinates - np.array(self.centre)

    def log_density(self, values: Mapping[str, float]) -> float:
        """Return the logarithm of the density of `values`, not normalised: 0 at its peak."""
        white = self.residuals(values)
        return -0.5 * float(white @ white)

    def slopes(self, names: Sequence[str]) -> Floats:
        """Return the derivatives (R, P) of `residuals` by theta of the free parameters `names`."""
        # a fixed parameter has no column: its residual is constant
        chosen = np.array(
            [[float(name == stated_name) for name in names] for stated_name in self.names]
        )  # (Q, P)
        if not self.names:
            return np.zeros((0, len(names)))
        return np.array(self.whitening) @ chosen

    def information(self, names: Sequence[str]) -> Floats:
        """Return the precision (P, P) of theta of the free parameters `names`; 0 where nothing is stated."""
        slopes = self.slopes(names)
        return slopes.T @ slopes

    @cached_property
    def marginals(self) -> Mapping[str, tuple[float, float]]:
        """Mean and standard deviation of the coordinate of each parameter that is not only tied."""
        white = np.array(self.whitening).reshape(len(self.whitening), len(self.names))
        inverse = np.linalg.pinv(white)  # (Q, R)
        # a parameter that is only tied to another one has any value: it is not in the span of the rows
        is_independent = np.isclose(np.diag(inverse @ white), 1.0)
        mean, sd = inverse @ np.array(self.centre), np.linalg.norm(inverse, axis=1)
        return {
            name: (float(mean[k]), float(sd[k])) for k, name in enumerate(self.names) if is_independent[k]
        }

    def sd(self, name: str) -> float:
        """Return the standard deviation of one parameter's coordinate; infinite where nothing is stated."""
        return self.marginals.get(name, (math.nan, math.inf))[1]

    def without(self, names: Collection[str]) -> "Prior":
        """Return the prior without parameters that are independent of all others, and not tied."""
        columns = [k for k, name in enumerate(self.names) if name not in names]
        rows = [k for k, row in enumerate(self.whitening) if any(row[column] for column in columns)]
        whitening = tuple(tuple(self.whitening[k][column] for column in columns) for k in rows)
        kept, centre = tuple(self.names[k] for k in columns), tuple(self.centre[k] for k in rows)
        return Prior(kept, whitening, centre, self.ties) if kept else Prior()

    def without_ties(self) -> "Prior":
        """Return the prior without its ties, which `add_ties` put last."""
        kept = len(self.centre) - len(self.ties)
        return Prior(self.names, self.whitening[:kept], self.centre[:kept]) if kept else Prior()


def add_ties(prior: Prior, ties: Sequence[SoftTie]) -> Prior:
    """Return the prior together with ties that have a spread."""
    names = tuple(dict.fromkeys([*prior.names, *(name for tie in ties for name in (tie.source, tie.name))]))
    rows = [(*row, *[0.0] * (len(names) - len(row))) for row in prior.whitening]
    for tie in ties:
        # ( ln value - ln source - ln factor ) / ln spread
        weights = {tie.name: 1 / math.log(tie.spread), tie.source: -1 / math.log(tie.spread)}
        rows.append(tuple(weights.get(name, 0.0) for name in names))
    centre = (*prior.centre, *(math.log(tie.factor) / math.log(tie.spread) for tie in ties))
    return Prior(names, tuple(rows), centre, tuple(ties))


def make_prior(table: Mapping[str, ParameterRecord], ties: Sequence[SoftTie] = ()) -> Prior:
    """Return the prior that the parameters of a medium state, `ties` with a spread among it.

    Raises ConfigError if a prior is of the wrong kind, peaks outside the bounds, or its correlation has no
    partner.
    """
    stated = {name: record.prior for name, record in table.items() if record.prior is not None}
    for name, stated_prior in stated.items():
        normal, bounds = is_shape_parameter(name), table[name].bounds
        refused = partial(ConfigError, key=f"parameters.{name}.prior")
        if normal != (stated_prior.mean is not None):
            expected = "mean and sd" if normal else "median and factor: it is positive"
            raise refused("is a prior of the wrong kind", expected=expected)
        if bounds is not None and not bounds[0] <= _peak(stated_prior) <= bounds[1]:
            raise refused(
                f"peaks at {_peak(stated_prior):g}, outside the bounds {bounds[0]:g} to {bounds[1]:g}",
                fix="widen the bounds, or look whether prior and bounds mean the same unit",
            )
        if stated_prior.correlation and (dimension(name) != "modulus" or alpha_of(name) not in stated):
            expected = "a prior of mu whose layer's alpha has a prior too"
            raise refused("states a correlation that has no partner", expected=expected)
    if not stated:
        return add_ties(Prior(), ties)
    names = tuple(stated)
    sds = [
        record.sd if record.sd is not None else math.log(record.factor or math.nan)
        for record in stated.values()
    ]
    correlations = np.eye(len(names))
    for k, (name, stated_prior) in enumerate(stated.items()):
        if stated_prior.correlation:
            j = names.index(alpha_of(name))
            correlations[j, k] = correlations[k, j] = stated_prior.correlation
    peaks = np.array([to_coordinate(name, _peak(record)) for name, record in stated.items()])
    whitening = np.linalg.inv(np.linalg.cholesky(correlations * np.outer(sds, sds)))
    rows = tuple(tuple(row) for row in whitening.tolist())
    return add_ties(Prior(names, rows, tuple((whitening @ peaks).tolist())), ties)


def alpha_of(mu: str) -> str:
    """Return the name of alpha in the layer of a modulus."""
    return mu.replace("mu", "alpha").removesuffix("_pa")


def _peak(record: PriorRecord) -> float:
    return float(record.mean if record.mean is not None else record.median or math.nan)
