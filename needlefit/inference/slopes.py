"""Simulated points and their exact derivatives by theta: the mechanics' own, through logarithms and ties."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.inference.parameters import Parameters
from needlefit.inference.predict import conditions
from needlefit.mechanics.linearize import differentiate_positions, linearize_steps
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.shape import compute_positions
from needlefit.schemas.medium import MediumRecord

Floats = NDArray[np.float64]


def predict_with_slopes(
    values: Mapping[str, float],
    parameters: Parameters,
    medium: MediumRecord,
    needle: Needle,
    insertion: Insertion,
    s: Floats,
) -> tuple[Floats, Floats]:
    """Return the simulated points (K, 2) in C, mm, and their derivatives (K, 2, P) by theta.

    Parameters
    ----------
    values : mapping
        Every parameter of the medium, ties resolved (Pa, mm).
    s : (K,) array
        Beam coordinates of the points, mm.

    Returns
    -------
    (K, 2) and (K, 2, P) arrays
        NaN where the solve fails.

    Raises
    ------
    ModelError
        If the needle does not reach the depth.
    """
    chain = _chain(values, parameters, insertion)
    shape, jacobian = linearize_steps(*conditions(values, medium, needle, insertion), wrt=_kinds(parameters))
    if not shape.converged:
        return np.full((len(s), 2), np.nan), np.full((len(s), 2, len(parameters.free)), np.nan)
    rows = [chain[name] for name in jacobian.names]
    by_theta = np.array(rows).reshape(len(rows), len(parameters.free))  # also where nothing is free
    return compute_positions(shape, s), differentiate_positions(shape, jacobian, s) @ by_theta


def _kinds(parameters: Parameters) -> tuple[str, ...]:
    """Return the kinds of the mechanics' parameters that theta moves."""
    moving = {name for name in parameters.names if name not in parameters.fixed}
    starts = (("mu", "mu"), ("alpha", "alpha"), ("bevel", "offset"), ("guide", "guides"))
    return tuple(kind for start, kind in starts if any(name.startswith(start) for name in moving))


def _chain(values: Mapping[str, float], parameters: Parameters, insertion: Insertion) -> dict[str, Floats]:
    """Return the derivatives (P,) by theta of what the mechanics differentiate by, by its name there."""
    slopes, nothing = parameters.slopes(values), np.zeros(len(parameters.free))
    found = {"offset": slopes["bevel_mm"], "guide1_y": nothing, "guide1_slope": nothing}
    found["guide1_x"] = -slopes.get("guide_distance_mm", nothing)
    for interval, layer in enumerate(insertion.sequence, start=1):
        found[f"mu{interval}"] = 1e-6 * slopes[f"mu{layer}_pa"]
        found[f"alpha{interval}"] = slopes[f"alpha{layer}"]
    return found
