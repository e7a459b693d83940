"""Our rows beside the paper's as frames: the contents of the CSV files, of `--json` and of printed tables."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import pandas as pd

from needlefit.reporting.comparability import (
    compare_tuning_row,
    compare_validation_row,
    find_regrouped,
    use_alternate_count,
)
from needlefit.validation import paper
from needlefit.validation.results import FLOOR_COLUMNS, METHODS, METRICS, Results
from needlefit.validation.summary import aggregate

_GROUP_KEYS = ("study", "validate_medium", "validate_layers")
_COUNT_COLUMNS = ("insertions", "not_converged", "edp_flagged", "edp_unflagged_percent")
_AGGREGATION_KEYS = ("role", "method", "boundaries", "medium", "layers")
_DESCRIPTION_COLUMNS = ("layer_count_rule", "alternate_count", "comparable", "comparison", "origin")
_RATIO_COLUMNS = [f"{floor.removeprefix('floor_').removesuffix('_mm')}_over_floor" for floor in FLOOR_COLUMNS]
_POOLED_RATIO_COLUMNS = ["pooled_ipe_mean_over_floor", "pooled_te_over_floor"]
"""Ratios of pooled errors: pooled median and maximum of the floor differ from the mean over insertions."""

Row = dict[str, Any]
RowMaker = Callable[[Results], list[Row]]


def tabulate_validation(*results: Results, with_alternate: bool = False) -> pd.DataFrame:
    """Return one row per held-out group: our errors, the noise floor, other ways of scoring, the paper's
    errors.

    The first columns are those of the paper's validation table (fitted model, measured boundaries, mean
    over insertions). `floor_*` is what perfect parameters would still show, `*_over_floor` the error as a
    multiple of that; `planned_*` the same score with boundaries from the planned straight path, because the
    measured crossings of a held-out insertion leak its outcome; `pooled_*` the statistics of all points
    together; `<method>_ipe_mean_mm` and `<method>_te_mm` the baselines; `paper_*` the paper's cell, blank
    where it has none; `comparable` says what makes the two comparable or not.

    With `with_alternate`, groups that the two readings of the number of layers fill differently stand there
    once more (`alternate_count`), by the other `layer_count_rule`: the same fit and predictions in other
    groups.
    """
    rows = [
        row for one in results for row in _tabulate_groups(one, _validation_rows, "validate", with_alternate)
    ]
    return _make_frame(rows, _validation_columns())


def tabulate_tuning(*results: Results, with_alternate: bool = False) -> pd.DataFrame:
    """Return the in-sample errors of every fit by layers and by media, beside the paper's tuned models.

    `with_alternate` as in `tabulate_validation`.
    """
    columns = [
        *("study", "grouping", "medium", "layers"),
        *METRICS,
        *_COUNT_COLUMNS,
        *FLOOR_COLUMNS,
        *_RATIO_COLUMNS,
    ]
    columns += [f"pooled_{m}" for m in METRICS] + _POOLED_RATIO_COLUMNS
    columns += [*(f"paper_{m}" for m in METRICS), "paper_insertions", *_DESCRIPTION_COLUMNS]
    return _make_frame(
        [row for one in results for row in _tabulate_groups(one, _tuning_rows, "tune", with_alternate)],
        columns,
    )


def to_records(frame: pd.DataFrame) -> list[Row]:
    """Return the rows as JSON values; missing values are None."""
    return [{str(k): _to_plain_value(v) for k, v in row.items()} for row in frame.to_dict("records")]


def study_label(results: Results) -> str | int:
    """Return the paper's number of the study, or its name where the paper has none."""
    number = getattr(results.record, "paper_study", None)
    return results.name if number is None else int(number)


def divide_by_floor(row: Row, error: str) -> float | None:
    """Return an error of a row, such as "te_mm" or "pooled_te_mm", as a multiple of its noise floor."""
    metric = next(name for name in METRICS if error.endswith(name))
    ours, floor = row.get(error), row.get(f"floor_{metric}")
    return None if ours is None or not floor else ours / floor


class _IdentityKey:
    """Results as a key of a cache: frames have no hash, so identity stands for equality."""

    def __init__(self, results: Results) -> None:
        self.results = results

    def __hash__(self) -> int:
        return id(self.results)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _IdentityKey) and other.results is self.results


def _tabulate_groups(
    results: Results, make_rows: RowMaker, role: str, with_alternate: bool
) -> tuple[Row, ...]:
    """Return the rows by the study's reading, then those that the other one makes different, if wanted."""
    return _cached_rows(_IdentityKey(results), make_rows, role, with_alternate)


@lru_cache(maxsize=64)
def _cached_rows(key: _IdentityKey, make_rows: RowMaker, role: str, with_alternate: bool) -> tuple[Row, ...]:
    """Return the same once made: tables, figures and sentences of one report all ask for them."""
    return tuple(_make_rows(key.results, make_rows, role, with_alternate))


def _make_rows(results: Results, make_rows: RowMaker, role: str, with_alternate: bool) -> Iterator[Row]:
    groups = find_regrouped(results, role) if with_alternate else set()
    for one in (results, *([use_alternate_count(results)] if groups else [])):
        for row in make_rows(one):
            medium, layers = (row.get(f"validate_{key}", row.get(key)) for key in ("medium", "layers"))
            if one is results or (medium, layers) in groups:
                ratios = {
                    name: divide_by_floor(row, f"{name.removesuffix('_over_floor')}_mm")
                    for name in _RATIO_COLUMNS
                }
                ratios |= {
                    n: divide_by_floor(row, f"{n.removesuffix('_over_floor')}_mm")
                    for n in _POOLED_RATIO_COLUMNS
                }
                yield {
                    **row,
                    **ratios,
                    "layer_count_rule": one.record.layer_count_rule,
                    "alternate_count": one is not results,
                }


