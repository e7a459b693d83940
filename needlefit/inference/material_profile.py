"""The profile of a sum of squares over one parameter, all others being the best for each of its values."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """Sum of squares over alpha, mu being the best for each; everything that is asked of its shape.

    Attributes
    ----------
    alpha : (G,) array
    mu : (G,) array
        MPa.
    ratio : (G,) array
        Sum of squares over the smallest one.
    limit : float
        Ratio up to which an alpha belongs to the 95 % region.
    """

    alpha: Floats
    mu: Floats
    ratio: Floats
    limit: float

    @property
    def regions(self) -> tuple[tuple[float, float], ...]:
        """The 95 % region of alpha as intervals; one that ends where the range does is open there."""
        return self.within(self.limit)

    def within(self, limit: float) -> tuple[tuple[float, float], ...]:
        """Return the intervals of alpha with a ratio of at most `limit`."""
        inside = np.concatenate(([False], self.ratio <= limit, [False]))
        begins, ends = (
            np.flatnonzero(np.diff(inside.astype(int)) == 1),
            np.flatnonzero(~inside[1:] & inside[:-1]),
        )
        pairs = zip(begins.tolist(), ends.tolist(), strict=True)
        return tuple((self._edge(a - 1, a, limit), self._edge(b, b - 1, limit)) for a, b in pairs)

    def _edge(self, out: int, within: int, limit: float) -> float:
        """Return where the ratio passes the limit between two neighbours of the grid."""
        if not 0 <= out < len(self.alpha):
            return float(self.alpha[within])
        high, low = self.ratio[out], self.ratio[within]
        part = 1.0 if high == low else (limit - low) / (high - low)
        return float(self.alpha[within] + part * (self.alpha[out] - self.alpha[within]))
