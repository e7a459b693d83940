"""Many scans: one that fails costs the others nothing, and finished ones are kept."""

from dataclasses import replace

import numpy as np
import pytest

from needlefit.errors import DataError
from needlefit.imaging import batch
from needlefit.imaging.batch import ReconstructionBatch, ReconstructionFailure, reconstruct_all
from needlefit.imaging.reconstruction import CurvePicture, ScanView
from needlefit.imaging.scans import read_scans
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.locate import shipped_folder
from needlefit.schemas.reconstruction import ReconstructionRecord

RECIPE = ReconstructionRecord(schema=1)


@pytest.fixture(scope="module")
def sample():
    (scan,) = read_scans(shipped_folder() / "data" / "sample_scan" / "scans.csv")
    return scan


def test_an_error_of_the_program_is_no_error_of_the_scan(sample, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(batch, "examine", broken)
    with pytest.raises(ZeroDivisionError):
        reconstruct_all([sample], RECIPE, ReconstructionBatch())


def test_a_resumed_batch_makes_unfinished_scans_only_and_its_results_are_the_same(
    sample, monkeypatch, tmp_path
):
    made = []

    def refuse(scan, **_):
        made.append(scan.id)
        views = (ScanView(("x", "y"), np.array([[np.nan, 1 / 3]]), (0.0, 1.0, -1.0, 2.5)),)
        picture = CurvePicture(views, np.arange(6).reshape(2, 3) / 7, np.empty(0))
        error = DataError("cut", where=scan.volume, fix="copy it")
        return (ReconstructionFailure(scan, error, picture=picture, asked=True),)

    monkeypatch.setattr(batch, "reconstruct_needles", refuse)
    scans = [replace(sample, id=name) for name in "abc"]
    checkpoint = open_checkpoint(tmp_path / "out.partial", False, {"scans": 3})
    stopped = ReconstructionBatch(stop=lambda: len(made) == 2, checkpoint=checkpoint)
    assert len(reconstruct_all(scans, RECIPE, stopped)) == 2
    resumed = reconstruct_all(scans, RECIPE, ReconstructionBatch(checkpoint=checkpoint))
    assert made == ["a", "b", "c"]
    for results, at_once in zip(resumed, reconstruct_all(scans, RECIPE, ReconstructionBatch()), strict=True):
        ((failure,), (other,)) = results, at_once
        assert failure.scan.files == other.scan.files and failure.asked
        assert str(failure.error) == str(other.error) and type(failure.error) is DataError
        (view,), (same,) = failure.picture.views, other.picture.views
        assert view.extent == same.extent and view.values.tobytes() == same.values.tobytes()
        assert failure.picture.entries.shape == (0,)
