"""Many scans: one that fails costs the others nothing, and finished ones are kept."""

import json
from dataclasses import replace

import pytest

from needlefit.imaging import batch
from needlefit.imaging.batch import ReconstructionFailure, reconstruct_all
from needlefit.imaging.entry import UncertainEntryError
from needlefit.imaging.reconstruction import Reconstruction
from needlefit.imaging.scans import read_scans
from needlefit.project.checkpoint import open_checkpoint
from needlefit.project.locate import shipped_folder
from needlefit.project.stored_values import encode
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
        reconstruct_all([sample], RECIPE)


def test_a_batch_makes_scans_again_that_are_not_kept_and_its_results_are_the_same(
    sample, monkeypatch, tmp_path
):
    ((whole,),) = reconstruct_all([sample], RECIPE)
    made = []

    def reconstruct(scan, **_):
        made.append(scan.id)
        if scan.id != "b" or scan.answers:
            return (replace(whole, scan=scan),)
        return (ReconstructionFailure(scan, UncertainEntryError("cut", where=scan.volume, fix="copy it")),)

    monkeypatch.setattr(batch, "reconstruct_needles", reconstruct)
    scans = [replace(sample, id=name) for name in "abc"]
    checkpoint = open_checkpoint(tmp_path / "out.partial", False, {"scans": 3})

    def run(scans=scans, stop=lambda: False):
        options = {"checkpoint": checkpoint, "name_work": lambda scan: f"{scan.id} {scan.answers}"}
        return [result for (result,) in reconstruct_all(scans, RECIPE, stop=stop, **options)]

    assert len(run(stop=lambda: len(made) == 2)) == 2
    first, failure, last = run()
    assert made == ["a", "b", "b", "c"]
    assert failure.error.fix == "copy it" and type(failure.error) is UncertainEntryError
    for result in (first, last):  # to the last bit
        assert json.dumps(encode(result)) == json.dumps(encode(replace(whole, scan=result.scan)))
    answered = run([replace(scan, answers={"b": 1} if scan.id == "b" else {}) for scan in scans])
    assert made == ["a", "b", "b", "c", "b"] and isinstance(answered[1], Reconstruction)
