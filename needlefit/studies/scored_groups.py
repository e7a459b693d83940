"""Our errors beside the paper's, one row per group, method and metric: the CSV files, and what is printed."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets import paper
from needlefit.datasets.select import group_rows
from needlefit.metrics import known_metrics, verdict_metrics
from needlefit.reporting.table_files import Row, select_rows, to_records
from needlefit.schemas.base import DIRECTIONS
from needlefit.schemas.run_metadata import JobMetadata
from needlefit.studies.run import PREDICTION_METHOD, FitFrames, Run, list_methods, value_of_run

AGGREGATE_COLUMNS = ("metric", "value", "floor", "unflagged", "insertions", "edp_flagged", "not_converged")


def aggregate(errors: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Return one row per group of errors and metric, groups in the order of their first insertion.

    Insertions whose simulation did not converge have no errors: they are left out of the means and
    counted in `not_converged`.

    `by`: columns of `errors`; name `method` and `boundaries` unless one of each is present.

    Returns
    -------
    DataFrame
        The columns `by`, `metric`, and in the metric's unit: `value`, the mean over insertions of each one's
        own error, as the paper's tables have it; `floor`, the mean noise floor; `unflagged`, the mean over
        insertions that deflect by more than their noise floor. Counts of insertions: `insertions`,
        `edp_flagged` (the others of these) and `not_converged`.
    """
    metrics, keys = [metric.name for metric in known_metrics(errors.columns)], list(by)
    names = [name for metric in metrics for name in (metric, f"floor_{metric}")]
    table = errors.reindex(columns=names).to_numpy(dtype=np.float64).reshape(-1, len(metrics), 2)
    ids, places = errors["insertion"].to_numpy(), pd.Series(np.arange(len(errors)), errors.index)
    flagged, converged = (errors[name].to_numpy(dtype=bool) for name in ("edp_flagged", "converged"))
    rows = []
    for key, group in places.groupby([errors[name] for name in keys], sort=False):
        members = group.to_numpy()
        head = {
            **dict(zip(keys, key, strict=True)),
            "insertions": len(set(ids[members])),
            "edp_flagged": len(set(ids[members[flagged[members]]])),
            "not_converged": len(set(ids[members[~converged[members]]])),
        }
        means, unflagged = (_average_finite(table[some]) for some in (members, members[~flagged[members]]))
        for name, (value, floor), (kept, _) in zip(metrics, means.tolist(), unflagged.tolist(), strict=True):
            rows.append({**head, "metric": name, "value": value, "floor": floor, "unflagged": kept})
    return pd.DataFrame(rows, columns=[*by, *AGGREGATE_COLUMNS])


def count_directions(run: Run) -> int:
    """Return how many deflections of a point were compared: along y, and z."""
    return DIRECTIONS[run.knows(JobMetadata).compared]


@value_of_run
def compare_methods(run: Run) -> pd.DataFrame:
    """Compare the errors of every method with ours on the same insertions and folds of the scored role.

    Ours are those of the prediction where there is one; those of the fit are then in no row.

    Errors of one group are first averaged (`group_independent`): the four depths of one hole are no four
    needles.

    Returns
    -------
    DataFrame
        Ours first: `method`, `insertions` (or groups of repeats), the mean of every headline metric,
        `difference_mm` (mean over them of the method's tip error, without any its score, minus ours;
        positive: the method is worse), `difference_se_mm` (its standard error) and `better` (insertions on
        which ours is smaller).
    """
    errors = FitFrames.of(run).select_errors()
    names = [metric.name for metric in known_metrics(errors.columns) if metric.headline]
    score = group.score if (group := pool_insertions(run)) else TE
    values = errors.reindex(columns=names).astype(float)
    keys = [errors["method"], errors["fold"], list(group_rows(errors))]
    means = values.where(np.isfinite(values)).groupby(keys, sort=False).mean()
    present, rows = set(errors["method"]), []
    methods = [name for name in list_methods() if name in present]
    methods = methods[PREDICTION_METHOD in present :]
    for method in methods:
        theirs = means.loc[method]
        gaps = (theirs[score] - means.loc[methods[0]][score]).dropna()
        averages = {name: float(theirs.loc[gaps.index, name].mean()) for name in names}
        row = {"method": method, "insertions": len(gaps), **averages}
        row |= {"difference_mm": gaps.mean(), "difference_se_mm": gaps.sem(), "better": int((gaps > 0).sum())}
        rows.append(row)
    columns = ("method", "insertions", *names, "difference_mm", "difference_se_mm", "better")
    return pd.DataFrame(rows, columns=columns)


