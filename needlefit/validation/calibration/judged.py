"""What ranks say: an ECDF and coverages of central intervals, each beside what chance allows."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.validation.calibration.bands import band, limits
from needlefit.validation.calibration.ranks import DRAWS, LEVELS, covered

Counts = NDArray[np.int64]

ERROR = 0.01
"""Probability that a right computation fails anywhere: shared out evenly (Bonferroni) over the ECDFs and the
coverages at every level of all quantities. As these go together, the true one is smaller."""

COVERAGE = ("quantity", "level", "replicates", "covered", "expected", "least", "most", "passes")
ECDF = ("quantity", "place", "below", "expected", "least", "most", "passes")
"""Columns: `below` counts the ranks under a place, `least` and `most` what chance allows of it."""


def each_error(quantities: int) -> float:
    """Return the probability with which each single check may fail."""
    return ERROR / (quantities * (1 + len(LEVELS)))


def coverage(ranks: Mapping[str, Counts]) -> pd.DataFrame:
    """Return a row for every quantity and level."""
    error, rows = each_error(len(ranks)), []
    for name, placed in ranks.items():
        for level in LEVELS:
            least, most = (int(end) for end in limits(len(placed), level, error))
            found = covered(placed, level)
            counts = (len(placed), found, level * len(placed), least, most, least <= found <= most)
            rows.append(dict(zip(COVERAGE, (name, level, *counts), strict=True)))
    return pd.DataFrame(rows, columns=list(COVERAGE))


def ecdfs(ranks: Mapping[str, Counts]) -> pd.DataFrame:
    """Return a row for every quantity and place of the truth among the draws."""
    error, parts = each_error(len(ranks)), []
    places = np.arange(1, DRAWS + 1)
    for name, placed in ranks.items():
        least, most = band(len(placed), DRAWS + 1, error)
        below = np.array([np.sum(placed < place) for place in places])
        columns = {
            "quantity": name,
            "place": places,
            "below": below,
            "expected": len(placed) * places / (DRAWS + 1),
            "least": least,
            "most": most,
            "passes": (least <= below) & (below <= most),
        }
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def failing(coverage: pd.DataFrame, ecdfs: pd.DataFrame) -> list[str]:
    """Return the quantities of which any check fails, in their order."""
    failed = {*coverage.loc[~coverage["passes"], "quantity"], *ecdfs.loc[~ecdfs["passes"], "quantity"]}
    return [name for name in dict.fromkeys(coverage["quantity"]) if name in failed]
