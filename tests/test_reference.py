"""The committed evidence is what the program still computes: a study, reduced, run again."""

from pathlib import Path

import pandas as pd
import pytest

from needlefit.project.locate import PAPER_FITS, PAPER_STUDIES, find_file
from needlefit.project.toml import load
from needlefit.schemas.study import SelectionRecord, StudyRecord
from needlefit.studies.kinds.cross_validation.run import Settings, run
from needlefit.studies.report import round_frame
from needlefit.studies.run import read_run

REFERENCE = Path(__file__).parent.parent / "reports/reference"
TOLERANCE = 0.002
"""mm: half a micrometre of rounding on either side, and as much for machines."""

KEY = ["method", "role", "insertion", "boundaries"]
SCORES = ["te_mm", "ipe_mean_mm", "ipe_max_mm", "predicted_deflection_mm", "floor_te_mm"]


def test_every_study_of_the_paper_has_its_evidence():
    folders = {folder.name: folder for folder in REFERENCE.iterdir()}
    assert folders.keys() >= {*PAPER_STUDIES, *PAPER_FITS}
    for name, folder in folders.items():
        assert read_run(folder)["name"] == name
        for file in folder.glob("*.csv"):
            evidence = pd.read_csv(file)
            assert set(evidence["origin"]) == {"synthetic"}
            assert round_frame(evidence).equals(evidence), f"{file} is not rounded"


@pytest.mark.sweep
def test_the_reduced_study_has_the_errors_of_the_evidence():
    """Study 5 by the quick recipe, a few starts instead of many, and three of its held-out insertions."""
    held = SelectionRecord(insertions=("chicken-04", "chicken-06", "chicken-12"))
    study = load(find_file("study", "study5"), StudyRecord)
    study = study.model_copy(update={"recipe": "quick", "validate_": (held,)})
    rerun = run("study5", study, Settings(jobs=2))
    committed = pd.read_csv(REFERENCE / "study5/errors.csv").set_index(KEY)[SCORES]
    again = rerun.frames["errors"].query("method != 'fitted_metric'").set_index(KEY)[SCORES]
    assert set(again.index.get_level_values("method")) >= {"fitted", "hand_tuned", "straight"}
    gap = (again - committed.loc[again.index]).abs().max()
    assert (gap <= TOLERANCE).all(), gap
