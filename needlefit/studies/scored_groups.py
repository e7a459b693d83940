"""Our errors beside the paper's, one row per group, method and metric: the CSV files, and what is printed.

The paper counts needles that end at a boundary in one way where it lists them and in another where it divides
them among its studies. A study states which reading decides what tunes and what validates; with the same fit
and the same predictions the other one only makes other groups, whose cells stand beside the first.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from needlefit.datasets.select import get_other_rule, group_rows
from needlefit.geometry.curves import ComparedCurves, compare_curves
from needlefit.metrics import headline_metrics, list_metrics, pool_metric
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies import paper
from needlefit.studies.fit_frames import SCORE_KEYS, list_methods
from needlefit.studies.run import Run, once_per_run

AGGREGATE_COLUMNS = (
    *("metric", "value", "pooled", "floor", "unflagged"),
    *("insertions", "edp_flagged", "not_converged"),
)


def count_reasons(failures: pd.DataFrame) -> dict[str, int]:
    """Return the number of rows of `Run.failures` per reason, most frequent first."""
    kinds = (str(reason).partition(":")[0] for reason in failures["note"])
    return dict(Counter(kinds).most_common())


def aggregate(
    errors: pd.DataFrame, by: Sequence[str], curves: Mapping[Any, ComparedCurves] | None = None
) -> pd.DataFrame:
    """Return one row per group of errors and metric, groups in the order of their first insertion.

    Insertions whose simulation did not converge have no errors: they are left out of the means and
    counted in `not_converged`.

    `by`: columns of `errors`; name `method` and `boundaries` unless one of each is present. `curves`: those
    that were compared, by `SCORE_KEYS`, to fill the column `pooled`.

    Returns
    -------
    DataFrame
        The columns `by`, `metric`, and in the metric's unit: `value`, the mean over insertions of each one's
        own error, as the paper's tables have it; `pooled`, the error of all points of all insertions
        together (`Metric.pool`); `floor`, the mean noise floor; `unflagged`, the mean over insertions that
        deflect by more than their noise floor. Counts of insertions: `insertions`, `edp_flagged` (the
        others of these) and `not_converged`.
    """
    metrics, curves = list_metrics(), curves or {}
    names = [name for metric in metrics for name in (metric.name, f"floor_{metric.name}")]
    finite = {name: _finite_column(errors, name).to_numpy() for name in names}
    flagged, converged = (errors[name].to_numpy(dtype=bool) for name in ("edp_flagged", "converged"))
    insertions = errors["insertion"].to_numpy()
    keys = list(errors[list(by)].itertuples(index=False, name=None))
    scored = list(errors[list(SCORE_KEYS)].itertuples(index=False, name=None)) if curves else []
    rows = []
    for at in _group_positions(errors, by):
        head, clear = dict(zip(by, keys[at[0]], strict=True)), at[~flagged[at]]
        members = [curves[scored[n]] for n in at if scored[n] in curves] if curves else []
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


@once_per_run
def compare_methods(
    results: Run, against: str = "fitted", role: str = "validate", metric: str = "ipe_mean_mm"
) -> pd.DataFrame:
    """Compare every method with `against` on the same insertions, folds and points.

    Errors of one group are first averaged (`group_independent`): the four depths of one hole are no four
    needles.

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
    errors = errors.assign(group=group_rows(errors))
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
        means = {
            name: float(table[method].reindex(both.index)[both].mean()) if method in table else np.nan
            for name, table in tables.items()
        }
        rows.append(
            {
                "method": method,
                "boundaries": "measured",
                "insertions": n,
                **means,
                "difference_mm": gap.mean() if n else np.nan,
                "difference_se_mm": gap.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan,
                "better": int((gap > 0).sum()),
            }
        )
    columns = ("method", "boundaries", "insertions", *names, "difference_mm", "difference_se_mm", "better")
    return pd.DataFrame(rows, columns=columns)


