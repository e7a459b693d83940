"""The prior that a medium states of its parameters: its rows, whose residuals a search takes with the data's.

The logarithm of its density is minus half the sum of the squares of the residuals, but for a constant. Linear
rows are normal priors of shape parameters, log-normal ones of moduli and lengths, and ties with a spread. The
others are of one positive parameter each: generalised gamma (gamma and half-normal ones), or uniform.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.inference.parameter_names import dimension, is_logarithmic, is_shape_parameter, to_coordinate
from needlefit.schemas.medium import ParameterRecord, PriorRecord


@dataclass(frozen=True)
class SoftTie:
    """Says that ln(value / (factor * source's)) is normal about 0 with deviation ln `spread`."""

    name: str
    source: str
    factor: float
    spread: float


@dataclass(frozen=True)
class GammaRow:
    """A generalised gamma prior of a positive parameter, in its logarithm.

    With u = ln(value / mode) the logarithm of the density is shape / power (power u + 1 - exp(power u)).
    Power 1 is a gamma prior, whose mode in the logarithm is its mean; shape 1 and power 2 a half-normal one,
    whose mode is its standard deviation (E. W. Stacy, Ann. Math. Stat. 33 (1962) 1187).
    """

    name: str
    mode: float
    shape: float
    power: float

    def residuals(self, values: Floats | float) -> Floats:
        """Return the residuals (2, ...) of both terms; slopes of one root of their sum mislead a search."""
        exponent = np.log(np.asarray(values) / self.mode)
        grown = math.sqrt(2 * self.shape / self.power) * np.exp(0.5 * self.power * exponent)
        return np.stack([grown, np.sqrt(2 * self.shape * (MAX_EXPONENT - exponent))])

    def slopes(self, value: float) -> tuple[float, float]:
        """Return the derivatives of `residuals` by the logarithm of the value."""
        grown, left = self.residuals(value)
        return 0.5 * self.power * grown, -self.shape / left

    @property
    def information(self) -> float:
        """The curvature of the density's logarithm at its mode."""
        return self.shape * self.power

    @property
    def sd(self) -> float:
        """The standard deviation of the logarithm."""
        from scipy.special import polygamma

        return math.sqrt(float(polygamma(1, self.shape / self.power))) / self.power

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return draws (N,) of the logarithm."""
        ratio = self.shape / self.power
        drawn = np.maximum(rng.gamma(ratio, size=count) / ratio, np.finfo(float).tiny)
        return math.log(self.mode) + np.log(drawn) / self.power


@dataclass(frozen=True)
class UniformRow:
    """A prior that is flat in a positive parameter itself up to its upper bound, in its logarithm."""

    name: str
    mode: float  #: the upper bound
    information = 1.0  #: one over the variance of the logarithm
    sd = 1.0  #: standard deviation of the logarithm

    def residuals(self, values: Floats | float) -> Floats:
        """Return the residuals (2, ...), of which the first is 0, as of `GammaRow`."""
        exponent = np.log(np.asarray(values) / self.mode)
        return np.stack([np.zeros_like(exponent), np.sqrt(2 * (MAX_EXPONENT - exponent))])

    def slopes(self, value: float) -> tuple[float, float]:
        """Return the derivatives of `residuals` by the logarithm of the value."""
        return 0.0, float(-1 / self.residuals(value)[1])

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return draws (N,) of the logarithm."""
        return math.log(self.mode) - rng.exponential(size=count)


MAX_EXPONENT = 40.0  #: largest logarithm of a value over its mode, beyond any bounds


@dataclass(frozen=True)
class Prior:
    """A prior of some parameters, in coordinates of theta: linear rows, then those of one parameter each."""

    names: tuple[str, ...] = ()  #: q of them, of the linear rows
    #: (R, Q) what takes logarithms, and shape parameters themselves, to independent numbers of unit variance;
    #: R < Q where only combinations are stated, as by a tie
    whitening: tuple[tuple[float, ...], ...] = ()
    centre: tuple[float, ...] = ()  #: (R,) their means
    ties: tuple[SoftTie, ...] = ()  #: those among it, for print
    positive: tuple[GammaRow | UniformRow, ...] = ()

    @property
    def stated_names(self) -> frozenset[str]:
        """The parameters of which anything is stated."""
        return frozenset(self.names) | {row.name for row in self.positive}

    def residuals(self, sets: Sequence[Mapping[str, float]]) -> Floats:
        """Return the residuals (B, R + 2 G) of sets of values (Pa, mm)."""
        table = {name: np.array([values[name] for values in sets]) for name in self.stated_names}
        coordinates = [np.log(table[name]) if is_logarithmic(name) else table[name] for name in self.names]
        # a product for each set: one of all rounds a set by how many stand beside it
        products = [self._weights @ place for place in np.reshape(coordinates, (-1, len(sets))).T]
        linear = np.reshape(products, (len(sets), len(self.whitening))) - np.array(self.centre)
        return np.vstack([linear.T, *(row.residuals(table[row.name]) for row in self.positive)]).T

    def log_density(self, sets: Sequence[Mapping[str, float]]) -> Floats:
        """Return the logarithm of the density (B,) of sets of values, not normalised: 0 at its peak."""
        peak = sum(np.sum(row.residuals(row.mode) ** 2) for row in self.positive)
        return 0.5 * (peak - np.sum(self.residuals(sets) ** 2, axis=1))

    def log_marginals(self, names: Sequence[str], thetas: Floats) -> Floats:
        """Return the sum (W,) of the logarithms of what is stated of each of `names` alone, at thetas (W, Q).

        Not normalised; 0 where nothing is stated.
        """
        rows, total = {row.name: row for row in self.positive}, np.zeros(len(thetas))
        for name, places in zip(names, thetas.T, strict=True):
            if name in rows:
                total -= 0.5 * np.sum(rows[name].residuals(np.exp(places)) ** 2, axis=0)
            elif name in self.marginals:
                peak, sd = self.marginals[name]
                total -= 0.5 * ((places - peak) / sd) ** 2
        return total

    @cached_property
    def _weights(self) -> Floats:
        return np.array(self.whitening).reshape(len(self.whitening), len(self.names))

    def linear_slopes(self, names: Sequence[str]) -> Floats:
        """Return the derivatives (R, P) of the linear rows by theta of the free parameters `names`."""
        # a fixed parameter has no column: its residual is constant
        return self._weights @ _select(self.names, names)

    def slopes(self, names: Sequence[str], values: Mapping[str, float]) -> Floats:
        """Return the derivatives (R + 2 G, P) of `residuals` by theta of the free parameters `names`."""
        chosen = _select([row.name for row in self.positive], names)
        positive = [np.outer(row.slopes(values[row.name]), chosen[k]) for k, row in enumerate(self.positive)]
        return np.concatenate([self.linear_slopes(names), *positive])

    def information(self, names: Sequence[str]) -> Floats:
        """Return the precision (P, P), at the peak, of theta of `names`; 0 where nothing is stated."""
        linear = self.linear_slopes(names)
        positive = np.array([row.information for row in self.positive])
        positive = positive @ _select([row.name for row in self.positive], names)
        return linear.T @ linear + np.diag(positive)

    @cached_property
    def marginals(self) -> Mapping[str, tuple[float, float]]:
        """Peak and standard deviation of the coordinate of each parameter that is not only tied."""
        white = self._weights
        inverse = np.linalg.pinv(white)  # (Q, R)
        # a parameter that is only tied to another one has any value: it is not in the span of the rows
        is_independent = np.isclose(np.diag(inverse @ white), 1.0)
        mean, sd = inverse @ np.array(self.centre), np.linalg.norm(inverse, axis=1)
        linear = {
            name: (float(mean[k]), float(sd[k])) for k, name in enumerate(self.names) if is_independent[k]
        }
        return linear | {row.name: (math.log(row.mode), row.sd) for row in self.positive}

    def sd(self, name: str) -> float:
        """Return the standard deviation of one parameter's coordinate; infinite where nothing is stated."""
        return self.marginals.get(name, (math.nan, math.inf))[1]

    def without(self, names: Collection[str]) -> "Prior":
        """Return the prior without parameters that are independent of all others, and not tied."""
        columns = [k for k, name in enumerate(self.names) if name not in names]
        rows = [k for k, row in enumerate(self.whitening) if any(row[column] for column in columns)]
        whitening = tuple(tuple(self.whitening[k][column] for column in columns) for k in rows)
        kept, centre = tuple(self.names[k] for k in columns), tuple(self.centre[k] for k in rows)
        positive = tuple(row for row in self.positive if row.name not in names)
        return Prior(kept, whitening, centre, self.ties, positive)

    def without_ties(self) -> "Prior":
        """Return the prior without its ties, which `add_ties` put last."""
        kept = len(self.centre) - len(self.ties)
        return Prior(
            self.names if kept else (), self.whitening[:kept], self.centre[:kept], positive=self.positive
        )


def _select(stated: Sequence[str], names: Sequence[str]) -> Floats:
    """Return 1 (Q, P) where a stated name is that of a free parameter, else 0."""
    chosen = [[float(name == stated_name) for name in names] for stated_name in stated]
    return np.array(chosen).reshape(len(stated), len(names))


def add_ties(prior: Prior, ties: Sequence[SoftTie]) -> Prior:
    """Return the prior together with ties that have a spread."""
    names = tuple(dict.fromkeys([*prior.names, *(name for tie in ties for name in (tie.source, tie.name))]))
    rows = [(*row, *[0.0] * (len(names) - len(row))) for row in prior.whitening]
    for tie in ties:
        # ( ln value - ln source - ln factor ) / ln spread
        weights = {tie.name: 1 / math.log(tie.spread), tie.source: -1 / math.log(tie.spread)}
        rows.append(tuple(weights.get(name, 0.0) for name in names))
    centre = (*prior.centre, *(math.log(tie.factor) / math.log(tie.spread) for tie in ties))
    return Prior(names, tuple(rows), centre, tuple(ties), prior.positive)


def make_prior(table: Mapping[str, ParameterRecord], ties: Sequence[SoftTie] = ()) -> Prior:
    """Return the prior that the parameters of a medium state, `ties` with a spread among it.

    Raises ConfigError if a prior is of the wrong kind, peaks outside the bounds, or its correlation has no
    partner.
    """
    stated = {name: record.prior for name, record in table.items() if isinstance(record.prior, PriorRecord)}
    for name, stated_prior in stated.items():
        bounds = table[name].bounds
        refused = partial(ConfigError, key=f"parameters.{name}.prior")
        if is_shape_parameter(name) and stated_prior.mean is None:
            raise refused("is a prior of a positive parameter", expected="mean and sd: a normal prior")
        if bounds is not None and not bounds[0] <= _peak(stated_prior) <= bounds[1]:
            raise refused(
                f"peaks at {_peak(stated_prior):g}, outside the bounds {bounds[0]:g} to {bounds[1]:g}",
                fix="widen the bounds, or correct the unit of one",
            )
        if stated_prior.correlation and (
            dimension(name) != "modulus" or stated_prior.factor is None or alpha_of(name) not in stated
        ):
            expected = "a log-normal prior of mu whose layer's alpha has a prior too"
            raise refused("states a correlation that has no partner", expected=expected)
    rows = {name: row for name, record in table.items() if (row := _make_row(name, record)) is not None}
    linear = {name: record for name, record in stated.items() if name not in rows}
    names = tuple(linear)
    sds = [
        record.sd if record.sd is not None else math.log(record.factor or math.nan)
        for record in linear.values()
    ]
    correlations = np.eye(len(names))
    for k, (name, stated_prior) in enumerate(linear.items()):
        if stated_prior.correlation:
            j = names.index(alpha_of(name))
            correlations[j, k] = correlations[k, j] = stated_prior.correlation
    peaks = np.array([to_coordinate(name, _peak(record)) for name, record in linear.items()])
    whitening = np.linalg.inv(np.linalg.cholesky(correlations * np.outer(sds, sds)))
    weights = tuple(map(tuple, whitening.tolist()))
    prior = Prior(names, weights, tuple((whitening @ peaks).tolist()), positive=tuple(rows.values()))
    return add_ties(prior, ties)


def make_half_normal(name: str, sd: float) -> GammaRow:
    """Return the half-normal prior of a positive parameter."""
    return GammaRow(name, sd, shape=1.0, power=2.0)


def _make_row(name: str, parameter: ParameterRecord) -> GammaRow | UniformRow | None:
    """Return the prior that is stated of a positive parameter, unless it is log-normal; else None."""
    record = parameter.prior
    if record is None or is_shape_parameter(name):  # which is flat where a uniform prior is stated
        return None
    if record == "uniform":
        assert parameter.bounds is not None
        return UniformRow(name, parameter.bounds[1])
    if record.factor is not None:
        return None
    sd = record.sd or math.nan
    return (
        GammaRow(name, record.mean, (record.mean / sd) ** 2, 1.0)
        if record.mean
        else make_half_normal(name, sd)
    )


def alpha_of(mu: str) -> str:
    """Return the name of alpha in the layer of a modulus."""
    return mu.replace("mu", "alpha").removesuffix("_pa")


def _peak(record: PriorRecord) -> float:
    """Return the parameter's value at the peak of its prior, in its coordinate of theta."""
    stated = (record.mean, record.median, record.sd)
    return float(next((value for value in stated if value is not None), math.nan))
