"""Many scans: one that fails costs the others nothing."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from needlefit.imaging import batch
from needlefit.imaging.batch import ReconstructionBatch, reconstruct_all
from needlefit.imaging.scans import read_scans
from needlefit.project.locate import shipped_folder
from needlefit.project.progress import never_stop
from needlefit.project.tasks import LocalPool
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


class RemotePool(LocalPool):
    """Work and items go through pickle, as to another machine."""

    def run(self, work, items, stop=never_stop):
        for n in range(len(items)):
            function, item = pickle.loads(pickle.dumps((work, items[n])))
            yield n, pickle.loads(pickle.dumps(function(item)))


@pytest.mark.sweep
def test_another_machine_gets_the_files_and_gives_the_same_reconstruction(sample, tmp_path):
    gone = replace(sample, id="gone", volume=tmp_path / "x.nrrd")
    here = reconstruct_all([sample, gone], RECIPE, ReconstructionBatch())
    there = reconstruct_all([sample, gone], RECIPE, ReconstructionBatch(RemotePool(remote=True)))
    for name in ("points", "sd", "depth", "depth_sd", "target_error"):
        np.testing.assert_array_equal(getattr(there[0][0], name), getattr(here[0][0], name))
    assert there[0][0].scan == here[0][0].scan
    (missed,) = there[1]
    assert missed.scan == gone and str(gone.volume) in str(missed.error)
