"""The bundle: gaps are empty boxes, evidence of another thing is not counted, nothing is claimed."""

import json
import re
from dataclasses import replace
from shutil import copytree

import pandas as pd
import pytest
from credibility_cases import (
    WORK,
    leave,
    leave_calibration,
    leave_sensitivity,
    leave_verification,
    results,
)
from reporting_results import stereo
from test_cli import run

from needlefit.errors import DataError
from needlefit.project.folders import write_manifest
from needlefit.reporting.table_files import write_csv, write_json
from needlefit.schemas.credibility_statements import CredibilityStatementsRecord
from needlefit.studies.job import Settings
from needlefit.studies.kind import find_kind
from needlefit.studies.kinds.credibility import (
    REPORT,
    TEXT,
    collect_entries,
    collect_entry,
    gather_evidence,
    list_factors,
    load_case,
)

FACTORS = list_factors()
DISCLAIMER = TEXT.sentence("disclaimer", {})


def find_code_verification(case):
    return collect_entry(next(one for one in FACTORS if one.key == "code_verification"), case)


def read_findings(folder, *named, about=None):
    """Return every factor's findings and gaps, by its key."""
    given = (
        {}
        if about is None
        else {"statements": CredibilityStatementsRecord.model_validate({"schema": 1, **about})}
    )
    found = load_case(folder, named, **given)
    return {
        one.factor.key: (" ".join(f.words for f in one.findings), list(one.gaps))
        for one in collect_entries(found)
    }


def compose_blocks(folder):
    """Return the report of the bundle of a run, down to its provenance."""
    kind = find_kind("credibility")
    return REPORT.compose(kind.run("bundle", kind.make_record(run=str(folder)), Settings()), {})


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    return leave(results(), tmp_path_factory.mktemp("left"))


@pytest.fixture(scope="module")
def bare(left):
    """The findings and gaps of a run with nothing beside it."""
    return read_findings(left)


@pytest.fixture
def alone(left, tmp_path):
    """A run with nothing beside it."""
    return copytree(left, tmp_path / left.name)


def test_without_evidence_every_gap_names_the_missing_evidence(bare):
    assert {one.key for one in FACTORS if one.needs_statement} == {
        *CredibilityStatementsRecord.model_fields
    } - {"schema_"}
    for key in ("question_of_interest", "context_of_use", "relevance_of_quantities"):
        words, gaps = bare[key]
        assert words == "" and len(gaps) == 1 and key in gaps[0] and "--statements" in gaps[0]
    for key in ("code_verification", "discretisation"):
        words, (gap,) = bare[key]
        assert words == "" and "needlefit verify" in gap
    gaps = {key: " ".join(bare[key][1]) for key in bare}
    assert "tie, advance, constraint spacing" in gaps["form"]
    assert "thickness, rigidity, layer depths" in gaps["sensitivities"]
    assert "needlefit tune" in gaps["sensitivities"]
    assert "needlefit calibrate" in gaps["uncertainties"]
    assert "nothing physical" in gaps["samples"]
    assert bare["samples_uncertainty"][0] == ""


def test_evidence_of_the_same_model_is_reported_with_numbers_and_fills_its_gap(alone, tmp_path):
    leave_verification(tmp_path)
    leave_calibration(tmp_path)
    leave_sensitivity(tmp_path)
    found = read_findings(alone)
    assert "Closed forms: 1 of 1" in found["code_verification"][0]
    assert "4.00 × 10⁻⁸ mm (bound ≤ 10⁻⁷)" in found["code_verification"][0]
    assert found["code_verification"][1] == []
    assert "Discretisation error: 1 of 1" in found["discretisation"][0]
    assert "500 truths" in found["uncertainties"][0] and "472 to 481 of 500" in found["uncertainties"][0]
    assert not any("calibrate" in gap for gap in found["uncertainties"][1])
    words, gaps = found["form"]
    assert "Tie, 2 variations" in words and "0.030 mm (0.3 noise floors)" in words
    assert re.search(r"0\.74 mm\) CHANGES .*study1 .*tie: ahead", words)
    assert "advance, constraint spacing" in " ".join(gaps) and "tie" not in " ".join(gaps)


