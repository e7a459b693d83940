"""Store results in one file, exact to the last digit, from which tables and reports can be made again.

The CSVs of a run are rounded and laid out for readers; this is what they were made of. Draws of a posterior
stay in their own netCDF files beside it.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.inference.sampling.posterior import Posterior, load
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.project.run_file import read_timing, require_schema
from needlefit.schemas.result_files import ResultsTable
from needlefit.schemas.study import FitRecord, StudyRecord
from needlefit.validation.needles_in_scan import Band, NeedleInScan
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack, unpack_frame
from needlefit.validation.results import COLUMNS, Results

_PLAIN = ("name", "title", "question", "origin", "dataset_title", "interrupted", "run")


def posterior_file_names(count: int) -> tuple[str, ...]:
    """Return the names of the posterior files of a run, in the order of its folds."""
    return ("posterior.nc",) if count == 1 else tuple(f"posterior_{k + 1}.nc" for k in range(count))


def store_results(results: Results, folder: Path) -> Path:
    """Write `results` without posteriors and times to `folder`; equal results give equal bytes."""
    table = {
        "kind": "study" if isinstance(results.record, StudyRecord) else "fit",
        "record": results.record.model_dump(mode="json", by_alias=True),
        **{key: to_json_values(getattr(results, key)) for key in _PLAIN},
        "frames": {key: pack_frame(getattr(results, key)) for key in COLUMNS},
        "needles": [asdict(needle) for needle in results.needles.values()],
        "posteriors": list(results.posteriors),
    }
    return pack(table, folder)


def restore_results(folder: Path) -> Results:
    """Read the results that a run stored in `folder`.

    Raises
    ------
    DataError
        If it holds none, or what it holds is damaged or of another version.
    """
    table = unpack(folder)
    require_schema(table, ResultsTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        return _restore_results(table, folder)


def _restore_results(table: Mapping[str, Any], folder: Path) -> Results:
    about: dict[str, Any] = {key: table[key] for key in _PLAIN}
    frames: dict[str, Any] = {key: unpack_frame(table["frames"][key]) for key in COLUMNS}
    kind = StudyRecord if table["kind"] == "study" else FitRecord
    return Results(
        record=kind.model_validate(table["record"]),
        timing=read_timing(folder),
        posteriors=_load_posteriors(table["posteriors"], folder),
        needles={row["insertion"]: _restore_needle(row) for row in table["needles"]},
        **about,
        **frames,
    )


def _load_posteriors(folds: list[str], folder: Path) -> dict[str, Posterior]:
    files = posterior_file_names(len(folds))
    return {fold: load(folder / file) for fold, file in zip(folds, files, strict=True)}


def _restore_needle(row: Mapping[str, Any]) -> NeedleInScan:
    arrays = {key: None if row[key] is None else np.array(row[key]) for key in _ARRAYS}
    band = row["band"]
    if band is not None:
        band = Band(**{**band, **{key: np.array(band[key]) for key in ("low", "middle", "high")}})
    return NeedleInScan(**{**row, **arrays, "band": band})


_ARRAYS = ("measured", "toward", "fitted")