def tabulate_points(results: Run) -> pd.DataFrame:
    """Return `results.shapes` with `ipe_mm`, the in-plane error of every point, and medium and layers."""
    about = results.frames["errors"][[*SCORE_KEYS, "medium", "layers"]]
    shapes = results.frames["shapes"]
    across, along = (shapes[f"simulated_{axis}_mm"] - shapes[f"measured_{axis}_mm"] for axis in ("y", "x"))
    return shapes.assign(ipe_mm=np.hypot(across, along)).merge(about, on=list(SCORE_KEYS), how="inner")


@once_per_run
def find_bevel_sides(results: Run) -> dict[str, int]:
    """Return by insertion the side of C's x axis that its bevel faces, +1 or -1; deflections point there.

    A needle that did not bend at all is taken to face +1.
    """
    shapes = results.frames["shapes"].sort_values("j").groupby("insertion", sort=False)["measured_y_mm"]
    across = shapes.last() - shapes.first()
    toward = results.frames["errors"].drop_duplicates("insertion").set_index("insertion")["deflection_mm"]
    return {str(name): -1 if across[name] * toward[name] < 0 else 1 for name in across.index}


def find_curves(shapes: pd.DataFrame) -> dict[Any, ComparedCurves]:
    """Return the compared curves of every insertion, role and method that has them, by `SCORE_KEYS`."""
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


_GROUP_COLUMNS = ("study", "grouping", "medium", "layers", "alternate_count")
_SCORE_COLUMNS = ("method", "boundaries", *AGGREGATE_COLUMNS, "paper", "paper_insertions")
_DESCRIPTION_COLUMNS = ("layer_count_rule", "comparable", "comparison", "origin")
COLUMNS = (*_GROUP_COLUMNS, *_SCORE_COLUMNS, *_DESCRIPTION_COLUMNS)  #: columns of both tables
TE = "te_mm"  #: the metric of verdicts, of warnings about them, and of every comparison of methods in words
#: values of `grouping`: insertions held out, or fitted to, by medium and number of layers or by medium
HELD_OUT, BY_LAYERS, BY_MEDIA = "held_out", "layers", "media"
#: the paper's table of each grouping, and which of our columns stand in its columns
PUBLISHED: Mapping[str, tuple[paper.TableName, Mapping[str, str]]] = {
    HELD_OUT: ("validation", {"validate_medium": "medium", "validate_layers": "layers"}),
    BY_LAYERS: ("tuning_by_layers", {"medium": "medium", "layers": "layers"}),
    BY_MEDIA: ("tuning_by_media", {"medium": "medium"}),
}


@dataclass(frozen=True, eq=False)
class ScoredGroup:
    """The rows of one group: all methods and metrics."""

    head: Row  #: the first row of the fit with measured boundaries: what all have in common, and its counts
    rows: Mapping[tuple[str, str, str], Row]  #: by method, boundaries and metric

    def get(
        self, metric: str, column: str = "value", method: str = "fitted", boundaries: str = "measured"
    ) -> float | None:
        """Return one number of the group; None where it is not known."""
        row = self.rows.get((method, boundaries, metric))
        return None if row is None else row[column]

    def over_floor(self, metric: str, column: str = "value", **where: str) -> float | None:
        """Return an error as a multiple of its noise floor."""
        error, floor = self.get(metric, column, **where), self.get(metric, "floor")
        return None if error is None or not floor else error / floor

    @property
    def printed(self) -> bool:
        """Whether the paper has a row of this group."""
        return any(self.get(metric.name, "paper") is not None for metric in headline_metrics())


def tabulate_validation(*results: Run, with_alternate: bool = False) -> pd.DataFrame:
    """Return the errors on held-out insertions: one row per study, group, method, boundaries and metric.

    `value` is the mean over insertions of each one's own error, as in the paper, `pooled` that of all points
    together, `floor` what perfect parameters would still show, `paper` the paper's cell of the group, blank
    where it has none; `comparable` says what makes the two comparable or not. With `boundaries` "planned"
    layers are those that the predicted needle crosses, because the measured crossings of a held-out
    insertion leak its outcome.

    With `with_alternate`, groups that the two readings of the number of layers fill differently stand there
    once more (`alternate_count`), by the other `layer_count_rule`: the same fit and predictions in other
    groups.
    """
    return _make_frame(results, (HELD_OUT,), with_alternate)


