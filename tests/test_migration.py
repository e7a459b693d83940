"""Files and runs of earlier versions: refused with the new names, and rewritten without another change."""

import json
import tomllib

import pandas as pd
import pytest
from reporting_results import study

from needlefit.errors import ConfigError, DataError
from needlefit.project.load import load
from needlefit.project.migration import FILE_KINDS, migrate_file, migrate_text, rename_keys
from needlefit.reporting.run_folder import write
from needlefit.reporting.run_migration import migrate_run, rename_results
from needlefit.schemas.analyses import AdaptationRecord, SensitivityRecord
from needlefit.schemas.renamed import RENAMED_KEYS
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import StudyRecord
from needlefit.validation import packing
from needlefit.validation.renamed import RENAMED_COLUMNS
from needlefit.validation.stored import restore_results

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
    text, kind = migrate_text(SCENE, FILE_KINDS, "scene")
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


def to_earlier(table, version):
    """Return stored results as an earlier version wrote them."""
    earlier = {
        frame: {new: old for old, new in columns.items()} for frame, columns in RENAMED_COLUMNS.items()
    }
    frames = {
        name: {
            part: {earlier.get(name, {}).get(column, column): cells for column, cells in frame[part].items()}
            for part in ("types", "columns")
        }
        for name, frame in table["frames"].items()
    }
    return {**table, "frames": frames, "format": version}


@pytest.mark.parametrize("version", [2, 3])
def test_a_run_of_an_earlier_version_is_written_anew_with_the_same_numbers(tmp_path, monkeypatch, version):
    folder = tmp_path / "run"
    write(study(3), folder)
    before = _tables_and_figures(folder)
    expected = restore_results(folder)
    earlier = to_earlier(packing.unpack(folder), version)
    assert "rival" in earlier["frames"]["errors"]["columns"]
    with monkeypatch.context() as patch:
        patch.setattr(packing, "FORMAT_VERSION", version)
        if version == 2:
            patch.setattr(packing, "with_digest", _without_digest)
        packing.pack(earlier, folder)
    _restamp(folder)
    with pytest.raises(DataError, match="needlefit migrate"):
        restore_results(folder)
    assert migrate_run(folder, dry_run=True) and migrate_run(folder) and not migrate_run(folder)
    for name in ("errors", "shapes", "starts"):
        pd.testing.assert_frame_equal(getattr(restore_results(folder), name), getattr(expected, name))
    assert _tables_and_figures(folder) == before


def _tables_and_figures(folder):
    """Return all files but those that hold the version of the study's schema, or a digest of it."""
    files = {path.name: path for path in folder.iterdir() if path.is_file()}
    left_out = (packing.RESULTS_FILE, "needlefit.json")
    return {name: path.read_bytes() for name, path in files.items() if name not in left_out}


def _without_digest(content):
    import gzip

    return gzip.compress(content, 6, mtime=0)


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
    assert (tmp_path / "insertions_needed.csv").read_text() == "approach,origin\nfresh,synthetic\n"
    assert (tmp_path / "errors.csv").read_text() == "method,te_mm\nline,0.1250\n"
    assert not (tmp_path / "reached.csv").exists()
    assert json.loads((tmp_path / "run.json").read_text())["study"]["layer_count_rule"] == "listed"
