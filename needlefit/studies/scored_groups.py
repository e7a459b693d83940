"""Our errors beside the paper's, one row per group, method and metric: the CSV files, and what is printed.

The paper counts needles that end at a boundary in one way where it lists them and in another where it divides
them among its studies. A study states which reading decides what tunes and what validates; with the same fit
and the same predictions the other one only makes other groups, whose cells stand beside the first.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from typing import Any, Literal

import pandas as pd

from needlefit.datasets.select import get_other_rule
from needlefit.inference.baselines import BASELINES
from needlefit.metrics import headline_metrics, list_metrics
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies import paper
from needlefit.studies.run import Run
from needlefit.studies.summary import AGGREGATE_COLUMNS, aggregate, beats_fit, compare_methods
from needlefit.studies.verdict import BestBaseline

_GROUP_COLUMNS = ("study", "grouping", "medium", "layers", "alternate_count")
_SCORE_COLUMNS = ("method", "boundaries", *AGGREGATE_COLUMNS, "paper", "paper_insertions")
_DESCRIPTION_COLUMNS = ("layer_count_rule", "comparable", "comparison", "origin")
COLUMNS = (*_GROUP_COLUMNS, *_SCORE_COLUMNS, *_DESCRIPTION_COLUMNS)
"""Columns of both tables."""

TE = "te_mm"
"""The metric of verdicts, of warnings about them, and of every comparison of methods in words."""

HELD_OUT, BY_LAYERS, BY_MEDIA = "held_out", "layers", "media"
"""Values of `grouping`: insertions held out, or fitted to, by medium and number of layers or by medium."""

_PUBLISHED: Mapping[str, tuple[paper.TableName, Mapping[str, str]]] = {
    HELD_OUT: ("validation", {"validate_medium": "medium", "validate_layers": "layers"}),
    BY_LAYERS: ("tuning_by_layers", {"medium": "medium", "layers": "layers"}),
    BY_MEDIA: ("tuning_by_media", {"medium": "medium"}),
}
"""The paper's table of each grouping, and which of our columns stand in its columns."""


@dataclass(frozen=True)
class ScoredGroup:
    """The rows of one group: all methods and metrics.

    Attributes
    ----------
    head : Row
        The first row of the fit with measured boundaries: what all have in common, and its counts.
    rows : mapping
        By method, boundaries and metric.
    """

    head: Row
    rows: Mapping[tuple[str, str, str], Row]

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
    """Return the groups of held-out insertions."""
    return list_groups(tabulate_validation(*results, with_alternate=with_alternate))


def study_label(results: Run) -> str | int:
    """Return the paper's number of the study, or its name where the paper has none."""
    number = getattr(results.record, "paper_study", None)
    return results.name if number is None else int(number)


def select_group(frame: pd.DataFrame, group: ScoredGroup) -> pd.DataFrame:
    """Return the rows of a frame that are of a group: of its medium and, if it has one, number of layers."""
    inside = frame["medium"] == group.head["medium"]
    if group.head["layers"] is not None:
        inside &= frame["layers"] == group.head["layers"]
    members: pd.DataFrame = frame[inside]
    return members


def list_judged_groups(results: Run) -> list[ScoredGroup]:
    """Return the groups that verdicts are about: those held out, of a fit the media fitted to."""
    groups = [] if results.kind == "fit" else list_held_out_groups(results)
    tuning = tabulate_tuning(results) if not groups else None
    return groups if tuning is None else list_groups(tuning[tuning["grouping"] == BY_MEDIA])


def find_best_baseline(group: ScoredGroup) -> str | None:
    """Return the baseline with the smallest tip error."""
    errors = {name: group.get(TE, method=name) for name in BASELINES.names()}
    known = {name: error for name, error in errors.items() if error is not None}
    return min(known, key=lambda name: known[name], default=None)


