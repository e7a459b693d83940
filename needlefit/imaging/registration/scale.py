"""Whether the scan's distances are too long or too short: voxel spacings stated wrongly.

Scale is asked for and said, never corrected: what is wrong with a spacing is mended in the scan, where the
needle has it too.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import pinvh
from scipy.optimize import minimize_scalar

from needlefit.geometry.frames import Floats
from needlefit.imaging.registration.marker_sets import MarkerSets, stretched
from needlefit.imaging.registration.pairing import fitting, limit
from needlefit.imaging.registration.rigid import Alignment, Pairs, align
from needlefit.imaging.registration.target_error import inverted, motion

ALONG = {
    "in all directions": (1.0, 1.0, 1.0),
    "along x": (1.0, 0.0, 0.0),
    "along y": (0.0, 1.0, 0.0),
    "along z": (0.0, 0.0, 1.0),
    "along x and y": (1.0, 1.0, 0.0),
}
"""Which axes of the scan may share a wrong spacing."""

NOTICED = 4.0
"""Deviations from 1 at which a scale is said to differ: five are looked at, one in 3000 alarms is false."""

WIDEST = 5.0
"""Greatest factor, either way, that is looked for."""

WINDOW = 0.01
"""Relative width within which distances vote for the same factor."""

PEAKS = 3
"""Most voted factors that are tried per direction."""


@dataclass(frozen=True)
class Scale:
    """A factor by which the scan would have to be stretched along some of its axes; and its deviation."""

    along: str
    factor: float
    sd: float

    @property
    def significance(self) -> float:
        """Deviations by which it differs from 1."""
        return abs(self.factor - 1) / self.sd


def scales(sets: MarkerSets, pairs: Pairs, alignment: Alignment) -> tuple[Scale, ...]:
    """Return the factor that pairs and noise suggest, for each of `ALONG`; first order, about 1.

    One column more in the normal equations of the motion: how the residuals grow with a stretch about the
    markers' centre. Directions that the markers do not span are left out.
    """
    found = sets.found[pairs[:, 0]]
    arms = alignment.frame.to_world(found) - alignment.centre
    weights = inverted(alignment.noise)
    estimates = []
    for name, axes in ALONG.items():
        stretch = ((found - found.mean(axis=0)) * np.array(axes)) @ alignment.frame.rotation.T  # (P, 3)
        columns = np.concatenate([motion(arms), stretch[:, :, None]], axis=2)  # (P, 3, 7)
        normal = np.einsum("nia,nij,njb->ab", columns, weights, columns)
        own = normal[6, 6] - normal[6, :6] @ pinvh(normal[:6, :6]) @ normal[:6, 6]
        if own <= 1e-9 * normal[6, 6] or normal[6, 6] == 0:
            continue
        # the motion is fitted already: its own gradient is zero
        pull = float(np.einsum("ni,nij,nj->", stretch, weights, alignment.residuals))
        estimates.append(Scale(name, 1 + pull / float(own), float(1 / np.sqrt(own))))
    return tuple(estimates)


def better_scaled(sets: MarkerSets, count: int) -> tuple[Scale, int] | None:
    """Return the scale with which more than `count` pairs fit, and how many; None if there is none."""
    reached, best, found_scale = count, np.inf, None
    for name, axes in ALONG.items():
        for rough in _voted(sets, np.array(axes)):
            # the vote is good to its window; what that leaves at the layout's ends counts as noise
            spread = WINDOW / 2 * sets.extent * np.eye(3)
            wide = stretched(sets, _factors(axes, rough))
            loose = MarkerSets(
                wide.found, wide.known, wide.found_covariance + spread**2, wide.known_covariance
            )
            candidates = fitting(loose)
            if not candidates or len(candidates[0].pairs) < max(reached, 4):
                continue
            for candidate in candidates[:20]:
                factor, left = _refined(sets, candidate.pairs, axes, rough)
                pairs = len(candidate.pairs)
                if left <= limit(pairs) and (pairs > reached or (pairs == reached > count and left < best)):
                    scaled = stretched(sets, _factors(axes, factor))
                    sd = {
                        one.along: one.sd
                        for one in scales(scaled, candidate.pairs, align(scaled, candidate.pairs))
                    }
                    reached, best = pairs, left
                    found_scale = Scale(name, factor, sd.get(name, np.inf) * factor)
    return (found_scale, reached) if found_scale and found_scale.significance > NOTICED else None


def _voted(sets: MarkerSets, axes: Floats) -> list[float]:
    """Return the factors along `axes` that most pairs of distances, one found and one known, agree on."""
    i, k = np.triu_indices(len(sets.found), 1)
    j, m = np.triu_indices(len(sets.known), 1)
    square = (sets.found[i] - sets.found[k]) ** 2
    along, across = square @ axes, square @ (1 - axes)
    known = np.sum((sets.known[j] - sets.known[m]) ** 2, axis=1)
    tells = along > across / 10  # distances mostly across tell little of the factor
    ratio = (known[None, :] - across[tells, None]) / along[tells, None]
    votes = np.sort(np.log(ratio[(ratio > WIDEST**-2) & (ratio < WIDEST**2)]) / 2)
    peaks: list[float] = []
    while votes.size and len(peaks) < PEAKS:
        agree = np.searchsorted(votes, votes + WINDOW) - np.arange(votes.size)
        first = int(np.argmax(agree))
        peak = float(np.median(votes[first : first + agree[first]]))
        peaks.append(float(np.exp(peak)))
        votes = votes[np.abs(votes - peak) > WINDOW]
    return peaks


def _refined(
    sets: MarkerSets, pairs: Pairs, axes: tuple[float, float, float], rough: float
) -> tuple[float, float]:
    """Return the factor near `rough` with the least chi-squared, and that."""
    found = minimize_scalar(
        lambda factor: align(stretched(sets, _factors(axes, factor)), pairs).chi2,
        bounds=(rough * (1 - 3 * WINDOW), rough * (1 + 3 * WINDOW)),
        method="bounded",
        options={"xatol": 1e-6},
    )
    return float(found.x), float(found.fun)


def _factors(axes: tuple[float, float, float], factor: float) -> Floats:
    factors: Floats = 1 + (factor - 1) * np.array(axes)
    return factors
