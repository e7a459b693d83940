"""Files and runs of earlier versions: refused with the new names, and rewritten without another change."""

import gzip
import json
import tomllib
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from reporting_results import study

from needlefit.errors import ConfigError, DataError
from needlefit.project.load import load
from needlefit.schemas.renamed import RENAMED_KEYS
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import StudyRecord
from needlefit.studies import packing
from needlefit.studies.earlier_results import convert_results
from needlefit.studies.identification import IDENTIFICATION_COLUMNS
from needlefit.studies.kind import KINDS, find_kind
from needlefit.studies.kinds.adaptation.schema import AdaptationRecord
from needlefit.studies.kinds.sensitivity.schema import SensitivityRecord
from needlefit.studies.migration import list_file_kinds, migrate_file, migrate_text, rename_keys
from needlefit.studies.renamed import RENAMED_COLUMNS
from needlefit.studies.report import write_run
from needlefit.studies.run import restore_run
from needlefit.studies.run_migration import migrate_run, rename_results

STUDY = """\
# hand_tuned = "a comment stays"
schema = 1
title = "reading = hand_tuned"
dataset = "twin"
medium = "phantom2"
reading = "alternative"   # as in the paper
"hand_tuned" = "study2"
tune = { layers = [2] }
validate = [{ layers = [3] }]
"""

SCENE = """\
schema = 1
depth_mm = 30.0
guides = [{ name = "holds", x_mm = -20.0, y_mm = 0.0, holds = false }]
needle = { length_mm = 150.0, outer_diameter_mm = 1.27, youngs_modulus_gpa = 80.0 }
bevel = { offset_mm = 0.1 }
layers = [{ top_mm = 0.0, mu_pa = 2e5, alpha = 1.0 }]
"""


