"""One difference of two runs, and how a mean over the same insertions changed."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

SHIFT = 0.5
"""Part of its standard deviation by which a parameter that is determined may move and stay what it was."""

VISIBLE = 0.005
"""mm: a mean error that changes by less is printed alike."""

DRAWN = 0.1
"""Part of a CRPS that changes with the draws it is computed from."""

SLIGHT = 0.02
"""Part of `SHIFT` or `VISIBLE` under which a change is slight: of rounding, or of a search's tolerance."""

SURE = 2.0
"""Standard errors from which on a mean difference is taken for one."""


@dataclass(frozen=True)
class Difference:
    """One thing in which run B is not run A.

    Attributes
    ----------
    what : "input", "parameter", "error" or "state"
    where : str
        Which key, parameter or insertions.
    before, after : object
        In A and in B, as JSON knows values; None where one of them has none.
    matters : bool or None
        None for inputs: they are why results differ, and no result.
    why : str
        In words.
    slight : bool
        Whether it is of the size of rounding.
    """

    what: str
    where: str
    before: object
    after: object
    matters: bool | None
    why: str
    slight: bool = False


def changed(where: str, rows: pd.DataFrame, column: str, visible: float = VISIBLE) -> Iterator[Difference]:
    """Yield how the mean of a column in mm changed, over the rows in which both runs have it.

    Where only one of them has a finite value, as of a simulation that did not converge, that is a difference.
    """
    pairs = rows[[f"{column}_a", f"{column}_b"]].to_numpy(dtype=np.float64)
    there = np.isfinite(pairs)
    if np.any(there[:, 0] != there[:, 1]):
        before, after = (int(count) for count in there.sum(axis=0))
        yield Difference("state", where, before, after, True, "values that are finite, of the same rows")
    pairs = pairs[there.all(axis=1)]
    gap = pairs[:, 1] - pairs[:, 0]
    if not np.any(gap):
        return
    mean, error = float(np.mean(gap)), math.nan
    said = f"{mean:+.4f} mm on 1 insertion"
    if gap.size > 1:
        error = float(np.std(gap, ddof=1) / math.sqrt(gap.size))
        said = f"{mean:+.4f} ± {error:.4f} mm on {gap.size} insertions"
    matters = abs(mean) > visible and not abs(mean) <= SURE * error
    slight = float(np.max(np.abs(gap))) < SLIGHT * VISIBLE
    one, two = (float(value) for value in pairs.mean(axis=0))
    yield Difference("error", where, one, two, matters, said.replace("-", "−"), slight)
