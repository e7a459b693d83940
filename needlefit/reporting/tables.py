"""Our rows beside the paper's, as frames: what the CSV files, `--json` and the printed tables hold."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import pandas as pd

from needlefit.reporting.comparability import comparable_tuning, comparable_validation
from needlefit.reporting.readings import regrouped, reread
from needlefit.validation import paper
from needlefit.validation.results import FLOOR_COLUMNS, METHODS, METRICS, Results
from needlefit.validation.summary import aggregate

_KEYS = ("study", "validate_medium", "validate_layers")
_COUNTS = ("insertions", "not_converged", "edp_flagged", "edp_unflagged_percent")
_BY = ("role", "method", "boundaries", "medium", "layers")
_ABOUT = ("layer_count_rule", "alternate_count", "comparable", "comparison", "origin")
_RATIOS = [f"{floor.removeprefix('floor_').removesuffix('_mm')}_over_floor" for floor in FLOOR_COLUMNS]
_POOLED_RATIOS = ["pooled_ipe_mean_over_floor", "pooled_te_over_floor"]
"""Of all points together the floor's median and maximum are others than the mean of each insertion's."""

Row = dict[str, Any]
RowsOf = Callable[[Results], list[Row]]


def validation_table(*results: Results, both: bool = False) -> pd.DataFrame:
    """Return one row per held-out group: ours, its noise floor, other ways of scoring it, the paper's.

    The first columns are those of the paper's validation table (fitted model, measured boundaries, mean
    over insertions). `floor_*` is what perfect parameters would still show, `*_over_floor` the error as a
    multiple of that; `planned_*` the same score with boundaries from the planned straight path, because the
    measured crossings of a held-out insertion leak its outcome; `pooled_*` the statistics of all points
    together; `<method>_ipe_mean_mm` and `<method>_te_mm` the rivals; `paper_*` the paper's cell, blank where
    it has none; `comparable` says what makes the two comparable or not.

    With `both`, groups that the two readings of the number of layers fill differently stand there once
    more (`alternate_count`), by the other `layer_count_rule`: the same fit and predictions in other groups.
    """
    rows = [row for one in results for row in _read(one, _validation_rows, "validate", both)]
    return _frame(rows, _validation_columns())


def tuning_table(*results: Results, both: bool = False) -> pd.DataFrame:
    """Return the in-sample errors of every fit by layers and by media, beside the paper's tuned models.

    `both` as in `validation_table`.
    """
    columns = [*("study", "grouping", "medium", "layers"), *METRICS, *_COUNTS, *FLOOR_COLUMNS, *_RATIOS]
    columns += [f"pooled_{m}" for m in METRICS] + _POOLED_RATIOS
    columns += [*(f"paper_{m}" for m in METRICS), "paper_insertions", *_ABOUT]
    return _frame([row for one in results for row in _read(one, _tuning_rows, "tune", both)], columns)


def records(frame: pd.DataFrame) -> list[Row]:
    """Return the rows as plain values for JSON; what is missing is None."""
    return [{str(k): _plain(v) for k, v in row.items()} for row in frame.to_dict("records")]


def study_label(results: Results) -> str | int:
    """Return the paper's number of the study, or its name where the paper has none."""
    number = getattr(results.record, "paper_study", None)
    return results.name if number is None else int(number)


def over_floor(row: Row, error: str) -> float | None:
    """Return an error of a row, such as "te_mm" or "pooled_te_mm", as a multiple of its noise floor."""
    metric = next(name for name in METRICS if error.endswith(name))
    ours, floor = row.get(error), row.get(f"floor_{metric}")
    return None if ours is None or not floor else ours / floor


class _Itself:
    """Results as a key: equal to nothing but themselves."""

    def __init__(self, results: Results) -> None:
        self.results = results

    def __hash__(self) -> int:
        return id(self.results)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Itself) and other.results is self.results


def _read(results: Results, rows_of: RowsOf, role: str, both: bool) -> tuple[Row, ...]:
    """Return the rows by the study's reading, then those that the other one makes different, if wanted."""
    return _rows(_Itself(results), rows_of, role, both)


@lru_cache(maxsize=64)
def _rows(of: _Itself, rows_of: RowsOf, role: str, both: bool) -> tuple[Row, ...]:
    """Return the same once made: tables, figures and sentences of one report all ask for them."""
    return tuple(_made(of.results, rows_of, role, both))


def _made(results: Results, rows_of: RowsOf, role: str, both: bool) -> Iterator[Row]:
    groups = regrouped(results, role) if both else set()
    for one in (results, *([reread(results)] if groups else [])):
        for row in rows_of(one):
            medium, layers = (row.get(f"validate_{key}", row.get(key)) for key in ("medium", "layers"))
            if one is results or (medium, layers) in groups:
                ratios = {name: over_floor(row, f"{name.removesuffix('_over_floor')}_mm") for name in _RATIOS}
                ratios |= {n: over_floor(row, f"{n.removesuffix('_over_floor')}_mm") for n in _POOLED_RATIOS}
                yield {
                    **row,
                    **ratios,
                    "layer_count_rule": one.record.layer_count_rule,
                    "alternate_count": one is not results,
                }


