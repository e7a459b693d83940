"""Convert stored results of earlier versions (formats up to 4), kind by kind, to the form of today.

Each conversion takes the stored table with the names of today (`needlefit/studies/renamed.py`), and the
folder that it was read from. Tables that summarize others are computed again from them.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from needlefit.inference.sampling.posterior import load
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.json_values import to_json_values
from needlefit.schemas.base import FileRecord
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.calibration.run import find_calibration_faults, judge_ranks, tabulate_ranks
from needlefit.studies.kinds.cross_validation.run import find_faults
from needlefit.studies.kinds.identification.run import stack_stages
from needlefit.studies.kinds.left_out.run import SUMMARY
from needlefit.studies.kinds.sensitivity.run import tabulate_study_changes
from needlefit.studies.kinds.tracks.results import add_summaries
from needlefit.studies.needles_in_scan import Band, NeedleInScan, tabulate_needles
from needlefit.studies.packing import pack_frame, unpack_frame
from needlefit.studies.run import posterior_file_names

Table = dict[str, Any]
Frames = dict[str, pd.DataFrame]
Convert = Callable[[Table, Frames, Path], Table]
"""Stored table, its frames, and folder -> what of the table is different today."""


def convert_results(table: Table, folder: Path) -> Table:
    """Return stored results of an earlier version, with the names of today, in the form of today."""
    with convert_stored_errors(folder):
        frames = {name: unpack_frame(frame) for name, frame in table.get("frames", {}).items()}
        changed = _CONVERSIONS.get(table["kind"], _keep)(table, frames, folder)
    made = {"faults": [], "interrupted": False, "posteriors": [], "frames": frames, **table, **changed}
    state = {"interrupted": made["interrupted"], "faults": made["faults"]}
    return {
        **{key: made[key] for key in _KEYS},
        "run": made["run"] | state,
        "frames": {name: pack_frame(frame) for name, frame in changed.get("frames", frames).items()},
    }


_KEYS = (
    *("posteriors", "record", "kind", "name", "origin", "dataset_title"),
    *("interrupted", "faults"),
)


def posterior_files(folder: Path, names: list[str]) -> list[Path]:
    """Return where an earlier version stored the posteriors of a run: tip tracks had files named by fit."""
    by_name = [folder / f"posterior-{name}.nc" for name in names]
    if all(is_file(path) for path in by_name):
        return by_name
    return [folder / name for name in posterior_file_names(len(names))]


def _keep(table: Table, frames: Frames, folder: Path) -> Table:
    return {}


def _convert_fit(table: Table, frames: Frames, folder: Path) -> Table:
    needles = tabulate_needles(_read_needle(row) for row in table["needles"])
    return {
        "kind": "fit" if table["kind"] == "fit" else "cross_validation",
        "frames": {**frames, "needles": needles},
        **complete_fit(table["run"], frames["errors"]),
    }


def complete_fit(run: Table, errors: pd.DataFrame) -> Table:
    """Return `faults` and `run` of a study or fit with what earlier versions did not state in `run.json`."""
    unconverged = run.get("not_converged")
    faults = list(find_faults(errors, run.get("search_faults", {}), unconverged or {}))
    return {"faults": faults, "run": run | {"faults": faults, "sampled": unconverged is not None}}


def _read_needle(row: Mapping[str, Any]) -> NeedleInScan:
    arrays = {
        key: None if row[key] is None else np.array(row[key]) for key in ("measured", "toward", "fitted")
    }
    band = row["band"]
    if band is not None:
        band = Band(**{**band, **{key: np.array(band[key]) for key in ("low", "middle", "high")}})
    return NeedleInScan(**{**row, **arrays, "band": band})


def _convert_tracks(table: Table, frames: Frames, folder: Path) -> Table:
    names = table["posteriors"]
    files = zip(names, posterior_files(folder, names), strict=True)
    faults = [f"{fit}: {why}" for fit, file in files for why in load(file).faults]
    run = table["run"]
    dataset = run["dataset"] | {"notes": table["notes"], "remarks": table["remarks"]}
    return {
        "frames": add_summaries(frames),
        "run": run | {"dataset": dataset, "not_converged": faults},
        "faults": faults,
    }


def _convert_calibration(table: Table, frames: Frames, folder: Path) -> Table:
    design = pd.DataFrame({"insertion": table["insertions"], "depth_mm": table["depths"]})
    made = {"design": design, **tabulate_ranks(frames["replicates"])}
    run = {key: value for key, value in table["run"].items() if key != "sampled"}
    options = {
        "title": f"Calibration: {table['title']}",
        "replicates": len(made["replicates"]),
        **{key: table[key] for key in ("control", "sampled")},
    }
    about = _record_target(table["kind"], run, options)
    outcome = judge_ranks(made, table["control"])
    faults = list(find_calibration_faults(outcome))
    return {
        "name": folder.name,
        "frames": made,
        **about,
        "run": about["run"] | to_json_values(outcome),
        "faults": faults,
    }


def _convert_identification(table: Table, frames: Frames, folder: Path) -> Table:
    stages = table["stages"]
    run = stages["design"]["run"]
    frames = {
        "directions": unpack_frame(table["directions"]).drop(columns="origin"),
        "profiles": unpack_frame(stages["design"]["profiles"]),
    }
    if "fit" in stages:
        run = stages["fit"]["run"] | run
        frames |= {
            "profiles": unpack_frame(stages["fit"]["profiles"]),
            "profiles_design": frames["profiles"],
        }
    frames["identify"] = stack_stages({name: unpack_frame(stage["rows"]) for name, stage in stages.items()})
    target = run["name"].removeprefix("identify-")
    title = f"Identification: {run['study'].get('title') or target}"
    run = run | {"insertions": len(run["folds"][0]["tune"])}
    about = _record_target(table["kind"], run, {"target": target, "title": title, "fit": "fit" in stages})
    return {**about, "name": run["name"], "dataset_title": run["dataset"]["name"], "frames": frames}


def _convert_prediction(table: Table, frames: Frames, folder: Path) -> Table:
    run = {key: value for key, value in table["run"].items() if key not in ("tip", "scene")}
    scene = table["run"]["scene"]
    target = run["name"].removesuffix("-tune")
    scene_name = folder.name.removeprefix(f"predict-{target}-")
    title = scene["title"] or scene_name
    options = {
        **{"title": f"Prediction: {title}", "scene": scene, "scene_name": scene_name},
        "posterior": run["name"] if run["draw_source"] == "posterior" else None,
    }
    frame = unpack_frame(table["table"])
    origin = str(frame["origin"].iloc[0])
    return {
        **_record_target("prediction", run, options),
        **{"kind": "prediction", "name": folder.name, "origin": origin},
        "dataset_title": run["dataset"]["name"],
        "frames": {"forecast": frame.drop(columns="origin").assign(scene=title)},
        "faults": list(run["not_converged"]),
    }


def _record_target(kind: str, run: Table, options: Mapping[str, object]) -> Table:
    """Return the study file that the options of a command stand for, and the `run.json` that holds it."""
    target = str(run["name"]).removesuffix("-tune")
    record: FileRecord = find_kind(kind).make_record(**{"target": target, **options})
    stored = record.model_dump(mode="json", by_alias=True)
    return {"record": stored, "run": run | {"fit": run["study"], "study": stored}}


def _convert_left_out(table: Table, frames: Frames, folder: Path) -> Table:
    """Give the summary one row per metric: it had a column per metric and number."""
    earlier, parts = frames["summary"], []
    for metric, stem in (("ipe_mean_mm", "ipe"), ("te_mm", "te")):
        columns = {
            "value": metric,
            **{key: f"{key}_{metric}" for key in ("in_sample", "planned", "floor")},
            "baseline_value": f"curve_{metric}",
            **{"difference": f"{stem}_gap_mm", "difference_se": f"{stem}_gap_se_mm"},
        }
        numbers = {new: earlier[old] for new, old in columns.items()}
        parts.append(earlier.assign(metric=metric, **numbers)[list(SUMMARY)])
    return {
        "frames": {**frames, "summary": pd.concat(parts).sort_index(kind="stable").reset_index(drop=True)}
    }


def _convert_sensitivity(table: Table, frames: Frames, folder: Path) -> Table:
    return {"frames": {**frames, "studies": tabulate_study_changes(frames["errors"])}}


_CONVERSIONS: Mapping[str, Convert] = MappingProxyType(
    {
        "calibration": _convert_calibration,
        "fit": _convert_fit,
        "forecast": _convert_prediction,
        "identification": _convert_identification,
        "left_out": _convert_left_out,
        "sensitivity": _convert_sensitivity,
        "study": _convert_fit,
        "tracks": _convert_tracks,
    }
)
"""By the kind that an earlier version stored; results of other kinds have the frames of today."""
