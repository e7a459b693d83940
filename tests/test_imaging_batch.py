"""Many scans: one that fails costs the others nothing."""

from dataclasses import replace
from pathlib import Path

import pytest

from needlefit.imaging import batch
from needlefit.imaging.batch import ReconstructionBatch, ReconstructionFailure, reconstruct_all
from needlefit.imaging.scans import read_scans
from needlefit.project.locate import shipped_folder
from needlefit.project.tasks import LocalPool
from needlefit.schemas.reconstruction import ReconstructionRecord

CORPUS = sorted((Path(__file__).parent / "fuzz" / "corpus").iterdir())
RECIPE = ReconstructionRecord(schema=1)


@pytest.fixture(scope="module")
def sample():
    (scan,) = read_scans(shipped_folder() / "data" / "sample_scan" / "scans.csv")
    return scan


@pytest.mark.sweep
def test_a_failed_scan_is_reported_and_the_others_are_reconstructed(sample, tmp_path):
    truncated = tmp_path / "truncated.nrrd"
    truncated.write_bytes(sample.volume.read_bytes()[:50_000])
    scans = [
        replace(sample, id="truncated", volume=truncated),
        sample,
        replace(sample, id="gone", volume=tmp_path / "x"),
    ]
    steps = []
    found = reconstruct_all(scans, RECIPE, ReconstructionBatch(progress=lambda *step: steps.append(step)))
    assert [type(one) is ReconstructionFailure for (one,) in found] == [True, False, True]
    (first,), (second,), _ = found
    assert first.scan.id == "truncated" and str(truncated) in str(first.error)
    assert second.depth == pytest.approx(25.0, abs=0.3)
    assert steps[-1][1:] == (3, 3)


def test_an_error_of_the_program_is_no_error_of_the_scan(sample, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(batch, "examine", broken)
    with pytest.raises(ZeroDivisionError):
        reconstruct_all([sample], RECIPE, ReconstructionBatch())


@pytest.mark.sweep
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_scan_whose_reader_crashes_costs_the_others_nothing(sample, tmp_path, monkeypatch, jobs):
    header = next(path for path in CORPUS if path.name == "crash-labels-1-900.seg.nrrd")
    crashing = tmp_path / "crashing.nrrd"
    crashing.write_bytes(header.read_bytes())
    monkeypatch.setattr("needlefit.project.tasks.can_fork", lambda: False)
    scans = [replace(sample, id="crashing", volume=crashing), sample]
    (first,), (second,) = reconstruct_all(scans, RECIPE, ReconstructionBatch(LocalPool(jobs)))
    assert isinstance(first, ReconstructionFailure) and str(crashing) in str(first.error)
    assert "SIG" in str(first.error)
    assert second.depth == pytest.approx(25.0, abs=0.3)
