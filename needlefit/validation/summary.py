"""Summarise the errors of single insertions, aggregated in the two ways that differ."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np
import pandas as pd

from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import count_layers, get_other_rule, group_independent
from needlefit.schemas.study import LayerCountRule
from needlefit.validation.job import Job
from needlefit.validation.results import COLUMNS, FLOOR_COLUMNS, METHODS, METRICS, SCORE_KEYS, Results
from needlefit.validation.score import Row

Averaging = Literal["macro", "pooled"]
PAIRED_COLUMNS = (
    *("method", "boundaries", "insertions", "ipe_mean_mm", "te_mm"),
    *("difference_mm", "difference_se_mm", "better"),
)


def count_reasons(failures: pd.DataFrame) -> dict[str, int]:
    """Return the number of rows of `Results.failures` per reason, most frequent first."""
    kinds = (str(reason).partition(":")[0] for reason in failures["reason"])
    return dict(Counter(kinds).most_common())


def aggregate(results: Results, by: Sequence[str], how: Averaging = "macro") -> pd.DataFrame:
    """Return one row per group of `results.errors`, groups in the order of their first insertion.

    `macro` takes the mean over insertions of each insertion's own value, as the paper's tables do
    (`ipe_std_mm` is the mean of the insertions' standard deviations). `pooled` takes the statistics of
    all points of all insertions together; its TE is the mean over tips and its EDP is the sum of the
    tip errors over the sum of the measured deflections, so that no small deflection dominates it.

    Insertions whose simulation did not converge have no errors: they are left out of the means and
    counted in `not_converged`.

    Parameters
    ----------
    results : Results
        What to aggregate.
    by : sequence of str
        Columns of `results.errors`; name `method` and `boundaries` unless one of each is present.
    how : str
        "macro" or "pooled".

    Returns
    -------
    DataFrame
        The columns `by`, the metrics and floors (mm, percent), `insertions`, `edp_flagged`,
        `edp_unflagged_percent` and `not_converged` (counts of insertions).
    """
    errors = results.errors.assign(**{m: _finite(results.errors[m]) for m in (*METRICS, *FLOOR_COLUMNS)})
    clouds = _point_errors(results, errors, by) if how == "pooled" else {}
    rows = []
    for key, group in errors.groupby(list(by), sort=False):
        row: dict[str, Any] = dict(zip(by, key, strict=True))
        row |= {name: group[name].mean() for name in (*METRICS, *FLOOR_COLUMNS)}
        if how == "pooled":
            row |= _pooled(group, clouds.get(key, pd.Series(dtype=float)))
        rows.append(row | _counts(group))
    columns = [
        *by,
        *METRICS,
        *FLOOR_COLUMNS,
        "insertions",
        "edp_flagged",
        "edp_unflagged_percent",
        "not_converged",
    ]
    return pd.DataFrame(rows, columns=columns)


def compare_methods(results: Results, against: str = "fitted", role: str = "validate") -> pd.DataFrame:
    """Compare every method with `against` on the same insertions, folds and points.

    Repeats in one specimen are first averaged where there are specimens enough (`group_independent`):
    the four depths of one hole are no four needles.

    Returns
    -------
    DataFrame
        `method`, `boundaries` ("measured"), `insertions` (or groups of repeats), macro `ipe_mean_mm` and
        `te_mm`, `difference_mm` (mean over them of the method's mean IPE minus that of `against`; positive:
        the method is worse), `difference_se_mm` (its standard error) and `better` (insertions on which
        `against` has the smaller mean IPE).
    """
    errors = results.errors[(results.errors["role"] == role) & (results.errors["boundaries"] == "measured")]
    errors = errors.assign(group=group_independent(list(errors["insertion"]), list(errors["specimen"])))
    ipe, te = (
        errors.assign(value=_finite(errors[metric])).pivot_table(
            index=["fold", "group"], columns="method", values="value", sort=False
        )
        for metric in ("ipe_mean_mm", "te_mm")
    )
    rows = []
    for method in [name for name in METHODS if name in ipe and against in ipe]:
        both = np.isfinite(ipe[method]) & np.isfinite(ipe[against])
        gap = (ipe[method] - ipe[against])[both].to_numpy(dtype=np.float64)
        n = len(gap)
        rows.append(
            {
                "method": method,
                "boundaries": "measured",
                "insertions": n,
                "ipe_mean_mm": ipe[method][both].mean(),
                "te_mm": te[method][both].mean(),
                "difference_mm": gap.mean() if n else np.nan,
                "difference_se_mm": gap.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan,
                "better": int((gap > 0).sum()),
            }
        )
    return pd.DataFrame(rows, columns=PAIRED_COLUMNS)


SIGNIFICANT_SE = 2.0
"""Standard errors up to which a difference may be chance."""

LONE_ERROR_RATIO = 0.5
"""Error of a method over that of the fit, down to which a difference on one insertion may be chance."""


def beats_fit(row: Mapping[str, Any] | pd.Series) -> bool:
    """Return whether a row of `compare_methods` has a significantly smaller error than the fit.

    Of two insertions or more: by over two standard errors of the difference. A single one has no standard
    error: there a method must err by less than `LONE_ERROR_RATIO` of the fit's error.
    """
    gap, se, error = (_number(row[key]) for key in ("difference_mm", "difference_se_mm", "ipe_mean_mm"))
    if np.isnan(se):
        return error < LONE_ERROR_RATIO * (error - gap)
    return gap < 0 and abs(gap) > SIGNIFICANT_SE * se


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def tabulate_points(results: Results) -> pd.DataFrame:
    """Return `results.shapes` with `ipe_mm`, the in-plane error of every point, and medium and layers."""
    about = results.errors[[*SCORE_KEYS, "medium", "layers"]]
    return results.shapes.assign(ipe_mm=_point_distance(results.shapes)).merge(
        about, on=list(SCORE_KEYS), how="inner"
    )


def find_bevel_sides(results: Results) -> dict[str, int]:
    """Return by insertion the side of C's x axis that its bevel faces, +1 or -1; deflections point there.

    A needle that did not bend at all is taken to face +1.
    """
    shapes = results.shapes.sort_values("j").groupby("insertion", sort=False)["measured_y_mm"]
    across = shapes.last() - shapes.first()
    toward = results.errors.drop_duplicates("insertion").set_index("insertion")["deflection_mm"]
    return {str(name): -1 if across[name] * toward[name] < 0 else 1 for name in across.index}


def _point_errors(results: Results, errors: pd.DataFrame, by: Sequence[str]) -> dict[Any, pd.Series]:
    """Return the in-plane errors of all points by group."""
    keys = errors[[*SCORE_KEYS, *(name for name in by if name not in SCORE_KEYS)]]
    cloud = results.shapes.assign(ipe_mm=_point_distance(results.shapes)).merge(
        keys, on=list(SCORE_KEYS), how="inner"
    )
    return {key: group["ipe_mm"] for key, group in cloud.groupby(list(by), sort=False)}


def _point_distance(shapes: pd.DataFrame) -> pd.Series:
    """Return the distance between the two curves at every point, mm."""
    across, along = (shapes[f"simulated_{axis}_mm"] - shapes[f"measured_{axis}_mm"] for axis in ("y", "x"))
    return pd.Series(np.hypot(across, along), index=shapes.index)


def _pooled(group: pd.DataFrame, cloud: pd.Series) -> dict[str, Any]:
    ipe = _finite(cloud)
    known = group[_finite(group["te_mm"]).notna()]
    deflected = float(known["deflection_mm"].abs().sum())
    return {
        "median_err_mm": ipe.median(),
        "ipe_mean_mm": ipe.mean(),
        "ipe_std_mm": ipe.std(ddof=0),
        "ipe_max_mm": ipe.max(),
        "edp_percent": 100 * float(known["te_mm"].sum()) / deflected if deflected > 0 else np.nan,
    }


def _counts(group: pd.DataFrame) -> dict[str, Any]:
    flagged = group["edp_flagged"].astype(bool)
    converged = group["converged"].astype(bool)
    return {
        "insertions": group["insertion"].nunique(),
        "edp_flagged": group.loc[flagged, "insertion"].nunique(),
        "edp_unflagged_percent": group.loc[~flagged, "edp_percent"].mean(),
        "not_converged": group.loc[~converged, "insertion"].nunique(),
    }


def _finite(values: pd.Series) -> pd.Series:
    """Return the values with infinities as NaN, so that a failed solve never enters a mean."""
    return values.astype(float).where(np.isfinite(values.astype(float)))


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