def test_an_earlier_key_is_refused_with_its_new_name(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(STUDY)
    with pytest.raises(ConfigError) as caught:
        load(file, StudyRecord)
    assert caught.value.where == f"{file}:6"
    assert all(name in caught.value.what for name in ("layer_count_rule", "paper_parameters"))
    assert "needlefit migrate" in caught.value.fix


def test_only_keys_and_the_schema_change(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(STUDY)
    assert migrate_file(file, dry_run=True) and file.read_text() == STUDY
    assert migrate_file(file)
    changed = [
        new for old, new in zip(STUDY.splitlines(), file.read_text().splitlines(), strict=True) if old != new
    ]
    assert changed == [
        "schema = 2",
        'layer_count_rule = "alternative"   # as in the paper',
        'paper_parameters = "study2"',
    ]
    assert not migrate_file(file)
    assert load(file, StudyRecord).layer_count_rule == "alternative"


def test_a_key_within_a_list_of_tables_is_renamed():
    text, kind = migrate_text(SCENE, list_file_kinds(), "scene")
    assert kind is SceneRecord
    assert tomllib.loads(text)["guides"] == [{"name": "holds", "x_mm": -20.0, "y_mm": 0.0, "engaged": False}]


def test_headers_of_tables_are_renamed():
    table = {"between": {"ln_mu_sd": 0.5}, "old": {}, "new": {"held_out": []}}
    assert list(rename_keys(table, AdaptationRecord)) == ["between_media", "old", "new"]
    variations = {"variations": [{"of": "length", "name": "x"}], "of": 1}
    assert rename_keys(variations, SensitivityRecord) == {
        "variations": [{"factor": "length", "name": "x"}],
        "of": 1,
    }


def test_a_file_without_earlier_keys_is_read_at_any_schema_up_to_today_s(tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(SCENE.replace(", holds = false", ""))
    assert load(file, SceneRecord).schema_ == 1
    file.write_text(file.read_text().replace("schema = 1", "schema = 9"))
    with pytest.raises(ConfigError, match="schema"):
        load(file, SceneRecord)


def test_what_is_no_file_of_needlefit_is_refused_and_stays(tmp_path):
    file = tmp_path / "other.toml"
    file.write_text("schema = 1\nholds = 3\n")
    with pytest.raises(ConfigError):
        migrate_file(file)
    assert file.read_text() == "schema = 1\nholds = 3\n"


def test_every_new_name_is_a_key_of_its_record():
    kinds = {kind.__name__: kind for kind in _records()}
    for name, keys in RENAMED_KEYS.items():
        fields = kinds[name].model_fields
        assert set(keys.values()) <= set(fields) and not set(keys) & set(fields)


def _records():
    from needlefit.schemas.base import Record

    pending = [Record]
    while pending:
        pending += (found := pending.pop()).__subclasses__()
        yield found


def to_earlier(table):
    """Return stored results as an earlier version wrote them."""
    earlier = {
        frame: {new: old for old, new in reversed(columns.items())}
        for frame, columns in RENAMED_COLUMNS.items()
    }
    frames = {
        name: {
            part: {earlier.get(name, {}).get(column, column): cells for column, cells in frame[part].items()}
            for part in ("types", "columns")
        }
        for name, frame in table["frames"].items()
        if name != "needles"
    }
    return {**table, "kind": "study", "frames": frames, "needles": []}


@pytest.mark.sweep
def test_a_run_of_an_earlier_version_is_written_anew_with_the_same_numbers(tmp_path, monkeypatch):
    folder = tmp_path / "run"
    made = study(3)
    state = {"interrupted": made.interrupted, "faults": list(made.faults), "sampled": False}
    no_needles = made.frames["needles"].iloc[:0]
    write_run(replace(made.with_frames(needles=no_needles), run=made.run | state), folder)
    before = _tables_and_figures(folder)
    expected = restore_run(folder)
    earlier = to_earlier(packing.unpack(folder))
    assert "rival" in earlier["frames"]["errors"]["columns"]
    with monkeypatch.context() as patch:
        patch.setattr(packing, "FORMAT_VERSION", 3)
        packing.pack(earlier, folder)
    _restamp(folder)
    with pytest.raises(DataError, match="needlefit migrate"):
        restore_run(folder)
    assert migrate_run(folder, dry_run=True) and migrate_run(folder) and not migrate_run(folder)
    for name in ("errors", "shapes", "starts"):
        pd.testing.assert_frame_equal(restore_run(folder).frames[name], expected.frames[name])
    assert _tables_and_figures(folder) == before


def _tables_and_figures(folder):
    """Return all files but those that hold the version of the study's schema, or a digest of it."""
    files = {path.name: path for path in folder.iterdir() if path.is_file()}
    left_out = (packing.RESULTS_FILE, "needlefit.json")
    return {name: path.read_bytes() for name, path in files.items() if name not in left_out}


def test_the_format_without_a_digest_is_read(tmp_path):
    (tmp_path / packing.RESULTS_FILE).write_bytes(gzip.compress(b'{"format": 2, "kind": "study"}'))
    assert packing.unpack_version(tmp_path) == (2, {"format": 2, "kind": "study"})


def _restamp(folder):
    from needlefit.project.ownership import write_stamp

    write_stamp(folder)


def test_names_of_frames_and_columns_follow_the_kind():
    frame = {"types": {"worth": "float64"}, "columns": {"worth": [1.5]}}
    assert rename_results({"kind": "next_insertion", "frames": {"told": frame, "candidates": frame}})[
        "frames"
    ] == {
        "gains": frame,
        "candidates": {"types": {"ess": "float64"}, "columns": {"ess": [1.5]}},
    }


def test_tables_without_stored_results_are_renamed_in_place(tmp_path):
    (tmp_path / "run.json").write_text(
        json.dumps({"study": {"kind": "adaptation", "reading": "listed"}, "name": "a"})
    )
    (tmp_path / "reached.csv").write_text("way,origin\nfresh,synthetic\n")
    (tmp_path / "errors.csv").write_text("rival,te_mm\nline,0.1250\n")
    assert migrate_run(tmp_path) and not migrate_run(tmp_path)
    assert (tmp_path / "insertions_needed.csv").read_text() == "method,origin\nfresh,synthetic\n"
    assert (tmp_path / "errors.csv").read_text() == "method,te_mm\nline,0.1250\n"
    assert not (tmp_path / "reached.csv").exists()
    assert json.loads((tmp_path / "run.json").read_text())["study"]["layer_count_rule"] == "listed"


def packed(**columns):
    return packing.pack_frame(pd.DataFrame(columns))


def empty(kind, *names):
    return {name: packed(**{column: [] for column in KINDS[kind].frames[name]}) for name in names}


RUN = {
    "name": "mine",
    "versions": {"needlefit": "0.1.0"},
    "dataset": {"name": "twin", "origin": "synthetic", "sha256": "ab"},
    "study": {"schema": 2, "dataset": "twin", "medium": "chicken", "tune": {"insertions": ["a", "b"]}},
    "folds": [{"name": "all", "tune": ["a", "b"], "validate": []}],
    "medium": {"thickness_mm": 40.0},
}


def restore_converted(table, folder):
    """Store an earlier result, converted, and read it as one of today."""
    folder.mkdir()
    packing.pack(convert_results(rename_results(table), folder), folder)
    return restore_run(folder)


def test_a_summary_with_a_column_per_metric_gets_one_row_per_metric(tmp_path):
    numbers = {"ipe_mean_mm": 0.1, "te_mm": 0.2, "ipe_gap_mm": 0.3, "te_gap_mm": 0.4}
    numbers |= {"ipe_gap_se_mm": 0.5, "te_gap_se_mm": 0.6}
    for n, what in enumerate(("in_sample", "planned", "curve", "floor"), start=1):
        numbers |= {f"{what}_ipe_mean_mm": 1.0 * n, f"{what}_te_mm": 10.0 * n}
    head = {"fit": "f", "left_out": "insertion", "medium": "chicken", "groups": 2, "insertions": 2}
    tail = {"worst_pareto_k": 0.5, "folds_sampled": 0, "not_converged": 0, "note": ""}
    record = {"schema": 2, "kind": "left_out", "fits": ["f"], "groups": ["insertion"]}
    table = {
        **{"kind": "left_out", "record": record, "name": "mine", "origin": "synthetic"},
        **{"dataset_title": "Twin", "interrupted": False, "faults": ["x"], "run": RUN},
        "frames": {
            "summary": packed(**{key: [value] for key, value in (head | numbers | tail).items()}),
            **empty("left_out", "errors", "predictive", "fits"),
        },
    }
    found = restore_converted(table, tmp_path / "run")
    summary = found.frames["summary"].set_index("metric")
    assert summary["value"].to_dict() == {"ipe_mean_mm": 0.1, "te_mm": 0.2}
    assert summary.loc["te_mm", ["difference", "difference_se", "planned", "floor"]].tolist() == [
        0.4,
        0.6,
        20.0,
        40.0,
    ]
    assert found.faults == ("x",) and found.run["faults"] == ["x"]


def test_tip_tracks_get_their_summaries(tmp_path):
    runs = {column: ["a"] for column in ("fit", "run", "medium", "specimen")} | {"role": ["validate"] * 2}
    runs = {key: cells * (3 - len(cells)) if len(cells) == 1 else cells for key, cells in runs.items()}
    runs |= {"method": ["fitted", "straight"], "rms_mm": [0.1, 0.3], "aligned_rms_mm": [0.1, 0.1]}
    rest = [name for name in KINDS["tracks"].frames["runs"] if name not in runs]
    runs |= {name: [True, False] if "_in_" in name else [0.5, 0.5] for name in rest}
    readings = {name: ["a"] for name in KINDS["tracks"].frames["readings"]}
    readings |= {"depth_mm": [25.0], "scored": [True], "measured_mm": [1.0], "median_mm": [1.5]}
    record = {"schema": 2, "observes": "tip tracks", "dataset": "d", "placed_by_mm": 10.0}
    side = {"media": ["m"], "runs": [], "guided": None}
    record["fits"] = [{"name": "a", "medium": "m", "tune": side, "validate": side}]
    table = {
        **{"kind": "tracks", "record": record, "name": "mine", "origin": "measured", "dataset_title": "T"},
        **{"interrupted": False, "notes": ["n"], "remarks": [], "posteriors": [], "run": RUN},
        "frames": {
            **{"runs": packed(**runs), "readings": packed(**readings)},
            **empty("tracks", "parameters"),
        },
    }
    found = restore_converted(table, tmp_path / "run")
    paired = found.frames["paired"].set_index(["method", "metric"])
    assert paired.loc[("straight", "rms_mm"), "difference"] == pytest.approx(0.2)
    assert found.frames["depths"]["error_mm"].tolist() == [0.5]
    assert found.record.registration_depth_mm == 10.0
    assert found.run["dataset"]["notes"] == ["n"] and not found.faults


def test_a_calibration_is_judged_by_its_replicates(tmp_path):
    count = 40
    replicates = {"replicate": list(range(count)), "redrawn": [0] * count, "by": ["importance"] * count}
    replicates |= {"trusted": [True] * count, "rank_mu1_pa": [0] * count}
    table = {
        **{"kind": "calibration", "name": "mine", "title": "Mine", "origin": "synthetic"},
        **{"dataset_title": "Twin", "control": None, "sampled": False, "interrupted": False},
        **{"insertions": ["a", "b"], "depths": [20.0, 30.0], "run": {**RUN, "draws": 79, "sampled": False}},
        "frames": {"replicates": packed(**replicates), "coverage": packed(), "ecdfs": packed()},
    }
    found = restore_converted(table, tmp_path / "calibrate-mine")
    assert found.name == "calibrate-mine" and found.run["name"] == "mine"
    assert found.run["not_calibrated"] == ["mu1_pa"] and found.faults == ("not calibrated: mu1_pa",)
    assert found.run["draw_source"] == {"importance": count}
    assert found.frames["design"]["depth_mm"].tolist() == [20.0, 30.0]
    assert found.record.replicates == count and found.run["study"]["target"] == "mine"
    assert find_kind("calibration").report.summarize(found)


def test_the_stages_of_an_identification_are_rows_of_one_table(tmp_path):
    rows = {name: [0.5] for name in IDENTIFICATION_COLUMNS}
    rows |= {"fold": ["all"], "parameter": ["mu1_pa"], "status": ["free"], "determined": [True]}
    rows |= {"profile_verdict": ["bounded"], "agreement": [""]}
    profiles = {"fold": ["all"], "parameter": ["mu1_pa"], "value": [1e5]}
    run = {**RUN, "name": "identify-mine", "place": "the fitted values"}
    stage = {"rows": packed(**rows), "profiles": packed(**profiles)}
    table = {
        **{"kind": "identification", "origin": "synthetic"},
        "directions": packed(combination=["mu1"], contraction=[0.1], words=["w"], origin=["synthetic"]),
        "stages": {"design": {**stage, "run": run}, "fit": {**stage, "run": {**run, "evaluations": 7}}},
    }
    found = restore_converted(table, tmp_path / "identify-mine")
    assert found.frames["identify"]["stage"].tolist() == ["design", "fit"]
    assert list(found.frames["directions"]) == ["combination", "sd_ratio", "note"]
    assert found.record.fit and found.record.target == "mine" and found.run["evaluations"] == 7
    assert len(find_kind("identification").report.summarize(found)) >= 2  # the depths were not stored


def test_a_prediction_states_its_scene(tmp_path):
    shape = {"s_mm": [0.0, 30.0], "converged": [False, False], "origin": ["synthetic"] * 2}
    scene = tomllib.loads(SCENE)
    run = {**RUN, "scene": scene, "tip": {}, "draw_source": "posterior", "draws": 400}
    run |= {"failed_solves": 0, "outside_validity": 0, "not_converged": ["why"]}
    table = {"kind": "forecast", "title": "Title (NOT CONVERGED)", "table": packed(**shape), "run": run}
    found = restore_converted(table, tmp_path / "predict-mine-planned")
    assert found.kind == "prediction" and found.faults == ("why",) and found.origin == "synthetic"
    assert found.record.scene_name == "planned" and found.record.scene.guides[0].engaged is False
    assert found.frames["forecast"]["scene"].tolist() == ["planned"] * 2
    assert found.run["study"]["posterior"] == "mine" and "scene" not in found.run


@pytest.mark.parametrize(
    ("run", "command"),
    [
        ({"name": "verification", "seed": 3}, "needlefit verify --seed 3 --out"),
        (
            {
                **{"name": "material-gel", "file": "my gel.csv", "columns": ["stretch", "stress_kpa"]},
                **{"measure": "true", "foundation": {"factor": 2.0, "spread": 1.5}},
            },
            "needlefit material 'my gel.csv' --stress true --foundation 2.0 1.5 --out",
        ),
        (
            {"name": "credibility-mine", "runs": {"mine": {}}, "stated": {"file": "s.toml", "schema": 1}},
            "needlefit credibility mine --statements s.toml --out",
        ),
    ],
)
def test_what_stored_no_results_is_refused_with_the_command_that_makes_it_again(tmp_path, run, command):
    (tmp_path / "run.json").write_text(json.dumps(run))
    for refused in (migrate_run, restore_run):
        with pytest.raises(DataError) as caught:
            refused(tmp_path)
        assert command in caught.value.fix


def test_the_committed_evidence_is_of_today():
    folders = [
        path.parent for path in (Path(__file__).parent.parent / "reports/reference").glob("*/run.json")
    ]
    assert len(folders) > 20
    assert not [folder.name for folder in folders if migrate_run(folder, dry_run=True)]
