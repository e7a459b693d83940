"""Where the tissue begins: by its own surface, unless the scan itself shows another place."""

import re
from pathlib import Path

import ct_cases as cases
import numpy as np
import pytest
from layer_cases import save_mesh
from reconstruction_cases import small_scan
from refusals import refusal

from needlefit.errors import DataError
from needlefit.geometry.surfaces import make_cylinder, make_sheet
from needlefit.imaging.reconstruct import examine, reconstruct
from needlefit.imaging.scans import LayerSource, Scan
from needlefit.imaging.volume_files import write_volume

FACE = cases.ENTRY[2]
"""Where the scan's tissue begins, along S, mm."""


def scan(folder, mesh):
    write_volume(small_scan(), folder / "small.nrrd")
    own = LayerSource(save_mesh(folder / "own.stl", mesh), into=1)
    return Scan("small", folder / "small.nrrd", "box", surfaces=(own,), surfaces_in="scan")


def face(at):
    return make_sheet("own", (11.0, 11.0, at), (0, 0, 1), 20.0, into=1).mesh


@pytest.mark.sweep
def test_the_tissue_s_own_surface_sets_the_entry(tmp_path):
    one = reconstruct(scan(tmp_path, face(FACE + 2.0)), cases.RECIPE)
    assert one.points[0, 2] == pytest.approx(FACE + 2.0, abs=0.05)
    assert any("own surface" in warning for warning in one.warnings)


@pytest.mark.sweep
def test_a_surface_far_from_where_tissue_is_seen_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"own surface .*\b8\.[01] mm") as error:
        reconstruct(scan(tmp_path, face(FACE + 8.0)), cases.RECIPE)
    assert "state the stage" in error.value.fix


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("before_tip", "words"), [(-2.0, r"\b(1\.9|2\.\d) mm beyond"), (0.8, r"0\.\d+ mm before"), (4.0, "")]
)
def test_a_contact_lies_before_the_tip(before_tip, words):
    """The page examines a scan as the command does: one rule for both."""
    placed = np.array([11.0, 11.0, 40.0 - before_tip])
    volume = cases.scan(cases.axis())
    found = examine(volume, Scan("one", Path("one.nrrd"), "box", contact=placed), cases.RECIPE)
    if words:
        assert found.error is not None and re.search(words, found.error.what)
    else:
        assert found.reconstruction is not None
        assert found.reconstruction.depth == pytest.approx(before_tip, abs=0.15)


@pytest.mark.sweep
def test_a_surface_drawn_along_the_needle_is_refused(tmp_path):
    """A tube of 1.8 mm radius about it, of which only the ends are crossed."""
    around = make_cylinder("own", (np.array([11.0, 11, FACE]), np.array([11.0, 12, FACE + 24])), 1.8, into=1)
    refusal(DataError, "around the needle", lambda: reconstruct(scan(tmp_path, around.mesh), cases.RECIPE))
