"""Made-up runs, and made-up evidence for them, as the commands leave it."""

import copy
from dataclasses import replace
from pathlib import Path

import pandas as pd
from reporting_results import study, with_predictions

from needlefit.project.folders import write_manifest
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.studies.run import Run
from needlefit.studies.store import RESULTS_FILE, store_run

VERSIONS = {"needlefit": "0.1.0", "numpy": "2.0", "python": "3.11"}
WORK = {
    "versions": {**VERSIONS, "emcee": "3.1"},
    "dataset": {
        "name": "twin",
        "origin": "synthetic",
        "sha256": "ab" * 32,
        "needle": {"length": 150.0, "flexural_rigidity": 10215.0},
        "notes": ["Needle: nominal."],
    },
    "medium": {"title": "Gel", "thickness_mm": 40.0, "parameters": {"mu1_pa": {"bounds": [1e3, 1e9]}}},
    "recipe": {"title": "Default", "seed": 1, "starts": 16},
    "rules": {"tie": "nearest", "element_mm": 1.0},
    "folds": [{"name": "all", "tune": ["a", "b"], "validate": ["c"]}],
}
RULES = {"element": 1.0, "spacing": 1.0, "tolerance": 1e-7}
GROUPS = ("Closed forms", "Manufactured solutions", "Discretisation error", "Newton’s tangent")


def results(number: int = 1, **changed: object) -> Run:
    """A study with predictions, that says what it was computed with."""
    made = with_predictions(study(number))
    return replace(made, interrupted=False, run={**copy.deepcopy(WORK), "name": made.name, **changed})


def leave(made: Run, folder: Path) -> Path:
    """Leave what a bundle reads of a run."""
    target = folder / made.name
    target.mkdir(parents=True)
    assert store_run(made, target).name == RESULTS_FILE
    write_json(target / "run.json", made.run_json)
    write_manifest(target)
    return target


def _leave(folder: Path, run: dict, name: str, table: pd.DataFrame) -> Path:
    folder.mkdir(parents=True)
    write_json(folder / "run.json", run)
    write_csv(table, folder / name)
    return folder


def leave_verification(folder: Path, measured: float = 4e-8, **changed: object) -> Path:
    """One row per group, the first of which measures so much at a bound of 1e-7."""
    rows = [
        {"group": group, "check": f"Case {k}", "quantity": "error of the tip", "measured": 1e-9}
        | {"bound_low": None, "bound_high": 1e-7, "unit": "mm", "verdict": "passes"}
        for k, group in enumerate(GROUPS)
    ]
    rows[0] |= {"measured": measured, "verdict": "passes" if measured <= 1e-7 else "FAILS"}
    run = {"name": "verification", "versions": VERSIONS, "rules": RULES, "failed": 0, **changed}
    run["study"] = {"kind": "verification", "seed": 1}
    return _leave(folder / "verification", run, "verification.csv", pd.DataFrame(rows))


def leave_calibration(folder: Path, of: str = "study1", **changed: object) -> Path:
    """500 truths of two quantities; 472 and 481 in the 95 % interval."""
    rows = [
        {
            "quantity": name,
            "level": level,
            "replicates": 500,
            "covered": covered,
            "count_low": least,
            "count_high": most,
        }
        for name, wide in (("mu1_pa", 472), ("tip_mm", 481))
        for level, covered, least, most in ((0.5, 250, 210, 290), (0.95, wide, 460, 490))
    ]
    run = {**copy.deepcopy(WORK), "name": of, "control": None, "sampled": False, "replicates": 500}
    run |= {"not_calibrated": [], "passes": True, "study": {"kind": "calibration"}, **changed}
    return _leave(folder / f"calibrate-{of}", run, "coverage.csv", pd.DataFrame(rows))


def leave_sensitivity(folder: Path, of: str = "study1", **changed: object) -> Path:
    """The tie varied in two ways: mean IPE changes by 0.030 mm, or 0.3 floors, at most."""
    rows = [
        {"aspect": what, "variation": name, "tuned": "again", "grouping": "validation", "study": of}
        | {"medium": "phantom2", "layers": 3, "metric": metric, "value": 0.2, "baseline_value": 0.2}
        | {"change": change, "change_in_floors": 10 * change}
        for what, name, change in (
            ("as decided", "as decided", 0.0),
            ("tie", "ahead", -0.03),
            ("tie", "x", 0.01),
        )
        for metric in ("ipe_mean_mm", "te_mm")
    ]
    part = {key: WORK[key] for key in ("medium", "recipe", "rules", "folds")}
    run = {"name": "sensitivity", "versions": VERSIONS, "datasets": {"twin": WORK["dataset"]}, "faults": []}
    run |= {"study": {"kind": "sensitivity", "studies": [of], "fits": []}, "parts": [part], **changed}
    left = _leave(folder / "sensitivity", copy.deepcopy(run), "cells.csv", pd.DataFrame(rows))
    studies = [
        {"aspect": "tie", "variation": name, "tuned": "again", "study": of, "limit_mm": 0.74}
        | {"conclusion_changes": name == "ahead"}
        for name in ("ahead", "x")
    ]
    write_csv(pd.DataFrame(studies), left / "studies.csv")
    return left
