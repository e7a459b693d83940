"""Summarise the errors of single insertions, aggregated in the two ways that differ."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import count_layers, get_other_rule, group_independent
from needlefit.geometry.curves import ComparedCurves, compare_curves
from needlefit.metrics import headline_metrics, list_metrics, pool_metric
from needlefit.schemas.study import LayerCountRule
from needlefit.studies.fit_frames import COLUMNS, SCORE_KEYS
from needlefit.studies.job import Job
from needlefit.studies.run import Run
from needlefit.studies.score import Row, list_methods

AGGREGATE_COLUMNS = (
    *("metric", "value", "pooled", "floor", "unflagged"),
    *("insertions", "edp_flagged", "not_converged"),
)


def count_reasons(failures: pd.DataFrame) -> dict[str, int]:
    """Return the number of rows of `Run.failures` per reason, most frequent first."""
    kinds = (str(reason).partition(":")[0] for reason in failures["note"])
    return dict(Counter(kinds).most_common())


def aggregate(results: Run, by: Sequence[str], pooled: bool = False) -> pd.DataFrame:
    """Return one row per group of `results.errors` and metric, groups in the order of their first insertion.

    Insertions whose simulation did not converge have no errors: they are left out of the means and
    counted in `not_converged`.

    Parameters
    ----------
    results : Run
        What to aggregate.
    by : sequence of str
        Columns of `results.errors`; name `method` and `boundaries` unless one of each is present.
    pooled : bool
        Whether to fill the column `pooled`.

    Returns
    -------
    DataFrame
        The columns `by`, `metric`, and in the metric's unit: `value`, the mean over insertions of each one's
        own error, as the paper's tables have it; `pooled`, the error of all points of all insertions
        together (`Metric.pool`); `floor`, the mean noise floor; `unflagged`, the mean over insertions that
        deflect by more than their noise floor. Counts of insertions: `insertions`, `edp_flagged` (the
        others of these) and `not_converged`.
    """
    metrics, curves = list_metrics(), _find_curves(results) if pooled else {}
    frame = results.frames["errors"]
    names = [name for metric in metrics for name in (metric.name, f"floor_{metric.name}")]
    finite = {name: _finite_column(frame, name).to_numpy() for name in names}
    flagged, converged = (frame[name].to_numpy(dtype=bool) for name in ("edp_flagged", "converged"))
    insertions = frame["insertion"].to_numpy()
    scored, keys = (list(frame[list(of)].itertuples(index=False, name=None)) for of in (SCORE_KEYS, by))
    rows = []
    for at in _group_positions(frame, by):
        head, clear = dict(zip(by, keys[at[0]], strict=True)), at[~flagged[at]]
        members = [curves[scored[n]] for n in at if scored[n] in curves]
        counts = {
            "insertions": len(set(insertions[at])),
            "edp_flagged": len(set(insertions[at[flagged[at]]])),
            "not_converged": len(set(insertions[at[~converged[at]]])),
        }
        for metric in metrics:
            value, floor = finite[metric.name], finite[f"floor_{metric.name}"]
            found = {
                "value": _mean(value[at]),
                "pooled": pool_metric(metric, members),
                "floor": _mean(floor[at]),
            }
            rows.append({**head, "metric": metric.name, **found, "unflagged": _mean(value[clear]), **counts})
    return pd.DataFrame(rows, columns=[*by, *AGGREGATE_COLUMNS])


def _group_positions(frame: pd.DataFrame, by: Sequence[str]) -> Iterator[NDArray[np.intp]]:
    """Yield where the rows of each group stand, groups in the order of their first row."""
    group = frame.groupby(list(by), sort=False).ngroup().to_numpy()
    for number in range(int(group.max(initial=-1)) + 1):
        yield np.flatnonzero(group == number)


def _mean(values: NDArray[np.floating[Any]]) -> float:
    """Return the mean of the values that are there, NaN without any."""
    there = ~np.isnan(values)
    # zeros keep the order in which numpy adds up: pandas' mean has the same digits
    return float(np.where(there, values, 0.0).sum() / there.sum()) if there.any() else math.nan


def compare_methods(
    results: Run, against: str = "fitted", role: str = "validate", metric: str = "ipe_mean_mm"
) -> pd.DataFrame:
    """Compare every method with `against` on the same insertions, folds and points.

    Repeats in one specimen are first averaged where there are specimens enough (`group_independent`):
    the four depths of one hole are no four needles.

    Returns
    -------
    DataFrame
        `method`, `boundaries` ("measured"), `insertions` (or groups of repeats), the mean of every headline
        metric, `difference_mm` (mean over them of the method's `metric` minus that of `against`; positive:
        the method is worse), `difference_se_mm` (its standard error) and `better` (insertions on which
        `against` has the smaller one).
    """
    errors_frame = results.frames["errors"]
    errors = errors_frame[(errors_frame["role"] == role) & (errors_frame["boundaries"] == "measured")]
    errors = errors.assign(group=group_independent(list(errors["insertion"]), list(errors["specimen"])))
    names = [metric.name for metric in headline_metrics()]
    tables = {
        name: errors.assign(value=_finite_column(errors, name)).pivot_table(
            index=["fold", "group"], columns="method", values="value", sort=False
        )
        for name in names
    }
    compared = tables[metric]
    rows = []
    for method in [name for name in list_methods() if name in compared and against in compared]:
        both = np.isfinite(compared[method]) & np.isfinite(compared[against])
        gap = (compared[method] - compared[against])[both].to_numpy(dtype=np.float64)
        n = len(gap)
        rows.append(
            {
                "method": method,
                "boundaries": "measured",
                "insertions": n,
                **{name: _mean_where(tables[name], method, both) for name in names},
                "difference_mm": gap.mean() if n else np.nan,
                "difference_se_mm": gap.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan,
                "better": int((gap > 0).sum()),
            }
        )
    columns = ("method", "boundaries", "insertions", *names, "difference_mm", "difference_se_mm", "better")
    return pd.DataFrame(rows, columns=columns)


def _mean_where(table: pd.DataFrame, method: str, wanted: "pd.Series[bool]") -> float:
    return float(table[method].reindex(wanted.index)[wanted].mean()) if method in table else np.nan


SIGNIFICANT_SE = 2.0
"""Standard errors up to which a difference may be chance."""

LONE_ERROR_RATIO = 0.5
"""Error of a method over that of the fit, down to which a difference on one insertion may be chance."""


def beats_fit(row: Mapping[str, Any] | pd.Series, metric: str = "ipe_mean_mm") -> bool:
    """Return whether a row of `compare_methods` has a significantly smaller error than the fit.

    Of two insertions or more: by over two standard errors of the difference. A single one has no standard
    error: there a method must err by less than `LONE_ERROR_RATIO` of the fit's error.
    """
    gap, se, error = (_number(row[key]) for key in ("difference_mm", "difference_se_mm", metric))
    if np.isnan(se):
        return error < LONE_ERROR_RATIO * (error - gap)
    return gap < 0 and abs(gap) > SIGNIFICANT_SE * se


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def tabulate_points(results: Run) -> pd.DataFrame:
    """Return `results.shapes` with `ipe_mm`, the in-plane error of every point, and medium and layers."""
    about = results.frames["errors"][[*SCORE_KEYS, "medium", "layers"]]
    return (
        results.frames["shapes"]
        .assign(ipe_mm=_point_distance(results.frames["shapes"]))
        .merge(about, on=list(SCORE_KEYS), how="inner")
    )


def find_bevel_sides(results: Run) -> dict[str, int]:
    """Return by insertion the side of C's x axis that its bevel faces, +1 or -1; deflections point there.

    A needle that did not bend at all is taken to face +1.
    """
    shapes = results.frames["shapes"].sort_values("j").groupby("insertion", sort=False)["measured_y_mm"]
    across = shapes.last() - shapes.first()
    toward = results.frames["errors"].drop_duplicates("insertion").set_index("insertion")["deflection_mm"]
    return {str(name): -1 if across[name] * toward[name] < 0 else 1 for name in across.index}


def _point_distance(shapes: pd.DataFrame) -> pd.Series:
    """Return the distance between the two curves at every point, mm."""
    across, along = (shapes[f"simulated_{axis}_mm"] - shapes[f"measured_{axis}_mm"] for axis in ("y", "x"))
    return pd.Series(np.hypot(across, along), index=shapes.index)


def _find_curves(results: Run) -> dict[Any, ComparedCurves]:
    """Return the compared curves of every row of `errors` that has them, by `SCORE_KEYS`."""
    shapes = results.frames["shapes"]
    columns = [f"{which}_{axis}_mm" for which in ("simulated", "measured") for axis in "xy"]
    values = shapes[columns].to_numpy(dtype=np.float64)
    return {
        tuple(shapes[name].iat[at[0]] for name in SCORE_KEYS): compare_curves(values[at, :2], values[at, 2:])
        for at in _group_positions(shapes, SCORE_KEYS)
    }


def _finite_column(frame: pd.DataFrame, name: str) -> "pd.Series[float]":
    """Return a column with infinities as NaN, so that a failed solve never enters a mean; NaN without it."""
    if name not in frame:
        return pd.Series(np.nan, frame.index)
    values = frame[name].astype(float)
    return values.where(np.isfinite(values))


Group = tuple[str, str, int]


def tabulate_design(job: Job) -> pd.DataFrame:
    """Return one row per role, medium and layers; folds share their insertions.

    `insertions_other` is how many of the same insertions the other reading counts there; a group that only
    the other reading has is left out of the first count.
    """
    ours, others = (
        _group_by_layers(job, r)
        for r in (job.record.layer_count_rule, get_other_rule(job.record.layer_count_rule))
    )
    rows = [_design_row(group, ours.get(group, {}), others.get(group, {})) for group in {**ours, **others}]
    return pd.DataFrame(rows, columns=list(COLUMNS["design"])).sort_values(
        ["role", "medium", "layers"], ascending=[True, True, False], ignore_index=True
    )


def _group_by_layers(job: Job, layer_count_rule: LayerCountRule) -> dict[Group, dict[str, Insertion]]:
    found: dict[Group, dict[str, Insertion]] = {}
    for role, insertion in _iterate_roles(job):
        group = (role, insertion.medium, count_layers(insertion, layer_count_rule))
        found.setdefault(group, {})[insertion.id] = insertion
    return found


def _iterate_roles(job: Job) -> Iterator[tuple[str, Insertion]]:
    for fold in job.folds:
        yield from (("tune", insertion) for insertion in fold.tune)
        yield from (("validate", insertion) for insertion in fold.validate)


def _design_row(group: Group, ours: dict[str, Insertion], others: dict[str, Insertion]) -> Row:
    members = (ours or others).values()
    depths, deflections = [one.depth for one in members], [one.deflection for one in members]
    return {
        **dict(zip(("role", "medium", "layers"), group, strict=True)),
        "insertions": len(ours),
        "insertions_other": len(others),
        "depth_min_mm": min(depths),
        "depth_max_mm": max(depths),
        "deflection_min_mm": min(deflections),
        "deflection_max_mm": max(deflections),
    }