@value_of_run
def find_bevel_sides(run: Run) -> dict[str, int]:
    """Return by insertion the side of C's x axis that its bevel faces, +1 or -1; deflections point there.

    A needle that did not bend at all is taken to face +1.
    """
    frames = FitFrames.of(run)
    shapes = frames.shapes.sort_values("j").groupby("insertion", sort=False)["measured_y_mm"]
    across = shapes.last() - shapes.first()
    toward = frames.errors.drop_duplicates("insertion").set_index("insertion")["deflection_mm"]
    return {str(name): -1 if across[name] * toward[name] < 0 else 1 for name in across.index}


def orient_pits(run: Run) -> dict[str, Floats]:
    """Return the levels of tips, where these were measured, and shapes; of tips they are stored toward +y."""
    predictions = FitFrames.of(run).predictive
    sides = predictions["insertion"].map(find_bevel_sides(run)).to_numpy(dtype=np.float64)
    tips, shapes = (predictions[f"{name}_pit"].to_numpy(dtype=np.float64) for name in ("tip", "shape"))
    if np.isnan(tips).any():
        return {"shape": shapes}
    if count_directions(run) > 1:  # those of tips are by the distance from the predicted one
        return {"tip": tips, "shape": shapes}
    # The PIT value of -y is 1 minus that of y: needles whose bevels face opposite sides become comparable.
    return {"tip": np.where(sides > 0, tips, 1 - tips), "shape": shapes}


def _average_finite(rows: Floats) -> Floats:
    """Return the means (M, C) of rows (N, M, C) without what is not finite: a failed solve; NaN of none."""
    is_finite = np.isfinite(rows)
    with np.errstate(invalid="ignore"):  # summed along contiguous columns: pairwise, as pandas does
        return np.asarray(np.where(is_finite, rows, 0.0).T.copy().sum(axis=-1).T / is_finite.sum(axis=0))


_GROUP_COLUMNS = ("study", "grouping", "medium", "layers")
_SCORE_COLUMNS = ("method", "boundaries", *AGGREGATE_COLUMNS, "paper", "paper_insertions")
_DESCRIPTION_COLUMNS = ("layer_count_rule", "comparison", "compared", "origin")
COLUMNS = (*_GROUP_COLUMNS, *_SCORE_COLUMNS, *_DESCRIPTION_COLUMNS)  #: columns of both tables
#: metric of verdicts, of warnings about them, and of every comparison of methods in words
TE = "te_mm"
#: value of the column `grouping` by table: insertions held out, or fitted to, by medium and layers
GROUPINGS = {"validation": "held_out", "tuning": "layers"}


@dataclass(frozen=True, eq=False)
class ScoredGroup:
    """All methods and metrics of one group, and its counts of the fit with measured boundaries."""

    rows: Mapping[tuple[str, str, str], Row]  #: by method, boundaries and metric
    grouping: str
    medium: str | None  #: None: all insertions of a role together, as for `layers`
    layers: int | None
    insertions: int
    edp_flagged: int
    not_converged: int
    comparison: str
    study: str | int | None = None

    @cached_property
    def score(self) -> str:
        """The metric of its verdict: the first of `verdict_metrics` that is known."""
        known_scores = {metric for (_, _, metric), row in self.rows.items() if row["value"] is not None}
        return next((metric.name for metric in verdict_metrics() if metric.name in known_scores), TE)

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