def compare_best_baseline(results: Run, group: ScoredGroup) -> BestBaseline | None:
    """Return the best baseline of a group and whether it is significantly better or worse than the fit."""
    best = find_best_baseline(group)
    if best is None:
        return None
    verdict: Literal["better", "worse", "tie"] = (
        "better"
        if _beats(results, group, best, "fitted")
        else "worse"
        if _beats(results, group, "fitted", best)
        else "tie"
    )
    return BestBaseline(BASELINES[best].description, group.get(TE, method=best), verdict)


def _beats(results: Run, group: ScoredGroup, method: str, other: str) -> bool:
    """Return whether the tip errors of a method are significantly smaller than those of another."""
    return any(beats_fit(row, TE) for row in compare_group(results, group, other) if row["method"] == method)


def compare_group(results: Run, group: ScoredGroup, against: str = "fitted") -> list[Row]:
    """Return every method's tip error on the insertions of a group beside that of another method."""
    role = "validate" if group.head["grouping"] == HELD_OUT else "tune"
    here = results.with_frames(errors=select_group(results.frames["errors"], group))
    return to_records(compare_methods(here, against=against, role=role, metric=TE))


class _IdentityKey:
    """Run as a key of a cache: frames have no hash, so identity stands for equality."""

    def __init__(self, results: Run) -> None:
        self.results = results

    def __hash__(self) -> int:
        return id(self.results)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _IdentityKey) and other.results is self.results


def _make_frame(results: Iterable[Run], groupings: tuple[str, ...], with_alternate: bool) -> pd.DataFrame:
    """Return the rows as a frame in which counts stay whole numbers where some are missing."""
    rows = [
        row
        for one in results
        for grouping in groupings
        for row in _cached_rows(_IdentityKey(one), grouping, list_metric_names(), with_alternate)
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"layers": "Int64", "paper_insertions": "Int64"})


def list_metric_names() -> tuple[str, ...]:
    """Return the names of all metrics in the order of tables."""
    return tuple(metric.name for metric in list_metrics())


@lru_cache(maxsize=64)
def _cached_rows(
    key: _IdentityKey, grouping: str, metrics: tuple[str, ...], with_alternate: bool
) -> tuple[Row, ...]:
    """Return the rows of one grouping, made once: tables, figures and sentences of a report ask for them."""
    return tuple(_make_rows(key.results, grouping, with_alternate))


def _make_rows(results: Run, grouping: str, with_alternate: bool) -> Iterator[Row]:
    """Yield the rows by the study's reading, then those that the other one makes different, if wanted."""
    role = "validate" if grouping == HELD_OUT else "tune"
    groups = find_regrouped(results, role) if with_alternate else set()
    for one in (results, *([use_alternate_count(results)] if groups else [])):
        for row in _group_rows(one, role, grouping):
            if one is results or (row["medium"], row.get("layers")) in groups:
                yield {**row, "alternate_count": one is not results}


def _group_rows(results: Run, role: str, grouping: str) -> Iterator[Row]:
    """Yield the rows of every group in which the fit is scored."""
    keys = ("medium",) if grouping == BY_MEDIA else ("medium", "layers")
    errors, shapes = results.frames["errors"], results.frames["shapes"]
    here = results.with_frames(errors=errors[errors["role"] == role], shapes=shapes[shapes["role"] == role])
    table = aggregate(here, (*keys, "method", "boundaries"), pooled=True)
    about = {
        "study": study_label(results),
        "grouping": grouping,
        "layer_count_rule": results.record.layer_count_rule,
        "origin": results.origin,
    }
    for key, group in table.groupby(list(keys), sort=False):
        rows = to_records(group)
        ours = next((r for r in rows if (r["method"], r["boundaries"]) == ("fitted", "measured")), None)
        if ours is not None:
            head = {**about, **dict(zip(keys, key, strict=True)), "comparison": _find_comparison(results)}
            printed, beside = _find_paper_row(results, head, ours["insertions"])
            yield from ({**head, **row, "paper": printed.get(row["metric"]), **beside} for row in rows)