def test_failed_checks_are_reported(alone, tmp_path):
    leave_verification(tmp_path, measured=3e-6)
    leave_calibration(tmp_path, not_calibrated=["mu1_pa"])
    found = read_findings(alone)
    assert re.search(r"0 of 1 .*1 FAIL \(Case 0", found["code_verification"][0])
    assert "NOT calibrated: μ₁" in found["uncertainties"][0]


def beside(folder):
    """Return the evidence that lies beside study 1 in a folder."""
    return gather_evidence(folder / "study1", {"study1": WORK})


def other(part, **changed):
    return {part: {**WORK[part], **changed}}


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        (other("dataset", sha256="cd" * 32), "dataset sha256: cdcdcdcdcdcd…"),
        (other("versions", needlefit="0.0.9"), "needlefit: 0.0.9 "),
        (other("rules", tie="ahead"), "rules tie: ahead "),
        (other("medium", thickness_mm=20.0), "medium thickness_mm: 20.0 "),
        ({"folds": [{"name": "all", "tune": ["a"], "validate": ["c"]}]}, "tuned on"),
        ({"recipe": None}, "recipe: "),
    ],
)
def test_evidence_of_another_model_is_named(tmp_path, changed, why):
    leave_calibration(tmp_path, **changed)
    (evidence,) = beside(tmp_path)
    assert not evidence.counted and why in "; ".join(evidence.objections)


def test_another_seed_or_title_is_the_same_model(tmp_path):
    leave_calibration(tmp_path, **other("recipe", seed=7, title="Mine"))
    assert [one.counted for one in beside(tmp_path)] == [True]


def test_a_sensitivity_study_counts_for_the_runs_whose_fit_it_varied(tmp_path):
    part = {key: WORK[key] for key in ("medium", "recipe", "rules", "folds")}
    others = part | {"folds": [{"name": "all", "tune": ["x"], "validate": []}]}
    leave_sensitivity(tmp_path / "one", parts=[others, part])
    leave_sensitivity(tmp_path / "two", parts=[others])
    assert [one.counted for name in ("one", "two") for one in beside(tmp_path / name)] == [True, False]


def test_verification_of_another_mesh_covers_the_code_but_not_the_discretisation(tmp_path):
    alone = leave(results(rules={**WORK["rules"], "element_mm": 0.5}), tmp_path)
    leave_verification(tmp_path)
    found = read_findings(alone)
    assert found["code_verification"][0] and not found["discretisation"][0]
    gaps = " ".join(found["discretisation"][1])
    assert " 1 mm" in gaps and " 0.5 mm" in gaps


def test_named_folders_replace_those_found_and_are_refused_if_no_evidence(alone, tmp_path):
    leave_verification(tmp_path, measured=1e-8)
    named = leave_verification(tmp_path / "elsewhere", measured=2e-8)
    for given, measured in (((named,), "2.00 × 10⁻⁸"), ((), "1.00 × 10⁻⁸")):
        assert measured in find_code_verification(load_case(alone, given)).findings[0].words
    foreign = leave_calibration(tmp_path / "elsewhere", of="study2")
    (evidence,) = load_case(alone, [foreign]).evidence[:1]
    (objection,) = evidence.objections
    assert "study2" in objection and "study1" in objection
    with pytest.raises(DataError, match="holds no evidence"):
        load_case(alone, [alone])


def test_evidence_with_a_table_missing_or_of_another_layout_is_not_counted(tmp_path):
    folder = leave_sensitivity(tmp_path)
    pd.read_csv(folder / "cells.csv").drop(columns="change").to_csv(folder / "cells.csv", index=False)
    (leave_verification(tmp_path) / "verification.csv").unlink()
    objections = {one.kind: one.objections for one in beside(tmp_path)}
    assert set(objections) == {"sensitivity", "verification"}
    for kind, name in (("sensitivity", "cells.csv"), ("verification", "verification.csv")):
        (objection,) = objections[kind]
        assert objection.startswith(f"{name} ")
    assert objections["sensitivity"][0].endswith(" change")


