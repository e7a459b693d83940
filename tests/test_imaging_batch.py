"""Many scans: one that fails costs the others nothing, and what is finished is not done again."""

import pickle
import shutil
from dataclasses import replace

import numpy as np
import pytest

from needlefit.imaging import batch
from needlefit.imaging.batch import ReconstructionBatch, ReconstructionFailure, reconstruct_all
from needlefit.imaging.reconstruct import Examination
from needlefit.imaging.scans import read_scans
from needlefit.imaging.volume import Volume
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.encode import encode
from needlefit.project.locate import shipped_folder
from needlefit.project.progress import never_stop
from needlefit.project.tasks import LocalPool
from needlefit.schemas.reconstruction import ReconstructionRecord

RECIPE = ReconstructionRecord(schema=1)


@pytest.fixture(scope="module")
def sample():
    (scan,) = read_scans(shipped_folder() / "data" / "sample_scan" / "scans.csv")
    return scan


@pytest.fixture(scope="module")
def reconstructed(sample):
    """The sample, reconstructed alone."""
    ((one,),) = reconstruct_all([sample], RECIPE, ReconstructionBatch())
    assert not isinstance(one, ReconstructionFailure)
    return one


class Worked:
    """Counts what is reconstructed, in place of the work: it gives the same, of whichever scan."""

    def __init__(self, monkeypatch, one):
        self.done = []
        self.one = one
        volume = Volume(np.zeros((2, 2, 2), np.float32), np.zeros(3), np.ones(3), np.eye(3))
        monkeypatch.setattr(batch, "read_volume", lambda path, series, acquisition: volume)
        monkeypatch.setattr(batch, "examine", self)
        monkeypatch.setattr(batch, "add_views", lambda one, volume: one)

    def __call__(self, volume, scan, *more):
        self.done.append(scan.id)
        return Examination(scan, reconstruction=replace(self.one, scan=scan))


@pytest.fixture
def worked(monkeypatch, reconstructed):
    return Worked(monkeypatch, reconstructed)


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
    arrays = {}, {}
    encoded = [
        encode(made[0][0], batch._HOOKS, into) for made, into in zip((there, here), arrays, strict=True)
    ]
    assert repr(encoded[0]) == repr(encoded[1])  # nan is written alike, and no copy of it equals it
    for name, one in arrays[1].items():
        np.testing.assert_array_equal(arrays[0][name], one)
    (missed,) = there[1]
    assert missed.scan == gone and str(gone.volume) in str(missed.error)


def kept(folder):
    return open_checkpoint(folder, True, {"reconstruct": 1})


def test_finished_scans_are_kept_and_reused(sample, tmp_path, worked):
    other = replace(sample, id="again")
    stopped = []
    first = reconstruct_all(
        [sample, other],
        RECIPE,
        ReconstructionBatch(
            checkpoint=kept(tmp_path),
            stop=lambda: len(stopped) > 0,
            progress=lambda _, done, __: stopped.extend([0] * done),
        ),
    )
    assert [one.scan.id for (one,) in first] == worked.done == ["sample"]
    resumed = reconstruct_all([sample, other], RECIPE, ReconstructionBatch(checkpoint=kept(tmp_path)))
    assert worked.done == ["sample", "again"]
    assert np.array_equal(resumed[0][0].points, first[0][0].points)


@pytest.mark.parametrize("change", ["nothing", "file", "scan", "recipe", "truncated"])
def test_checkpoints_of_other_input_are_recomputed(change, sample, tmp_path, worked):
    volume = tmp_path / "sample.nrrd"
    shutil.copy(sample.volume, volume)
    scan, recipe, folder = replace(sample, volume=volume), RECIPE, tmp_path / "kept"
    reconstruct_all([scan], recipe, ReconstructionBatch(checkpoint=kept(folder)))
    if change == "file":
        with volume.open("ab") as file:
            file.write(b" ")
    if change == "scan":
        scan = replace(scan, side=-1)
    if change == "recipe":
        recipe = ReconstructionRecord.model_validate({"schema": 1, "layers": {"surface_sd_mm": 0.3}})
    if change == "truncated":
        (file,) = folder.glob("*.jsonl")
        file.write_bytes(file.read_bytes()[:1000])
    reconstruct_all([scan], recipe, ReconstructionBatch(checkpoint=kept(folder)))
    assert worked.done == ["sample"] * (1 if change == "nothing" else 2)
