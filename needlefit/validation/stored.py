"""Results as one file, exact to the last digit, from which tables and reports are made again.

The CSVs of a run are rounded and laid out for readers; this is what they were made of. Draws of a posterior
stay in their own netCDF files beside it.
"""

import gzip
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needlefit.errors import DataError
from needlefit.inference.sampling.posterior import Posterior, load
from needlefit.project.plain import plain
from needlefit.project.records.fit import FitRecord
from needlefit.project.records.study import StudyRecord
from needlefit.validation.placed import Band, PlacedNeedle
from needlefit.validation.results import COLUMNS, Results

NAME = "results.json.gz"
FORMAT = 2
"""Of the file; another number is refused."""

_PLAIN = ("name", "title", "question", "origin", "dataset_title", "interrupted", "run")


def posterior_names(count: int) -> tuple[str, ...]:
    """Return the files that hold the posteriors of a run, in the order of its folds."""
    return ("posterior.nc",) if count == 1 else tuple(f"posterior_{k + 1}.nc" for k in range(count))


def store(results: Results, folder: Path) -> Path:
    """Write all of `results` but its posteriors and times to `folder`; equal results give equal bytes."""
    table = {
        "format": FORMAT,
        "kind": "study" if isinstance(results.record, StudyRecord) else "fit",
        "record": results.record.model_dump(mode="json", by_alias=True),
        **{key: plain(getattr(results, key)) for key in _PLAIN},
        "frames": {key: _packed(getattr(results, key)) for key in COLUMNS},
        "needles": [asdict(needle) for needle in results.needles.values()],
        "posteriors": list(results.posteriors),
    }
    path = folder / NAME
    text = json.dumps(table, ensure_ascii=False, default=_listed)
    path.write_bytes(gzip.compress(text.encode("utf-8"), 6, mtime=0))
    return path


def restore(folder: Path) -> Results:
    """Return the results that a run left in `folder`.

    Raises
    ------
    DataError
        If it holds none, or what it holds is damaged or of another version.
    """
    path = folder / NAME
    if not path.is_file():
        raise DataError(
            "holds no stored results",
            where=str(folder),
            expected=f"{NAME}, which `needlefit tune` and `needlefit validate` write",
            mend="name such a run; what an earlier version wrote must be run again",
        )
    try:
        table = json.loads(gzip.decompress(path.read_bytes()))
        if table["format"] != FORMAT:
            raise DataError(
                f"is of format {table['format']}", where=str(path), expected=f"{FORMAT}", mend="run it again"
            )
        return _restored(table, folder)
    except (OSError, EOFError, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"cannot be read: {error!r}", where=str(path), mend="run it again, or take the file from a copy"
        ) from None


def _restored(table: Mapping[str, Any], folder: Path) -> Results:
    timing = folder / "timing.json"
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    frames: dict[str, Any] = {key: _unpacked(table["frames"][key]) for key in COLUMNS}
    kind = StudyRecord if table["kind"] == "study" else FitRecord
    return Results(
        record=kind.model_validate(table["record"]),
        timing=json.loads(timing.read_text(encoding="utf-8")) if timing.is_file() else {},
        posteriors=_posteriors(table["posteriors"], folder),
        needles={row["insertion"]: _needle(row) for row in table["needles"]},
        **about,
        **frames,
    )


def _posteriors(folds: list[str], folder: Path) -> dict[str, Posterior]:
    files = posterior_names(len(folds))
    return {fold: load(folder / file) for fold, file in zip(folds, files, strict=True)}


def _packed(frame: pd.DataFrame) -> dict[str, Any]:
    columns = {str(name): frame[name].tolist() for name in frame}
    return {"types": {name: str(frame[name].dtype) for name in columns}, "columns": columns}


def _unpacked(table: Mapping[str, Any]) -> pd.DataFrame:
    columns = table["columns"]
    return pd.DataFrame(
        {name: pd.Series(columns[name], dtype=kind) for name, kind in table["types"].items()},
        columns=list(columns),
    )


def _needle(row: Mapping[str, Any]) -> PlacedNeedle:
    arrays = {key: None if row[key] is None else np.array(row[key]) for key in _ARRAYS}
    band = row["band"]
    if band is not None:
        band = Band(**{**band, **{key: np.array(band[key]) for key in ("low", "middle", "high")}})
    return PlacedNeedle(**{**row, **arrays, "band": band})


_ARRAYS = ("measured", "toward", "fitted")


def _listed(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} cannot be stored")
