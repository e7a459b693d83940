"""What a refused scan leaves: candidates, a page, tables."""

from dataclasses import replace
from pathlib import Path

import ct_cases
import numpy as np
import pandas as pd
import pytest
import reconstruction_cases as cases

from needlefit.errors import DataError
from needlefit.imaging.assembly import DatasetDescription
from needlefit.imaging.batch import ReconstructionFailure, collect_findings
from needlefit.imaging.reconstruct import Examination, examine
from needlefit.imaging.reconstruction import MarkerResult, RejectedMarker
from needlefit.imaging.scans import Scan
from needlefit.imaging.volume import Volume
from needlefit.project.progress import no_progress
from needlefit.studies.kinds.reconstruction.pages import list_finding_facts
from needlefit.studies.kinds.reconstruction.report import write_reconstruction, write_refused

SCAN = Scan("one", Path("scans/one.nrrd"), "gel", origin="synthetic")
ERROR = DataError("no markers", where="here", expected="some", fix="add them")


def findings(volume):
    return collect_findings(volume, examine(volume, SCAN, ct_cases.RECIPE), ct_cases.RECIPE)


@pytest.fixture(scope="module")
def found():
    return findings(cases.small_scan())


def test_a_scan_that_is_refused_shows_what_is_in_it(found):
    (tube,) = found.tubes
    assert tube.chosen
    assert abs(tube.length - 40) < 2
    assert np.linalg.norm(found.needle[-1] - [11, 14, 40]) < 0.3
    assert [one.change for one in found.entries] == ["rise", "step"]  # the face, and the layer 14 mm behind
    assert abs(found.entries[0].depth - 28.3) < 0.5
    assert len(list_finding_facts(found)) == 4


def test_steps_that_fail_leave_the_others():
    plain = cases.small_scan()
    values = np.where(plain.values > 300, 40, plain.values).astype(np.float32)
    nothing = findings(replace(plain, values=values))
    assert nothing.tubes == ()
    assert nothing.needle is None and nothing.profile is None
    assert nothing.projections[0].shape == plain.values.shape[1:]


def test_balls_are_those_that_the_examination_found():
    others = tuple(RejectedMarker(np.full(3, x), x, 0.5, 0.2, "misfit") for x in (9.0, 4.0))
    markers = MarkerResult(np.zeros((2, 3)), np.full(2, 0.1), "volume", rejected=others)
    found = collect_findings(cases.small_scan(), Examination(SCAN, markers=markers), ct_cases.RECIPE)
    size = ct_cases.RECIPE.markers.diameter_mm
    assert [(one.diameter, one.marker) for one in found.balls] == [(size, True)] * 2 + [
        (4, False),
        (9, False),
    ]


@pytest.mark.parametrize("readable", [True, False])
def test_the_page_is_one_and_the_tables_hold_the_candidates(found, tmp_path, readable):
    failure = ReconstructionFailure(SCAN, ERROR, found if readable else None)
    for name in ("first", "second"):
        write_refused([failure], ct_cases.RECIPE, tmp_path / name)
    pages = [(tmp_path / name / "quality" / "one.pdf").read_bytes() for name in ("first", "second")]
    assert pages[0] == pages[1]
    assert pages[0].count(b"/Type /Page\n") or pages[0].count(b"/Type/Page/") == 1
    refused = pd.read_csv(tmp_path / "first" / "refused.csv").iloc[0]
    assert all(text in refused["note"] for text in (ERROR.what, ERROR.expected, ERROR.fix))
    candidates = pd.read_csv(tmp_path / "first" / "candidates.csv")
    kinds = candidates["kind"].value_counts().to_dict()
    assert kinds == ({"tube": 2, "entry": 2} if readable else {})


def test_one_voxel_thick_projections_need_no_needle():
    """A volume without anything in it still has its page."""
    empty = Volume(np.full((5, 6, 7), -1000, np.float32), np.zeros(3), np.ones(3), np.eye(3))
    nothing = findings(empty)
    assert (nothing.tubes, len(nothing.balls), nothing.entries) == ((), 0, ())


@pytest.mark.sweep
def test_a_dataset_holds_the_pages_of_its_refused_scans_too(found, tmp_path):
    one = cases.small()
    about = DatasetDescription("data")
    failure = ReconstructionFailure(SCAN, ERROR, found)
    out = tmp_path / "data"
    written, faulty = write_reconstruction(out, [one], ct_cases.RECIPE, about, no_progress, [failure])
    assert written is not None and faulty == ()
    assert {path.name for path in (out / "quality").iterdir()} == {"one.pdf", f"{one.scan.id}.pdf"}
    assert pd.read_csv(out / "refused.csv")["id"].tolist() == ["one"]
    assert set(pd.read_csv(out / "candidates.csv")["kind"]) == {"tube", "entry"}
    assert (out / "refused.csv").read_text() != "" and "no markers" in (out / "report.html").read_text()
