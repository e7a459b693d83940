"""Make the prior of a new medium: the posterior of an old one, widened by the spread between media.

Both media are taken for draws of one population of which only the spread s is known (a standard deviation of
each coordinate of theta). Then the new medium lies about the old one with variance 2 s^2, and

    theta_new ~ N( theta_fit,  E[ (theta - theta_fit) (theta - theta_fit)^T ]  +  diag(2 s^2) )

with E the mean over the old posterior. The prior peaks at the old fit, not at the posterior's mean, so that
without new data the optimum is what it was. Layers that the old medium ties together may differ in the new.
"""

from collections.abc import Mapping

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ConfigError
from needlefit.inference.parameters import Parameters
from needlefit.inference.prior import Prior, make_gaussian_prior, to_coordinate

MIN_SPREAD = 1e-3
"""Spread that is always added, so that what the old medium fixes or ties keeps a density in the new one."""


BOUND_TOLERANCE = 1e-9
"""Part of a bound by which a fit at it may miss it."""


def widen_posterior(
    old: Parameters, fit: Mapping[str, float], thetas: Floats, new: Parameters, spread: Mapping[str, float]
) -> Prior:
    """Return the prior of the free parameters of `new` that the old medium also has; the others stay flat.

    Parameters
    ----------
    fit : mapping
        Every parameter of the old medium at its best fit (Pa, mm).
    thetas : (B, P) array
        Draws of the old medium's posterior.
    spread : mapping
        Standard deviation between media of each parameter's coordinate, by name; 0 where none is given.

    Raises
    ------
    ConfigError
        If no parameter is common to both, or the old fit lies outside the new bounds.
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
    drawn = [old.values(theta) for theta in thetas]
    off = np.array([[to_coordinate(name, values[name]) for name in names] for values in drawn]) - centre
    between = np.array([spread.get(name, 0.0) for name in names])
    covariance = off.T @ off / len(off) + np.diag(2 * between**2 + MIN_SPREAD**2)
    return make_gaussian_prior(names, centre, covariance)