def _validation_rows(results: Results) -> list[Row]:
    macro, pooled = _aggregate_role(results, _AGGREGATION_KEYS, "validate")
    rows = []
    for ours in _select_rows(macro, "fitted", "measured"):
        same = {"medium": ours["medium"], "layers": ours["layers"]}
        rows.append(
            dict(zip(_GROUP_KEYS, (study_label(results), ours["medium"], ours["layers"]), strict=True))
            | {name: ours[name] for name in (*METRICS, *_COUNT_COLUMNS, *FLOOR_COLUMNS)}
            | _prefix_columns("planned", _select_rows(macro, "fitted", "planned", **same), METRICS)
            | _prefix_columns("pooled", _select_rows(pooled, "fitted", "measured", **same), METRICS)
            | _baseline_errors(macro, same)
            | _paper_row(results, ours)
            | {"comparison": _find_comparison(results), "origin": results.origin}
        )
    return rows


def _validation_columns() -> list[str]:
    columns = [*_GROUP_KEYS, *METRICS, *_COUNT_COLUMNS, *FLOOR_COLUMNS, *_RATIO_COLUMNS]
    columns += [
        f"{scoring}_{m}" for scoring in ("planned", "pooled") for m in METRICS
    ] + _POOLED_RATIO_COLUMNS
    columns += [f"{method}_{m}" for method in METHODS[1:] for m in _list_metrics(method)]
    columns += [*(f"paper_{m}" for m in METRICS), "paper_insertions"]
    return [*columns, *_DESCRIPTION_COLUMNS]


def _baseline_errors(macro: list[Row], same: Row) -> Row:
    found: Row = {}
    for method in METHODS[1:]:
        found |= _prefix_columns(
            method, _select_rows(macro, method, "measured", **same), _list_metrics(method)
        )
    return found


def _list_metrics(method: str) -> tuple[str, ...]:
    """Return the metrics given of a method: all of the model's other fit, which has a row of its own."""
    return METRICS if method == "fitted_metric" else ("ipe_mean_mm", "te_mm")


def _paper_row(results: Results, ours: Row) -> Row:
    match = {"study": study_label(results), "validate_medium": ours["medium"]}
    match["validate_layers"] = ours["layers"]
    printed = _find_published("validation", match)
    count = _find_published("study_design", match)
    paper_count = count[0]["validate_insertions"] if count else None
    return (
        _prefix_columns("paper", printed, METRICS)
        | {"paper_insertions": paper_count}
        | {"comparable": compare_validation_row(results, ours["insertions"], paper_count)}
    )


def _tuning_rows(results: Results) -> list[Row]:
    rows = []
    for by, keys in (("layers", ("medium", "layers")), ("media", ("medium",))):
        macro, pooled = _aggregate_role(results, ("role", "method", "boundaries", *keys), "tune")
        for ours in _select_rows(macro, "fitted", "measured"):
            match = {key: ours[key] for key in keys}
            listed = [r["insertions"] for r in _find_published("insertions", match)]
            printed = _find_published("tuning_by_layers" if by == "layers" else "tuning_by_media", match)
            count = sum(listed) if printed else None
            rows.append(
                {"study": study_label(results), "grouping": by, "medium": ours["medium"]}
                | {"layers": ours.get("layers")}
                | {name: ours[name] for name in (*METRICS, *_COUNT_COLUMNS, *FLOOR_COLUMNS)}
                | _prefix_columns("pooled", _select_rows(pooled, "fitted", "measured", **match), METRICS)
                | _prefix_columns("paper", printed, METRICS)
                | {
                    "paper_insertions": count,
                    "comparison": _find_comparison(results),
                    "origin": results.origin,
                }
                | {"comparable": compare_tuning_row(results, ours["insertions"], count)}
            )
    return rows


def _aggregate_role(results: Results, by: tuple[str, ...], role: str) -> tuple[list[Row], list[Row]]:
    """Return the rows of a role: means over insertions of every method, all points pooled of the fit."""
    here = replace(results, errors=results.errors[results.errors["role"] == role])
    fitted = replace(
        here,
        errors=here.errors[here.errors["method"] == "fitted"],
        shapes=results.shapes[(results.shapes["role"] == role) & (results.shapes["method"] == "fitted")],
    )
    return to_records(aggregate(here, by)), to_records(aggregate(fitted, by, "pooled"))


def _find_published(name: paper.TableName, match: Row) -> list[Row]:
    return [
        r
        for r in to_records(paper.read_published_table(name))
        if all(r[key] == value for key, value in match.items())
    ]


def _select_rows(rows: list[Row], method: str, boundaries: str, **match: Any) -> list[Row]:  # noqa: ANN401
    wanted = {"method": method, "boundaries": boundaries, **match}
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def _prefix_columns(prefix: str, rows: list[Row], names: tuple[str, ...]) -> Row:
    return {f"{prefix}_{name}": rows[0][name] if rows else None for name in names}


def _find_comparison(results: Results) -> str:
    return str(results.errors["comparison"].iloc[0])


def _make_frame(rows: list[Row], columns: list[str]) -> pd.DataFrame:
    """Return the rows as a frame in which counts stay whole numbers where some are missing."""
    frame = pd.DataFrame(rows, columns=columns)
    counts = [name for name in ("layers", "paper_insertions") if name in columns]
    return frame.astype(dict.fromkeys(counts, "Int64"))


def _to_plain_value(value: object) -> object:
    """Return a value that JSON can store: NaN and infinity become None, numpy scalars become Python's."""
    value = value.item() if hasattr(value, "item") else value
    if value is pd.NA or value is pd.NaT or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return value
