"""Which studies generalise: by the errors on what they hold out, against a threshold from the paper itself.

The paper's held-out groups fall in two: mean IPE of 0.19 to 0.46 mm, and of 1.18 mm and more. Between the
two lies the widest gap (by ratio) of its table; the geometric mean of its two sides is the threshold.
"""

from collections.abc import Sequence
from itertools import pairwise

import pandas as pd

from needlefit.validation import paper


def generalising(fitted: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Return mean IPE, TE and their floors of every study, mm, and whether it `generalises`.

    Parameters
    ----------
    fitted : DataFrame
        Errors of one rival (`cells.ERRORS`), with the columns `by` beside.
    """
    held_out = fitted[fitted["role"] == "validate"].replace([float("inf")], float("nan"))
    columns = ["ipe_mean_mm", "te_mm", "floor_ipe_mean_mm", "floor_te_mm"]
    means = held_out.groupby([*by, "study"], sort=False)[columns].mean().reset_index()
    limit = threshold()
    return means.assign(threshold_mm=limit, generalises=means["ipe_mean_mm"] < limit)


def threshold() -> float:
    """Return the mean IPE below which a study generalises, mm."""
    printed = sorted(float(value) for value in paper.table("validation")["ipe_mean_mm"])
    low, high = max(pairwise(printed), key=lambda pair: pair[1] / pair[0])
    return float((low * high) ** 0.5)
