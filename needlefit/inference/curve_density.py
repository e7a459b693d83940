"""The posterior of an empirical curve, by the same likelihood as a model's.

A curve knows no layers and no mechanics: theta holds its coefficients, c_k LENGTH^(k + 1), flat within bounds
that hold every needle, and the logarithm of the noise's scale. Of uncertain depths that of the tip moves it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.geometry.curves import BASELINE_COEFFICIENTS
from needlefit.inference.baselines import LENGTH, Baseline, curve_for, fit_baseline
from needlefit.inference.likelihood.evidence import Evidence, evidence, whitened
from needlefit.inference.likelihood.marginal import log_marginals
from needlefit.inference.parameters import SCALES
from needlefit.schemas.recipe import LikelihoodRecord

Floats = NDArray[np.float64]

WIDE = 10.0
"""Bound of theta's coefficients: a curve that turns by this many rad over 100 mm is none of a needle."""


@dataclass(frozen=True)
class CurveDensity:
    """What some insertions say of one curve.

    Attributes
    ----------
    name : str
        One of `BASELINE_COEFFICIENTS`.
    dataset : Dataset
    insertions : tuple of Insertion
    how : LikelihoodRecord
    most : float
        Largest noise scale.
    """

    name: str
    dataset: Dataset
    insertions: tuple[Insertion, ...]
    how: LikelihoodRecord
    most: float

    @property
    def upper(self) -> Floats:
        """Upper bounds of theta: (P,)."""
        return np.array([*[WIDE] * BASELINE_COEFFICIENTS[self.name], np.log(self.most)])

    @property
    def lower(self) -> Floats:
        """Lower bounds of theta: (P,)."""
        return np.array([*[-WIDE] * BASELINE_COEFFICIENTS[self.name], np.log(SCALES[0])])

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (W,) of thetas (W, P), -inf outside the bounds."""
        inside = np.all((thetas >= self.lower) & (thetas <= self.upper), axis=1)
        density = np.full(len(thetas), -np.inf)
        if inside.any():
            density[inside] = sum(log_likelihoods(self, known, thetas[inside]) for known in self.known)
        return density

    @cached_property
    def known(self) -> tuple[Evidence, ...]:
        """The insertions, ready to be compared; computed once."""
        return tuple(self.of(insertion) for insertion in self.insertions)

    def of(self, insertion: Insertion) -> Evidence:
        """Return an insertion ready to be compared with curves, which no boundary moves."""
        return evidence(self.dataset, replace(insertion, boundary_sd=0.0), how=self.how)

    def curve(self, theta: Floats) -> Baseline:
        """Return the curve that theta means."""
        powers = LENGTH ** -np.arange(1.0, len(theta))
        return Baseline(self.name, tuple((theta[:-1] * powers).tolist()), float("nan"))

    @cached_property
    def peak(self) -> Floats:
        """Theta (P,) of the greatest density, searched for about the closest curve."""
        pose, drop = self.dataset.pose, self.dataset.drop_proximal
        closest = fit_baseline(self.name, pose, drop, self.insertions).coefficients
        scaled = np.array(closest) * LENGTH ** np.arange(1.0, len(closest) + 1)
        starts = [np.array([*scaled, np.log(scale)]) for scale in (1.0, min(10.0, self.most))]
        ends = [minimize(self._height, at, method="Nelder-Mead", tol=1e-6) for at in starts]
        best: Floats = min(ends, key=lambda end: float(end.fun)).x
        return best

    def _height(self, theta: Floats) -> float:
        return -float(self(theta[None])[0])


def log_likelihoods(density: CurveDensity, known: Evidence, thetas: Floats) -> Floats:
    """Return the log likelihoods (W,) of one insertion, given thetas (W, P)."""
    curves = [density.curve(theta) for theta in thetas]
    white = np.array([_white(known, curve) for curve in curves])  # (W, m, R)
    found: Floats = known.log_norm + log_marginals(white, known.nodes, np.exp(thetas[:, -1]))
    return found


def _white(known: Evidence, curve: Baseline) -> Floats:
    """Return the whitened residuals (m, R) of a curve at all nodes."""
    pairs: Sequence[tuple[Insertion, Floats]] = list(zip(known.nodes.insertions, known.nodes.s, strict=True))
    return whitened(known, np.array([curve_for(curve, insertion)(s) for insertion, s in pairs]))
