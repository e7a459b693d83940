"""Many scans: one that fails costs the others nothing."""

import pytest

from needlefit.imaging import batch
from needlefit.imaging.batch import ReconstructionBatch, reconstruct_all
from needlefit.imaging.scans import read_scans
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