def _validation_rows(results: Results) -> list[Row]:
    macro, pooled = _aggregated(results, _BY, "validate")
    rows = []
    for ours in _pick(macro, "fitted", "measured"):
        same = {"medium": ours["medium"], "layers": ours["layers"]}
        rows.append(
            dict(zip(_KEYS, (study_label(results), ours["medium"], ours["layers"]), strict=True))
            | {name: ours[name] for name in (*METRICS, *_COUNTS, *FLOOR_COLUMNS)}
            | _prefixed("planned", _pick(macro, "fitted", "planned", **same), METRICS)
            | _prefixed("pooled", _pick(pooled, "fitted", "measured", **same), METRICS)
            | _rivals(macro, same)
            | _paper_row(results, ours)
            | {"comparison": _comparison(results), "origin": results.origin}
        )
    return rows


def _validation_columns() -> list[str]:
    columns = [*_KEYS, *METRICS, *_COUNTS, *FLOOR_COLUMNS, *_RATIOS]
    columns += [f"{way}_{m}" for way in ("planned", "pooled") for m in METRICS] + _POOLED_RATIOS
    columns += [f"{method}_{m}" for method in METHODS[1:] for m in _compared(method)]
    columns += [*(f"paper_{m}" for m in METRICS), "paper_insertions"]
    return [*columns, *_ABOUT]


def _rivals(macro: list[Row], same: Row) -> Row:
    found: Row = {}
    for method in METHODS[1:]:
        found |= _prefixed(method, _pick(macro, method, "measured", **same), _compared(method))
    return found


def _compared(method: str) -> tuple[str, ...]:
    """Return the metrics given of a method: all of the model's other fit, which has a row of its own."""
    return METRICS if method == "fitted_metric" else ("ipe_mean_mm", "te_mm")


def _paper_row(results: Results, ours: Row) -> Row:
    match = {"study": study_label(results), "validate_medium": ours["medium"]}
    match["validate_layers"] = ours["layers"]
    printed = _matching("validation", match)
    count = _matching("study_design", match)
    paper_count = count[0]["validate_insertions"] if count else None
    return (
        _prefixed("paper", printed, METRICS)
        | {"paper_insertions": paper_count}
        | {"comparable": comparable_validation(results, ours["insertions"], paper_count)}
    )


def _tuning_rows(results: Results) -> list[Row]:
    rows = []
    for by, keys in (("layers", ("medium", "layers")), ("media", ("medium",))):
        macro, pooled = _aggregated(results, ("role", "method", "boundaries", *keys), "tune")
        for ours in _pick(macro, "fitted", "measured"):
            match = {key: ours[key] for key in keys}
            listed = [r["insertions"] for r in _matching("insertions", match)]
            printed = _matching("tuning_by_layers" if by == "layers" else "tuning_by_media", match)
            count = sum(listed) if printed else None
            rows.append(
                {"study": study_label(results), "grouping": by, "medium": ours["medium"]}
                | {"layers": ours.get("layers")}
                | {name: ours[name] for name in (*METRICS, *_COUNTS, *FLOOR_COLUMNS)}
                | _prefixed("pooled", _pick(pooled, "fitted", "measured", **match), METRICS)
                | _prefixed("paper", printed, METRICS)
                | {"paper_insertions": count, "comparison": _comparison(results), "origin": results.origin}
                | {"comparable": comparable_tuning(results, ours["insertions"], count)}
            )
    return rows


def _aggregated(results: Results, by: tuple[str, ...], role: str) -> tuple[list[Row], list[Row]]:
    """Return the rows of a role: means over insertions of every method, all points pooled of the fit."""
    here = replace(results, errors=results.errors[results.errors["role"] == role])
    fitted = replace(
        here,
        errors=here.errors[here.errors["method"] == "fitted"],
        shapes=results.shapes[(results.shapes["role"] == role) & (results.shapes["method"] == "fitted")],
    )
    return records(aggregate(here, by)), records(aggregate(fitted, by, "pooled"))


def _matching(name: paper.TableName, match: Row) -> list[Row]:
    return [
        r
        for r in records(paper.read_published_table(name))
        if all(r[key] == value for key, value in match.items())
    ]


def _pick(rows: list[Row], method: str, boundaries: str, **match: Any) -> list[Row]:  # noqa: ANN401
    wanted = {"method": method, "boundaries": boundaries, **match}
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def _prefixed(prefix: str, rows: list[Row], names: tuple[str, ...]) -> Row:
    return {f"{prefix}_{name}": rows[0][name] if rows else None for name in names}


def _comparison(results: Results) -> str:
    return str(results.errors["comparison"].iloc[0])


def _frame(rows: list[Row], columns: list[str]) -> pd.DataFrame:
    """Return the rows as a frame in which counts stay whole numbers where some are missing."""
    frame = pd.DataFrame(rows, columns=columns)
    counts = [name for name in ("layers", "paper_insertions") if name in columns]
    return frame.astype(dict.fromkeys(counts, "Int64"))


def _plain(value: object) -> object:
    """Return a value that JSON knows: NaN and infinity become None, numpy scalars Python's."""
    value = value.item() if hasattr(value, "item") else value
    if value is pd.NA or value is pd.NaT or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return value