def tabulate_tuning(*results: Run, with_alternate: bool = False) -> pd.DataFrame:
    """Return the in-sample errors of every fit by layers and by media (`grouping`), beside the paper's.

    Columns and `with_alternate` as in `tabulate_validation`.
    """
    return _make_frame(results, (BY_LAYERS, BY_MEDIA), with_alternate)


def list_groups(table: pd.DataFrame) -> list[ScoredGroup]:
    """Return the groups of a table of errors, in its order."""
    found = []
    for _, group in groupby(to_records(table), key=lambda row: [row[name] for name in _GROUP_COLUMNS]):
        rows = {(row["method"], row["boundaries"], row["metric"]): row for row in group}
        fitted = (row for key, row in rows.items() if key[:2] == ("fitted", "measured"))
        found.append(ScoredGroup(next(fitted), rows))
    return found


def list_held_out_groups(*results: Run, with_alternate: bool = False) -> list[ScoredGroup]:
    return [group for one in results for group in _held_out_groups(one, with_alternate)]


@once_per_run
def _held_out_groups(results: Run, with_alternate: bool) -> list[ScoredGroup]:
    return list_groups(tabulate_validation(results, with_alternate=with_alternate))


def study_label(results: Run) -> str | int:
    """Return the paper's number of the study, or its name where the paper has none."""
    number = getattr(results.record, "paper_study", None)
    return results.name if number is None else int(number)


def select_group(frame: pd.DataFrame, group: ScoredGroup) -> pd.DataFrame:
    """Return the rows of a frame of a group: of its medium and number of layers, where it has them."""
    if group.head["medium"] is None:
        return frame
    inside = frame["medium"] == group.head["medium"]
    if group.head["layers"] is not None:
        inside &= frame["layers"] == group.head["layers"]
    members: pd.DataFrame = frame[inside]
    return members


@once_per_run
def pool_insertions(results: Run, role: str = "validate") -> ScoredGroup | None:
    """Return all insertions of a role as one group; None without a fit to them."""
    errors = results.frames["errors"]
    here = errors[errors["role"] == role]
    rows = [{**row, "paper": None} for row in to_records(aggregate(here, ("method", "boundaries")))]
    by_place = {(row["method"], row["boundaries"], row["metric"]): row for row in rows}
    fitted = next((row for key, row in by_place.items() if key[:2] == ("fitted", "measured")), None)
    if fitted is None:
        return None
    grouping = HELD_OUT if role == "validate" else BY_MEDIA
    head = {"grouping": grouping, "medium": None, "layers": None, "comparison": here["comparison"].iloc[0]}
    return ScoredGroup({**fitted, **head}, by_place)


def _make_frame(results: Iterable[Run], groupings: tuple[str, ...], with_alternate: bool) -> pd.DataFrame:
    """Return the rows as a frame in which counts stay whole numbers where some are missing."""
    rows = [
        row for one in results for grouping in groupings for row in _list_rows(one, grouping, with_alternate)
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"layers": "Int64", "paper_insertions": "Int64"})


@once_per_run
def _list_rows(results: Run, grouping: str, with_alternate: bool) -> list[Row]:
    """Return the rows by the study's reading, then those that the other one makes different, if wanted."""
    role = "validate" if grouping == HELD_OUT else "tune"
    groups = find_regrouped(results, role) if with_alternate else set()
    return [
        {**row, "alternate_count": one is not results}
        for one in (results, *([use_alternate_count(results)] if groups else []))
        for row in _group_rows(one, role, grouping)
        if one is results or (row["medium"], row.get("layers")) in groups
    ]


