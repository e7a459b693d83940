"""What a variation changes: known answers of rigidity and spacing, and an inquiry on a small study."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from needlefit.errors import ConfigError
from needlefit.inference.forward_model import make_options, predict
from needlefit.project.locate import find_file
from needlefit.studies.job import Settings
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.sensitivity.run import apply_variation
from needlefit.studies.kinds.sensitivity.schema import VariationRecord
from needlefit.studies.paper_cells import prepare_jobs
from needlefit.studies.study_files import load_study

RECIPE = (Path(__file__).parent.parent / "configs/recipes/quick.toml").read_text(encoding="utf-8")
STUDY = """schema = 1
dataset = "twin"
medium = "chicken"
recipe = "few"
paper_study = 5
[tune]
insertions = ["chicken-01"]
[[validate]]
insertions = ["chicken-04", "chicken-05"]
"""
SENSITIVITY = """schema = 1
kind = "sensitivity"
studies = ["small"]
starts = 1
[[variations]]
factor = "rigidity"
name = "10 % more"
rigidity_factor = 1.1
[[variations]]
factor = "constraint spacing"
name = "2 mm"
constraint_spacing_mm = 2.0
"""


def test_a_variation_changes_what_it_names_and_nothing_else():
    job = prepare_jobs(["study2"], [], Settings())["study2"]
    variation = VariationRecord(
        factor="x",
        name="y",
        constraint_switch=0.0,
        first_cell_mm=0.5,
        thickness_mm=20.0,
        boundary_shift_sd=2.0,
    )
    changed = apply_variation(job, variation)
    now, before = make_options(changed.medium), make_options(job.medium)
    assert (now.switch, now.tangent, now.first_cell, now.spacing) == (0.0, 1.0, 0.5, before.spacing)
    assert changed.medium.thickness_mm == 20.0 and changed.dataset.needle == job.dataset.needle
    for one, other in zip(changed.insertions, job.insertions, strict=True):
        np.testing.assert_allclose(one.boundaries, other.boundaries + 2 * other.boundary_sd)
        assert one.sequence == other.sequence


def test_the_path_angle_takes_the_place_of_b_and_is_tuned_again():
    job = prepare_jobs(["study2"], [], Settings())["study2"]
    changed = apply_variation(job, VariationRecord(factor="advance", name="path angle", advance="path_angle"))
    assert make_options(changed.medium).path_angle and changed.medium.law == job.medium.law
    renamed = ["cut_angle_deg" if name == "bevel_mm" else name for name in job.parameters.free]
    assert list(changed.parameters.free) == renamed and changed.parameters.ties == job.parameters.ties
    values = {**job.hand_tuned, "cut_angle_deg": 3.0}
    assert predict(values, changed.medium, job.dataset.needle, job.insertions[0]).converged


def test_a_stiffer_needle_in_as_much_stiffer_tissue_bends_alike():
    job = prepare_jobs(["study2"], [], Settings())["study2"]
    stiff = apply_variation(job, VariationRecord(factor="rigidity", name="more", rigidity_factor=1.1))
    hollow = apply_variation(job, VariationRecord(factor="rigidity", name="tube", inner_diameter_mm=1.27 / 2))
    assert hollow.dataset.needle.flexural_rigidity == pytest.approx(
        15 / 16 * job.dataset.needle.flexural_rigidity
    )
    assert job.hand_tuned is not None
    values = dict(job.hand_tuned)
    more = {name: 1.1 * value if name.startswith("mu") else value for name, value in values.items()}
    insertion = job.insertions[-1]
    soft = predict(values, job.medium, job.dataset.needle, insertion)
    np.testing.assert_allclose(
        predict(more, stiff.medium, stiff.dataset.needle, insertion).u, soft.u, atol=1e-7
    )


def test_a_variation_that_changes_nothing_is_refused(tmp_path):
    file = tmp_path / "nothing.toml"
    file.write_text(SENSITIVITY.replace("rigidity_factor = 1.1\n", ""))
    with pytest.raises(ConfigError, match="changes nothing"):
        load_study(file)


def test_parts_of_the_advance_along_the_tangent_are_refused_beside_the_path_angle():
    with pytest.raises(ValueError, match="leave out `tangent_part`"):
        VariationRecord(factor="advance", name="both", advance="path_angle", tangent_part=0.5)


def test_a_study_whose_variations_never_keep_the_parameters_has_a_report(tmp_path, monkeypatch):
    file = tmp_path / "varied.toml"
    spacing_alone = SENSITIVITY.split("[[variations]]")
    file.write_text("[[variations]]".join((spacing_alone[0].replace("small", "study2"), spacing_alone[2])))
    answer = find_kind("sensitivity").run("varied", load_study(file), Settings())
    assert set(answer.frames["studies"]["tuned"]) == {"again"} and len(answer.frames["studies"])
    sentences = find_kind("sensitivity").report.summarize(answer)
    assert "1 variation of" in sentences[0] and "No variation keeps the parameters." in sentences


def test_a_small_study_under_two_variations(tmp_path, monkeypatch):
    for folder in ("studies", "configs/recipes"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "configs/recipes/few.toml").write_text(RECIPE.replace("starts = 4", "starts = 2"))
    (tmp_path / "studies/small.toml").write_text(STUDY)
    (tmp_path / "studies/varied.toml").write_text(SENSITIVITY)
    monkeypatch.chdir(tmp_path)
    record = load_study(find_file("study", "varied"))
    assert record is not None
    answer = find_kind("sensitivity").run("varied", record, Settings())
    studies = answer.frames["studies"].set_index(["aspect", "tuned", "metric"])["change"].sort_index()
    assert abs(studies.loc["rigidity", "again", "te_mm"]) < 1e-3
    assert abs(studies.loc["rigidity", "kept", "te_mm"]) > 1e-3
    assert ("constraint spacing", "kept") not in studies.index  # b is per spacing
    ratios = answer.frames["parameter_changes"].set_index(["aspect", "parameter"])["ratio"]
    assert ratios["rigidity", "mu1_pa"] == pytest.approx(1.1, rel=0.01)
    assert pd.isna(ratios["constraint spacing", "bevel_mm"])
    page = find_kind("sensitivity").report
    assert "2 variations" in page.summarize(answer)[0]
    assert page.draw(answer, tmp_path)["studies"].is_file()
    again, kept, *_ = page.lay_out(answer)
    assert len(again.rows) == 3 and len(kept.rows) == 2
    assert answer.run["variations"]["constraint spacing: 2 mm"]["constraint_spacing_mm"] == 2.0