def tabulate_errors(table: str, *runs: Run) -> pd.DataFrame:
    """Return the errors on insertions: one row per study, group, method, boundaries and metric.

    `table`: "validation" of those held out, "tuning" of those fitted to. `value` is the mean over insertions
    of each one's own error, as in the paper, `floor` what perfect parameters would still show, `paper` the
    paper's cell of the group, of its own needles, blank where it has none. With `boundaries` "planned" layers
    are those that the predicted needle crosses, because the measured crossings of a held-out insertion leak
    its outcome. Counts stay whole numbers where some are missing.
    """
    groups = [group for run in runs for group in list_groups(run, table)]
    rows = [row for group in groups for row in group.rows.values()]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"layers": "Int64", "paper_insertions": "Int64"})


def _make_group(rows: Iterable[Row], **head: Any) -> ScoredGroup | None:  # noqa: ANN401 - any of its values
    """Return the group of some rows, with what else is known of all; None without rows of the fit."""
    by_place = {(row["method"], row["boundaries"], row["metric"]): row for row in rows}
    fitted = next((row for key, row in by_place.items() if key[:2] == ("fitted", "measured")), None)
    if fitted is None:
        return None
    values = {"rows": by_place, **fitted, **head}
    return ScoredGroup(**{key: values[key] for key in ScoredGroup.__dataclass_fields__ if key in values})


@value_of_run
def list_groups(run: Run, table: str = "validation") -> list[ScoredGroup]:
    """Return the groups of a table of errors, by medium and layers; their first insertions order them."""
    errors = select_rows(run.frames["errors"], role="validate" if table == "validation" else "tune")
    means, groups = aggregate(errors, ("medium", "layers", "method", "boundaries")), list[ScoredGroup]()
    for (medium, layers), some in means.groupby(["medium", "layers"], sort=False):
        rows = to_records(some)
        about = {"study": study_label(run), "grouping": GROUPINGS[table], "medium": medium, "layers": layers}
        printed, insertions = find_paper_row(about)
        printed = {} if count_directions(run) > 1 else printed  # the paper compares needles in their planes
        beside = {
            "paper_insertions": insertions,
            "layer_count_rule": run.record.layer_count_rule,
            "origin": run.origin,
            "comparison": str(errors["comparison"].iloc[0]),
            "compared": run.knows(JobMetadata).compared,
        }
        group = _make_group({**about, **row, "paper": printed.get(row["metric"]), **beside} for row in rows)
        groups += [group] if group is not None else []
    return groups


def study_label(run: Run) -> str | int:
    """Return the paper's number of the study, or its name where the paper has none."""
    number = getattr(run.record, "paper_study", None)
    return run.name if number is None else int(number)


@value_of_run
def pool_insertions(run: Run) -> ScoredGroup | None:
    """Return all insertions of the scored role as one group; None without a fit to them."""
    role = FitFrames.of(run).role
    here = select_rows(run.frames["errors"], role=role)
    rows = [{**row, "paper": None} for row in to_records(aggregate(here, ("method", "boundaries")))]
    about = {"medium": None, "layers": None, "comparison": next(iter(here["comparison"]), None)}
    return _make_group(rows, grouping=GROUPINGS["validation" if role == "validate" else "tuning"], **about)


def find_paper_row(group: Row) -> tuple[Row, int | None]:
    """Return the paper's row of a group, empty where it has none, and its number of insertions."""
    medium, layers = group["medium"], group["layers"]
    if group["grouping"] == GROUPINGS["validation"]:
        match = {"study": group["study"], "validate_medium": medium, "validate_layers": layers}
        printed, design = (paper.select_rows(name, **match) for name in ("validation", "study_design"))
        return next(iter(printed), {}), design[0]["validate_insertions"] if design else None
    printed, listed = (
        paper.select_rows(name, medium=medium, layers=layers) for name in ("tuning_by_layers", "insertions")
    )
    if listed == paper.select_rows("insertions", medium=medium):  # all of this number of layers
        printed = printed or paper.select_rows("tuning_by_media", medium=medium)
    return next(iter(printed), {}), sum(row["insertions"] for row in listed) if printed else None
