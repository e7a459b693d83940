"""Our errors beside the paper's, one row per group, method and metric: the CSV files, and what is printed."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Any

import pandas as pd

from needlefit.metrics import headline_metrics, list_metrics
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies import paper
from needlefit.studies.kinds.cross_validation.comparability import (
    compare_tuning_row,
    compare_validation_row,
    find_regrouped,
    use_alternate_count,
)
from needlefit.studies.run import Run
from needlefit.studies.summary import AGGREGATE_COLUMNS, aggregate

_GROUP_COLUMNS = ("study", "grouping", "medium", "layers", "alternate_count")
_SCORE_COLUMNS = ("method", "boundaries", *AGGREGATE_COLUMNS, "paper", "paper_insertions")
_DESCRIPTION_COLUMNS = ("layer_count_rule", "comparable", "comparison", "origin")
COLUMNS = (*_GROUP_COLUMNS, *_SCORE_COLUMNS, *_DESCRIPTION_COLUMNS)
"""Columns of both tables."""

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
