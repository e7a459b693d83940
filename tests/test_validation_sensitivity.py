"""What a variation changes: known answers of rigidity and spacing, and an inquiry on a small study."""

import numpy as np
import pandas as pd
import pytest

from needlefit.errors import ConfigError
from needlefit.inference.forward_model import make_options, predict
from needlefit.studies.job import Job, Settings
from needlefit.studies.kinds.sensitivity import REPORT, VariationRecord, apply_variation
from needlefit.studies.paper_cells import prepare_jobs
from needlefit.studies.study_files import load_study


@pytest.fixture(scope="module")
def job() -> Job:
    return prepare_jobs(["study2"], [], Settings())["study2"]


def vary(job: Job, **changes: object) -> Job:
    return apply_variation(job, VariationRecord(factor="x", name="y", **changes))


def test_a_variation_changes_what_it_names_and_nothing_else(job):
    changed = vary(job, constraint_switch=0.0, first_cell_mm=0.5, thickness_mm=20.0, boundary_shift_sd=2.0)
    now, before = make_options(changed.medium), make_options(job.medium)
    assert (now.switch, now.tangent, now.first_cell, now.spacing) == (0.0, 1.0, 0.5, before.spacing)
    assert changed.medium.thickness_mm == 20.0 and changed.dataset.needle == job.dataset.needle
    for one, other in zip(changed.insertions, job.insertions, strict=True):
        np.testing.assert_allclose(one.boundaries, other.boundaries + 2 * other.boundary_sd)
        assert one.sequence == other.sequence


def test_the_path_angle_takes_the_place_of_b_and_is_tuned_again(job):
    changed = vary(job, advance="path_angle")
    assert make_options(changed.medium).path_angle and changed.medium.law == job.medium.law
    renamed = ["cut_angle_deg" if name == "bevel_mm" else name for name in job.parameters.free]
    assert list(changed.parameters.free) == renamed and changed.parameters.ties == job.parameters.ties
    values = {**job.hand_tuned, "cut_angle_deg": 3.0}
    assert predict(values, changed.medium, job.dataset.needle, job.insertions[0]).converged


def test_a_stiffer_needle_in_as_much_stiffer_tissue_bends_alike(job):
    stiff, needle = vary(job, rigidity_factor=1.1).dataset.needle, job.dataset.needle
    hollow = vary(job, inner_diameter_mm=1.27 / 2).dataset.needle
    assert hollow.flexural_rigidity == pytest.approx(15 / 16 * needle.flexural_rigidity)
    values = dict(job.hand_tuned)
    more = {name: 1.1 * value if name.startswith("mu") else value for name, value in values.items()}
    soft, hard = (
        predict(given, job.medium, tube, job.insertions[-1]).u
        for given, tube in ((values, needle), (more, stiff))
    )
    np.testing.assert_allclose(hard, soft, atol=1e-7)


def test_a_variation_that_changes_nothing_is_refused(tmp_path):
    file = tmp_path / "nothing.toml"
    file.write_text(
        'schema = 1\nkind = "sensitivity"\nstudies = ["small"]\n[[variations]]\nfactor = "x"\nname = "y"\n'
    )
    with pytest.raises(ConfigError, match="changes nothing"):
        load_study(file)


def test_parts_of_the_advance_along_the_tangent_are_refused_beside_the_path_angle():
    with pytest.raises(ValueError, match="leave out `tangent_part`"):
        VariationRecord(factor="advance", name="both", advance="path_angle", tangent_part=0.5)


def test_a_small_study_under_variations(world, tmp_path):
    answer = world.restore("sensitivity")
    studies = answer.frames["studies"].set_index(["aspect", "tuned", "metric"])["change"].sort_index()
    assert abs(studies.loc["rigidity", "again", "te_mm"]) < 1e-2
    assert abs(studies.loc["rigidity", "kept", "te_mm"]) > 1e-2
    assert ("constraint spacing", "kept") not in studies.index  # b is per spacing
    ratios = answer.frames["parameter_changes"].set_index(["aspect", "parameter"])["ratio"]
    assert ratios["rigidity", "mu1_pa"] == pytest.approx(1.1, rel=0.01)
    assert pd.isna(ratios["constraint spacing", "bevel_mm"])
    assert "2 variations" in REPORT.summarize(answer)[0]
    assert REPORT.draw(answer, tmp_path)["studies"].is_file()
    again, kept, *_ = REPORT.lay_out(answer)
    assert len(again.rows) == 3 and len(kept.rows) == 2
    assert answer.run["variations"]["constraint spacing: 2 mm"]["constraint_spacing_mm"] == 2.0
    # where no variation keeps the parameters
    studies = answer.frames["studies"]
    spaced = answer.with_frames(studies=studies[studies["aspect"] != "rigidity"])
    assert "No variation keeps the parameters." in REPORT.summarize(spaced)
