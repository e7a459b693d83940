"""Make the prior of a new medium: the posterior of an old one, widened by the spread between media.

Both media are taken for draws of one population of which only the spread s is known (a standard deviation of
each coordinate of theta). Then the new medium lies about the old one with variance 2 s^2, and with draws
theta_i of the old posterior the prior is the mixture (`TransferredPrior`)

    theta_new ~ 1/B sum_i N( theta_i,  diag(2 s^2) )

by which draws are made and weighted. Searches need a sum of squares. They use a Gaussian in its place

    theta_new ~ N( theta_fit,  E[ (theta - theta_fit) (theta - theta_fit)^T ]  +  diag(2 s^2) )

with E the mean over the old posterior. It peaks at the old fit, not at the posterior's mean, so that without
new data the optimum is what it was. Where draws lie on a plateau beside the peak it is too wide.
Layers that the old medium ties together may differ in the new.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from scipy.special import logsumexp

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.inference.parameters import Parameters, Prior, make_gaussian_prior, to_coordinate
from needlefit.inference.predict import draw_from_prior
from needlefit.inference.problem import Problem

#: spread that is always added, so that what the old medium fixes or ties keeps a density in the new one
MIN_SPREAD = 1e-3

BOUND_TOLERANCE = 1e-9  #: part of a bound by which a fit at it may miss it


def widen_posterior(
    old: Parameters, fit: Mapping[str, float], thetas: Floats, new: Parameters, spread: Mapping[str, float]
) -> Prior:
    """Return the prior of the free parameters of `new` that the old medium also has; the others stay flat.

    `fit` has every parameter of the old medium at its best fit (Pa, mm), `thetas` (B, P) are draws of its
    posterior, `spread` is the standard deviation between media of each parameter's coordinate, by name.

    Raises ConfigError if no parameter is common to both, or the old fit lies outside the new bounds.
    """
    names = tuple(name for name in new.free if name in old.names)
    if not names:
        raise ConfigError("old and new medium have no parameter in common", fix="name media that resemble")
    for name in names:
        low, high = new.bounds[name]
        if not low - BOUND_TOLERANCE * abs(low) <= fit[name] <= high + BOUND_TOLERANCE * abs(high):
            raise ConfigError(
                f"{name} of the old medium is {fit[name]:.3g}, outside the new medium's bounds",
                expected=f"{low:g} to {high:g}",
                fix="widen the bounds of the new medium",
            )
    centre = np.array([to_coordinate(name, fit[name]) for name in names])
    off = _find_coordinates(old, thetas, names) - centre
    between = np.array([spread.get(name, 0.0) for name in names])
    covariance = off.T @ off / len(off) + np.diag(2 * between**2 + MIN_SPREAD**2)
    return make_gaussian_prior(names, centre, covariance)


@dataclass(frozen=True)
class TransferredPrior:
    """The mixture of Gaussians about the draws of an old posterior: the prior of some new parameters."""

    parameters: Parameters  #: of the new medium, with the Gaussian of `widen_posterior` as their prior
    names: tuple[str, ...]  #: q of them: those of the mixture
    centres: Floats  #: (B, Q) draws of the old posterior, in theta's coordinates
    sds: Floats  #: (Q,) of each Gaussian

    @classmethod
    def from_draws(
        cls,
        old: Parameters,
        fit: Mapping[str, float],
        thetas: Floats,
        new: Parameters,
        spread: Mapping[str, float],
    ) -> Self:
        """Return the mixture about draws (B, P) of the old posterior; arguments as of `widen_posterior`."""
        prior = widen_posterior(old, fit, thetas, new, spread)
        # the old posterior contains a half-normal prior that both share: it must not count twice
        half_normal = {name: sd for name, sd in new.half_normal.items() if name not in prior.names}
        parameters = replace(new, prior=prior, half_normal=half_normal)
        sds = np.sqrt(2.0) * np.array([spread.get(name, 0.0) for name in prior.names])
        return cls(parameters, prior.names, _find_coordinates(old, thetas, prior.names), sds)

    def correct(self, thetas: Floats) -> Floats:
        """Return the log density (W,) of the mixture at thetas (W, P), less that of the Gaussian prior.

        Both but for a constant. Parameters that do not differ between media have no spread: there the
        mixture is smoothed, by the rule of Silverman.
        """
        at = thetas[:, [self.parameters.free.index(name) for name in self.names]]
        count, known = len(self.centres), int(np.sum(self.sds == 0))
        smoothing = (4 / ((known + 2) * count)) ** (1 / (known + 4))
        smoothed = np.maximum(smoothing * self.centres.std(axis=0), MIN_SPREAD)
        sds = np.where(self.sds == 0, smoothed, self.sds)
        white = (at[:, None] - self.centres) / sds  # (W, B, Q)
        mixture: Floats = logsumexp(-0.5 * np.sum(white**2, axis=2), axis=1)
        prior = self.parameters.prior
        gaussian = np.array([prior.log_density(self.parameters.values(theta)) for theta in thetas])
        return mixture - gaussian

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return draws (`count`, P) of the prior within the bounds; what is not in the mixture is flat."""
        thetas = draw_from_prior(self.parameters, count, rng)
        columns = [self.parameters.free.index(name) for name in self.names]
        lower, upper = self.parameters.lower[columns], self.parameters.upper[columns]
        found = np.empty((0, len(columns)))
        while len(found) < count:
            drawn = self.centres + self.sds * rng.standard_normal(self.centres.shape)
            inside = np.all((drawn >= lower - BOUND_TOLERANCE) & (drawn <= upper + BOUND_TOLERANCE), axis=1)
            found = np.concatenate([found, drawn[inside]])
        thetas[:, columns] = np.clip(found[:count], lower, upper)
        return thetas


@dataclass(frozen=True)
class TransferProblem(Problem):
    """A problem of a new medium: draws are weighted by the mixture, searches use the Gaussian."""

    transferred: TransferredPrior | None = None

    @classmethod
    def of(cls, problem: Problem, transferred: TransferredPrior) -> Self:
        """Return a problem with the mixture as its prior."""
        kept = {field.name: getattr(problem, field.name) for field in fields(problem)}
        return cls(**{**kept, "parameters": transferred.parameters}, transferred=transferred)

    def log_posteriors(self, thetas: Floats, jobs: int = 1) -> Floats:
        """Return the log of the posterior density (W,) of many thetas (W, P) at once, on `jobs` threads."""
        density = super().log_posteriors(thetas, jobs)
        return density if self.transferred is None else density + self.transferred.correct(thetas)


def _find_coordinates(old: Parameters, thetas: Floats, names: tuple[str, ...]) -> Floats:
    """Return the coordinates (B, Q) of some parameters of draws (B, P)."""
    sets = [old.values(theta) for theta in thetas]
    return np.array([[to_coordinate(name, values[name]) for name in names] for values in sets])
