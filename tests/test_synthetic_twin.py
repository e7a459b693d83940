"""The twin as a whole: the same bytes again, the shipped copy, its truth apart."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pytest import approx
from refusals import refusal
from scanner.twin import expose
from synthetic.design import TRUE_MEDIA, list_designs
from synthetic.insertion import TWIN_SEED, simulate_insertion, stated_frame
from synthetic.scans import WHOLE_BOX_SETUP

import needlefit
from needlefit.errors import ModelError
from needlefit.project.locate import shipped_folder

TWIN = shipped_folder() / "data" / "twin"
PACKAGE = Path(needlefit.__file__).parent


SCANNER = ("psf_mm", "noise_hu", "bloom", "streaks", "cupping_hu")


@pytest.fixture(scope="module")
def truth():
    return tomllib.loads((TWIN / "truth.toml").read_text(encoding="utf-8"))


def test_insertions_are_simulated_to_the_digits_of_the_shipped_truth(truth):
    """Needle, layers, bevel, pose and scanner of every third of the 47."""
    rows = {row["id"]: row for row in truth["insertions"]}
    for planned in list_designs()[::3]:
        twin = simulate_insertion(planned, TWIN_SEED)
        true, scene = twin.true_insertion, expose(twin, WHOLE_BOX_SETUP, TWIN_SEED)
        (needle,) = scene.scene.needles
        scanner = {name: getattr(scene.scanner, name) for name in SCANNER}
        found = {
            "deflection_mm": true.deflection, "axis_deflection_mm": true.shape.tip_lateral,
            "tip_mm": true.centerline[-1], "sequence": true.sequence, "boundaries_mm": true.boundaries,
            "mu_pa": 1e6 * true.tissue.mu, "bevel_plane_deg": np.degrees(twin.deviations.roll),
            "out_of_plane_mm": true.frame.to_local(true.centerline)[-1, 2],
            "pose_shift_mm": twin.deviations.shift, "pose_angle_deg": np.degrees(twin.deviations.tilt),
            "bevel_deg": needle.bevel_deg, "needle_hu": needle.hu, **scanner,
        }  # fmt: skip
        assert stated_frame(planned).rotation[:, 2] == approx([0, 0, planned.side])
        for name, value in found.items():
            assert_allclose(value, rows[planned.id][name], rtol=1e-5, err_msg=name)


def test_the_package_reads_the_truth_where_it_makes_synthetic_data_alone():
    for path in PACKAGE.rglob("*.py"):
        assert "synthetic" in path.parts or "truth.toml" not in path.read_text(encoding="utf-8"), path


# ---- the plan, phantoms and truth

PLAN = {planned.id: planned for planned in list_designs()}


# ---- the population of truths


# ---- one insertion


def test_a_needle_outside_the_limits_of_the_model_is_an_error(monkeypatch):
    wide = dataclasses.replace(TRUE_MEDIA["phantom2"], bevel=0.4)
    monkeypatch.setitem(TRUE_MEDIA, "phantom2", wide)
    refusal(ModelError, "phantom2-08", simulate_insertion, PLAN["phantom2-08"], 1)
