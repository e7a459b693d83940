"""A curve as a file holds it, before anything is known of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Points:
    """Points of one curve and where they stand.

    Attributes
    ----------
    values : (N, 3) array
        Coordinates, as in the file.
    lines : (N,) array or None
        Line of each point; None where the format has no lines.
    """

    path: Path
    values: NDArray[np.float64]
    lines: NDArray[np.int64] | None = None

    def where(self, index: int = 0) -> str:
        """Name the place of point `index` for a message."""
        if self.lines is None:
            return f"{self.path}, point {index + 1}"
        return f"{self.path}:{self.lines[index]}" if len(self.lines) else str(self.path)
