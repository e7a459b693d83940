"""What two runs differ in, and whether it matters.

Runs are compared by what they wrote for readers (`run.json` and CSVs), so that a run may be compared with
committed evidence too. A difference matters where it could change what is concluded: a parameter that moved
by more than `SHIFT` of its standard deviation, errors on the same insertions that changed visibly and by more
than two standard errors, a verdict, what converged.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.inference.parameters import in_logarithm
from needlefit.project.run_file import read_run

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

_KEYS = ["fold", "role", "insertion", "rival", "boundaries"]
_ERRORS = {"ipe_mean_mm": "mean IPE", "te_mm": "mean TE"}
_FORETOLD = {"tip_crps_mm": "CRPS of the tip foretold", "shape_crps_mm": "CRPS of the shape foretold"}
_INPUTS = ("dataset", "medium", "recipe", "rules", "study", "fit", "folds", "hand_tuned", "versions")


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


def differences(before: Path, after: Path) -> list[Difference]:
    """Return all differences of run folder `after` from `before`: inputs, states, parameters, errors."""
    runs = [read_run(folder) for folder in (before, after)]
    parameters, errors, foretold = (
        (_table(before, name), _table(after, name)) for name in ("parameters", "errors", "predictive")
    )
    return [
        *_inputs(*runs),
        *_states(*runs),
        *_parameters(*parameters),
        *_errors(*errors),
        *_foretold(*foretold),
    ]


def _table(folder: Path, name: str) -> pd.DataFrame:
    path = folder / f"{name}.csv"
    return pd.read_csv(path) if path.is_file() else pd.DataFrame()


def _inputs(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[Difference]:
    leaves = [dict(_leaves({k: run[k] for k in _INPUTS if k in run})) for run in (before, after)]
    for key in dict.fromkeys([*leaves[0], *leaves[1]]):
        one, two = leaves[0].get(key), leaves[1].get(key)
        if one != two:
            yield Difference("input", key, one, two, None, "")


def _leaves(value: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield every value of nested mappings by its path; a list is one value."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _leaves(inner, f"{path}.{key}" if path else str(key))
    else:
        yield path, value


def _states(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[Difference]:
    for key in ("interrupted", "budget_limited", "posteriors"):
        one, two = before.get(key), after.get(key)
        if one != two:
            yield Difference("state", key, one, two, key != "posteriors", "")


def _parameters(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    if before.empty or after.empty:
        return
    keys = ["fold", "parameter"]
    both = before.merge(after, on=keys, how="outer", suffixes=("_a", "_b"), sort=False)
    several = before["fold"].nunique() > 1
    for _, row in both.iterrows():
        name = f"{row['parameter']} ({row['fold']})" if several else str(row["parameter"])
        one, two = _known(row["determined_a"]), _known(row["determined_b"])
        if one != two:
            said = {True: "determined", False: "not determined", None: "absent"}
            yield Difference("state", name, said[one], said[two], True, "the verdict changed")
        yield from _moved(name, row, bool(one) and bool(two))


def _moved(name: str, row: "pd.Series[Any]", determined: bool) -> Iterator[Difference]:
    one, two = float(row["value_used_a"]), float(row["value_used_b"])
    tied = row["status_a"] == row["status_b"] == "tied"  # moves with its source
    if one == two or tied or not (math.isfinite(one) and math.isfinite(two)):
        return
    logarithm = in_logarithm(str(row["parameter"])) and one > 0 and two > 0
    shift = abs(math.log(two / one)) if logarithm else abs(two - one)
    sd = np.nanmax([row["sd_a"], row["sd_b"], 0.0])
    if not sd > 0:
        yield Difference("parameter", name, one, two, True, "given, not fitted")
        return
    part = shift / sd
    why = f"{part:.2g} of its standard deviation" + ("" if determined else ", not determined")
    yield Difference("parameter", name, one, two, determined and part > SHIFT, why, part < SLIGHT * SHIFT)


def _known(value: object) -> bool | None:
    return value if isinstance(value, bool) else None


def _errors(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how mean errors changed on the insertions that both scored, by role and rival."""
    if before.empty or after.empty:
        return
    both = before.merge(after, on=_KEYS, suffixes=("_a", "_b"), sort=False)
    for (role, rival, boundaries), rows in both.groupby(["role", "rival", "boundaries"], sort=False):
        for column, said in _ERRORS.items():
            yield from _changed(f"{said}, {rival}, {role}, {boundaries} boundaries", rows, column)
    lost = len(before) + len(after) - 2 * len(both)
    if lost:
        counts = (len(before), len(after))
        yield Difference("state", "scored rows", *counts, True, f"{lost} rows are in one run only")


def _foretold(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    if before.empty or after.empty:
        return
    both = before.merge(after, on=["fold", "insertion"], suffixes=("_a", "_b"), sort=False)
    for column, said in _FORETOLD.items():
        yield from _changed(said, both, column, DRAWN * float(both[f"{column}_a"].mean()))


def _changed(where: str, rows: pd.DataFrame, column: str, visible: float = VISIBLE) -> Iterator[Difference]:
    """Yield how the mean of a column in mm changed, over the rows in which both runs have it."""
    pairs = rows[[f"{column}_a", f"{column}_b"]].to_numpy(dtype=np.float64)
    pairs = pairs[np.isfinite(pairs).all(axis=1)]
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
