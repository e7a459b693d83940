"""Write the tables of a run, made tidy: what a column's name says of its cells becomes a cell.

Equal tables give equal bytes.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Number
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.metrics import list_metrics
from needlefit.project.input_files import to_json_values


def write_csv(frame: pd.DataFrame, path: Path) -> None:
    """Write a table as CSV, tidy, to eight significant digits."""
    tidy = to_tidy(frame)
    # pandas formats number by number, five times as slow
    texts = {
        str(name): ["" if math.isnan(value) else f"{value:.8g}" for value in column.tolist()]
        for name, column in tidy.items()
        if column.dtype == np.float64
    }
    tidy = tidy.assign(**texts)
    tidy.to_csv(path, index=False, float_format="%.8g", lineterminator="\n", encoding="utf-8")


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write values as JSON with sorted keys; NaN and infinity become null."""
    text = json.dumps(to_json_values(value), indent=2, sort_keys=True, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


Row = dict[str, Any]


def to_records(frame: pd.DataFrame) -> list[Row]:
    """Return the rows as JSON values; missing values are None."""
    return [{str(k): _to_plain_value(v) for k, v in row.items()} for row in frame.to_dict("records")]


def select_rows(frame: pd.DataFrame, **place: object) -> pd.DataFrame:
    """Return the rows whose columns of these names have these values."""
    places = np.arange(len(frame))
    for name, value in place.items():  # pandas compares all rows with each, which takes five times as long
        places = places[frame[name].to_numpy()[places] == value]
    rows: pd.DataFrame = frame.iloc[places]
    return rows


def _to_plain_value(value: object) -> object:
    """Return a value that JSON can store: NaN and infinity become None, numpy scalars become Python's."""
    value = value.item() if hasattr(value, "item") else value
    if value is pd.NA or value is pd.NaT or (isinstance(value, float) and not math.isfinite(value)):
        return None
    return value


# ---- tidy tables: computations keep wide rows, such as `tip_50_low_mm`; files say `quantity = tip`,
# `level = 0.5`, `low_mm`

_QUANTITIES = "tip|tip_z|shape|points|end|track|needle|needle_z|band|band_z|measured"
_PREDICTED = "measured_mm|median_mm|predicted_mm|crps_mm|interval_score_mm|pit|error_mm"

_PATTERNS = {
    rf"(?P<quantity>{_QUANTITIES})_(?P<level>50|95)_(?P<name>(low|high)(_error)?_mm)": "{name}",
    rf"(?P<quantity>{_QUANTITIES})_(?P<name>width)_(?P<level>50|95)_mm": "width_mm",
    rf"(?P<quantity>{_QUANTITIES})_in_(?P<level>50|95)": "covered",
    rf"(?P<quantity>{_QUANTITIES})_(?P<name>{_PREDICTED})": "{name}",
    r"(?P<name>low|high)_(?P<level>50|95)(?P<unit>_mm|)": "{name}{unit}",
    r"p(?P<probability>\d+(?:[._]\d)?)": "value",
}
"""Tidy names by pattern of a wide name. Groups are index columns, but for `name` and `unit`."""

_METRIC_VALUES = {"{metric}": "value", "floor_{metric}": "floor"}
_PREDICTION_SCORE = re.compile(r"(tip|shape)_(crps_mm|interval_score_mm|in_50|in_95)")


@dataclass(frozen=True)
class _Place:
    """Where the cells of a wide column go: a column, in the rows of an index."""

    column: str
    index: Mapping[str, object] = field(default_factory=dict)


def to_tidy(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table with one row per quantity, level, probability or metric; one that is tidy as it is.

    Columns whose name holds none of these stand in all of a row's rows. No number changes.
    """
    places = _find_places([str(name) for name in frame])
    if not places:
        return frame
    indices = [place.index for place in places.values()]
    combinations = [  # each once, without those that are part of another one
        index
        for number, index in enumerate(indices)
        if index not in indices[:number] and not any(index.items() < other.items() for other in indices)
    ]
    keys = list(dict.fromkeys(name for combination in combinations for name in combination))
    plain = [str(name) for name in frame if name not in places]
    values = list(dict.fromkeys(place.column for place in places.values()))
    by_detail = sorted(places.items(), key=lambda item: len(item[1].index))
    parts = []
    for index in combinations:  # their rows are numbered as in the wide table
        taken = {place.column: name for name, place in by_detail if place.index.items() <= index.items()}
        columns = {name: frame[name] for name in plain} | {new: frame[old] for new, old in taken.items()}
        parts.append(pd.DataFrame({**columns, **index}, index=frame.index).reset_index(drop=True))
    tidy = pd.concat([part for part in parts if len(part.columns)]).sort_index(kind="stable")
    first = min(position for position, name in enumerate(frame) if name in places)
    shared = [name for name in plain if name not in (*keys, *values)]
    before = [name for name in frame.columns[:first] if name in shared]
    order = [*before, *keys, *values, *(name for name in shared if name not in before)]
    return tidy.reindex(columns=order).reset_index(drop=True).assign(**_unify_types(tidy, values))


def _unify_types(frame: pd.DataFrame, names: list[str]) -> dict[str, "pd.Series"]:
    """Return as numbers the columns in which flags and numbers met."""
    mixed = [name for name in names if frame[name].dtype == object]
    kinds = {name: {type(value) for value in frame[name].dropna()} for name in mixed}
    flags = (bool, np.bool_)
    return {
        name: frame[name].astype(float).reset_index(drop=True)
        for name, types in kinds.items()
        if all(issubclass(kind, (Number, np.bool_)) for kind in types)
        and not all(issubclass(kind, flags) for kind in types)
    }


def _find_places(names: list[str]) -> dict[str, _Place]:
    metrics: dict[str, _Place] = {}
    for metric in list_metrics():
        for pattern, column in _METRIC_VALUES.items():
            metrics[pattern.format(metric=metric.name)] = _Place(column, {"metric": metric.name})
    scores = [name for name in names if _PREDICTION_SCORE.fullmatch(name)]
    if scores and any(name in metrics for name in names):
        places = {name: metrics[name] for name in names if name in metrics}
        return places | {name: _Place("value", {"metric": name}) for name in scores}
    return {name: place for name in names if name not in metrics and (place := _match(name))}


def _match(name: str) -> _Place | None:
    for pattern, target in _PATTERNS.items():
        match = re.fullmatch(pattern, name)
        if match:
            groups = match.groupdict()
            index: dict[str, object] = {
                key: float(text.replace("_", ".")) / 100 if key in ("level", "probability") else text
                for key, text in groups.items()
                if key not in ("name", "unit")
            }
            return _Place(target.format(**groups), index)
    return None