def _find_paper_row(results: Run, head: Row, insertions: int) -> tuple[Row, Row]:
    """Return the paper's row of a group, and what its number of insertions says of comparability."""
    name, columns = _PUBLISHED[head["grouping"]]
    match = {theirs: head[ours] for theirs, ours in columns.items()}
    if head["grouping"] == HELD_OUT:
        match["study"] = head["study"]
        design = _find_published("study_design", match)
        count = design[0]["validate_insertions"] if design else None
        sentence = compare_validation_row(results, insertions, count)
    else:
        printed = _find_published(name, match)
        listed = [row["insertions"] for row in _find_published("insertions", match)]
        count = sum(listed) if printed else None
        sentence = compare_tuning_row(results, insertions, count)
    printed = _find_published(name, match)
    return printed[0] if printed else {}, {"paper_insertions": count, "comparable": sentence}


def _find_published(name: paper.TableName, match: Mapping[str, Any]) -> list[Row]:
    return [
        row
        for row in to_records(paper.read_published_table(name))
        if all(row[key] == value for key, value in match.items())
    ]


def _find_comparison(results: Run) -> str:
    return str(results.frames["errors"]["comparison"].iloc[0])


# ---- comparable with the paper's rows, or not; and by the other reading of a needle that ends at a boundary


def compare_validation_row(results: Run, insertions: int, paper_insertions: int | None) -> str:
    """Return the sentence on comparability of a held-out group; `paper_insertions`: None without a row."""
    if paper_insertions is None:
        return "The paper has no such row."
    return _describe_comparability(
        results, insertions, paper_insertions, "measured boundaries, mean over insertions"
    )


def compare_tuning_row(results: Run, insertions: int, paper_insertions: int | None) -> str:
    """Return the sentence on comparability of an in-sample group."""
    if paper_insertions is None:
        return "In-sample; the paper has no such row."
    conditions = "in-sample, measured boundaries, mean over insertions"
    return _describe_comparability(results, insertions, paper_insertions, conditions)


def compare_parameter_row(results: Run, printed: bool) -> str:
    """Return the sentence on comparability of a parameter; `printed`: the paper has a value."""
    if not printed:
        return "The paper has no such value."
    needles = "to simulated needles" if results.origin == "synthetic" else "to other needles"
    return (
        f"Same model, as far as the paper states it: ours fitted {needles}, the paper's tuned by hand on its "
        "real ones; a parameter has no noise floor."
    )


def _describe_comparability(results: Run, insertions: int, paper_insertions: int, conditions: str) -> str:
    if (results.frames["errors"]["comparison"] == "aligned").any():
        return "Not comparable: our errors are after rigid alignment, the paper's in the world frame."
    data = (
        "ours are of simulated needles, the paper's of real ones"
        if results.origin == "synthetic"
        else "the needles are not the paper's"
    )
    count = (
        ""
        if insertions == paper_insertions
        else f", {_count_insertions(insertions)} here, {paper_insertions} there"
    )
    verdict = (
        "Same metrics and design, other data" if not count else "Same metrics, other data and insertions"
    )
    return f"{verdict}: {conditions}; {data}{count}; ours are tuned automatically, the paper's by hand."


def _count_insertions(insertions: int) -> str:
    return "1 insertion" if insertions == 1 else f"{insertions} insertions"


Group = tuple[str, int]


def use_alternate_count(results: Run) -> Run:
    """Return the same results with the insertions grouped by the alternative rule of counting layers."""
    record = results.record.model_copy(
        update={"layer_count_rule": get_other_rule(results.record.layer_count_rule)}
    )
    errors = results.frames["errors"].assign(
        layers=results.frames["errors"]["layers_other"], layers_other=results.frames["errors"]["layers"]
    )
    return replace(results.with_frames(errors=errors), record=record)


def find_regrouped(results: Run, role: str) -> set[Group]:
    """Return medium and layers of the groups that differ between the two rules of counting layers."""
    rows = results.frames["errors"][results.frames["errors"]["role"] == role]
    doubtful = rows[rows["layers"] != rows["layers_other"]]
    counts = (doubtful["layers"], doubtful["layers_other"])
    return {(str(m), int(n)) for layers in counts for m, n in zip(doubtful["medium"], layers, strict=True)}