def test_measured_shapes_are_not_called_synthetic_and_leave_gaps(tmp_path):
    found = read_findings(leave(replace(stereo(), run={"name": "stereo_insertions"}), tmp_path))
    assert not any("nothing physical" in gap for _, gaps in found.values() for gap in gaps)
    assert "rigid alignment" in found["outputs_alike"][0]
    assert "uncertainty" in " ".join(found["rigour"][1])
    assert "Nothing found" in found["quality_assurance"][0] or found["quality_assurance"][1]


def test_equal_findings_of_several_runs_are_listed_once(tmp_path):
    runs = [results(1), results(5)]
    for one in runs:
        leave(one, tmp_path)
    leave_calibration(tmp_path, of="study5")
    (tmp_path / "all").mkdir()
    write_json(tmp_path / "all/run.json", {one.name: one.run_json for one in runs})
    write_manifest(tmp_path / "all")
    blocks = compose_blocks(tmp_path / "all")
    items = [item for block in blocks if block["kind"] == "list" for item in block["items"]]
    computed = [item for item in items if "Computed with" in item]
    assert len(computed) == 1 and computed[0].startswith("study1, study5: ") and "emcee 3.1" in computed[0]
    assert any(item.startswith("study5: 500 truths") for item in items)
    gaps = [block["text"] for block in blocks if block["kind"] == "empty"]
    assert any(re.search(r"uncertainties .* study1: ", gap) for gap in gaps)


def test_a_bundle_claims_nothing_and_records_what_it_read(alone, tmp_path, capsys, monkeypatch):
    leave_verification(tmp_path)
    monkeypatch.chdir(tmp_path)
    stated = "Planning of a phantom study."
    (tmp_path / "about.toml").write_text(f'schema = 1\ncontext_of_use = "{stated}"\n')
    assert run("credibility", str(alone), "--statements", "about.toml", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert {row["factor"] for row in answer["factors"]} == {one.name for one in FACTORS}
    folder = tmp_path / "reports/credibility-study1"
    page, table = ((folder / name).read_text() for name in ("report.html", "credibility.csv"))
    words, claim = " ".join(re.sub(r"<[^>]*>", " ", page).split()), DISCLAIMER.replace("&", "&amp;")
    assert claim in words and not re.search(r"compl(y|ies|ian)", words.replace(claim, "") + table)
    assert stated in words and str(tmp_path) not in words
    about = json.loads((folder / "run.json").read_text())
    assert about["stated"]["context_of_use"]
    assert about["digests"]["verification"].keys() == {"run.json", "verification.csv"}


def test_a_bundle_about_a_run_that_changed_is_not_reported_again(alone, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("credibility", str(alone)) == 0
    about = json.loads((alone / "run.json").read_text())
    write_json(alone / "run.json", about | {"name": "another"})
    assert run("report", "credibility-study1") == 3
    assert str(alone) in capsys.readouterr().err


def test_a_folder_without_a_run_is_refused(tmp_path, capsys):
    folder = leave_verification(tmp_path)
    assert run("credibility", str(folder)) == 3
    assert str(folder) in capsys.readouterr().err
    assert run("credibility", str(tmp_path / "nothing")) == 3
    assert str(tmp_path / "nothing") in capsys.readouterr().err


def test_damaged_files_beside_the_run_are_named_and_those_of_the_run_are_an_error(alone, tmp_path):
    verification = leave_verification(tmp_path)
    write_manifest(verification)
    write_csv(pd.read_csv(verification / "verification.csv").head(2), verification / "verification.csv")
    (leave_calibration(tmp_path) / "run.json").write_text("[]")
    found = load_case(alone)
    assert [one.split()[0] for one in found.damaged] == ["calibrate-study1/run.json"]
    assert [one.counted for one in found.evidence] == [False]
    assert "verification.csv" in found.evidence[0].objections[0]
    gaps = next(one for one in collect_entries(found) if one.factor.key == "use_error").gaps
    assert sum("calibrate-study1/run.json" in gap for gap in gaps) == 1
    for text in ("[]", '{"name": "stu'):
        (alone / "run.json").write_text(text)
        with pytest.raises(DataError, match=r"run\.json"):
            load_case(alone)