def _group_rows(results: Run, role: str, grouping: str) -> Iterator[Row]:
    keys = ("medium",) if grouping == BY_MEDIA else ("medium", "layers")
    every = (results.frames["errors"], results.frames["shapes"])
    errors, shapes = (frame[frame["role"] == role] for frame in every)
    table = aggregate(errors, (*keys, "method", "boundaries"), find_curves(shapes))
    about = {
        "study": study_label(results),
        "grouping": grouping,
        "layer_count_rule": results.record.layer_count_rule,
        "origin": results.origin,
        "comparison": str(results.frames["errors"]["comparison"].iloc[0]) if len(errors) else "",
    }
    for key, group in table.groupby(list(keys), sort=False):
        rows = to_records(group)
        ours = next((r for r in rows if (r["method"], r["boundaries"]) == ("fitted", "measured")), None)
        if ours is not None:
            head = {**about, **dict(zip(keys, key, strict=True))}
            printed, beside = _find_paper_row(results, head, ours["insertions"])
            yield from ({**head, **row, "paper": printed.get(row["metric"]), **beside} for row in rows)


def _find_paper_row(results: Run, head: Row, insertions: int) -> tuple[Row, Row]:
    """Return the paper's row of a group, and what its number of insertions says of comparability."""
    name, columns = PUBLISHED[head["grouping"]]
    held_out = head["grouping"] == HELD_OUT
    match = {theirs: head[ours] for theirs, ours in columns.items()}
    match |= {"study": head["study"]} if held_out else {}
    printed = paper.select_rows(name, **match)
    if held_out:
        design = paper.select_rows("study_design", **match)
        count, where = design[0]["validate_insertions"] if design else None, ""
    else:
        listed = [row["insertions"] for row in paper.select_rows("insertions", **match)]
        count, where = sum(listed) if printed else None, "in-sample"
    sentence = compare_with_paper(results, insertions, count, where)
    return printed[0] if printed else {}, {"paper_insertions": count, "comparable": sentence}


# ---- comparable with the paper's rows, or not; and by the other reading of a needle that ends at a boundary


def compare_with_paper(results: Run, insertions: int, paper_insertions: int | None, where: str = "") -> str:
    """Return the sentence on comparability of a group of insertions, held out or `where`.

    `paper_insertions` is None where the paper has no row.
    """
    if paper_insertions is None:
        return f"{where.capitalize()}; the paper has no such row." if where else "The paper has no such row."
    if (results.frames["errors"]["comparison"] == "aligned").any():
        return "Not comparable: our errors are after rigid alignment, the paper's in the world frame."
    verdict, count = "Same metrics and design, other data", ""
    if insertions != paper_insertions:
        verdict = "Same metrics, other data and insertions"
        count = f", {insertions} insertion{'s' * (insertions != 1)} here, {paper_insertions} there"
    data = "the needles are not the paper's"
    if results.origin == "synthetic":
        data = "ours are of simulated needles, the paper's of real ones"
    conditions = ", ".join(filter(None, (where, "measured boundaries, mean over insertions")))
    return f"{verdict}: {conditions}; {data}{count}; ours are tuned automatically, the paper's by hand."


def compare_parameter_row(results: Run, printed: bool) -> str:
    """Return the sentence on comparability of a parameter; `printed`: the paper has a value."""
    if not printed:
        return "The paper has no such value."
    needles = "to simulated needles" if results.origin == "synthetic" else "to other needles"
    return (
        f"Same model, as far as the paper states it: ours fitted {needles}, the paper's tuned by hand on its "
        "real ones; a parameter has no noise floor."
    )


def use_alternate_count(results: Run) -> Run:
    """Return the same results with the insertions grouped by the alternative rule of counting layers."""
    rule, errors = get_other_rule(results.record.layer_count_rule), results.frames["errors"]
    record = results.record.model_copy(update={"layer_count_rule": rule})
    errors = errors.assign(layers=errors["layers_other"], layers_other=errors["layers"])
    return replace(results.with_frames(errors=errors), record=record)


def find_regrouped(results: Run, role: str) -> set[tuple[str, int]]:
    """Return medium and layers of the groups that differ between the two rules of counting layers."""
    rows = results.frames["errors"][results.frames["errors"]["role"] == role]
    doubtful = rows[rows["layers"] != rows["layers_other"]]
    counts = (doubtful["layers"], doubtful["layers_other"])
    return {(str(m), int(n)) for layers in counts for m, n in zip(doubtful["medium"], layers, strict=True)}
