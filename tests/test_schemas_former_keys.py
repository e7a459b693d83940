"""Keys of earlier versions are refused with what to write now."""

import pytest
from refusals import refusal

from needlefit.errors import ConfigError
from needlefit.project.toml import check
from needlefit.schemas.dataset import DatasetRecord, NoiseRecord, TrackDatasetRecord
from needlefit.schemas.former_keys import REMOVED_KEYS, RENAMED_KEYS
from needlefit.schemas.recipe import RecipeRecord, SampleRecord
from needlefit.schemas.reconstruction import CenterlineRecord, MarkersRecord, ReconstructionEntryRecord
from needlefit.schemas.recording import RecordingRecord
from needlefit.schemas.scene import GuideMoveRecord, GuideRecord, SceneRecord
from needlefit.schemas.study import FitRecord, FoldsRecord, StudyRecord

RECORDS = {
    "FitRecord": FitRecord,
    "StudyRecord": StudyRecord,
    "FoldsRecord": FoldsRecord,
    "NoiseRecord": NoiseRecord,
    "RecipeRecord": RecipeRecord,
    "SampleRecord": SampleRecord,
    "MarkersRecord": MarkersRecord,
    "ReconstructionEntryRecord": ReconstructionEntryRecord,
    "CenterlineRecord": CenterlineRecord,
    "GuideRecord": GuideRecord,
    "GuideMoveRecord": GuideMoveRecord,
    "RecordingRecord": RecordingRecord,
}


@pytest.mark.parametrize("name", [*RENAMED_KEYS, *REMOVED_KEYS])
def test_former_keys_are_no_keys_of_today_and_their_fixes_name_keys_of_today(name):
    fields = RECORDS[name].model_fields
    renamed, removed = RENAMED_KEYS.get(name, {}), REMOVED_KEYS.get(name, {})
    assert not fields.keys() & {*renamed, *removed} and {*renamed.values()} <= fields.keys()
    for fix in removed.values():
        named = {part.partition(" ")[0] for part in fix.split("`")[1::2]}
        assert named <= fields.keys()


@pytest.mark.parametrize(
    ("kind", "tables", "key", "fix"),
    [
        (StudyRecord, {"reading": "listed"}, "reading", "layer_count_rule"),
        (RecipeRecord, {"schema": 3, "sample": {"moves": "de"}}, "sample.moves", "independent_draws"),
        (DatasetRecord, {"noise": {"correlation": "matern32"}}, "noise.correlation", "correlation_length_mm"),
        (TrackDatasetRecord, {"noise": {"correlation": "exponential"}}, "noise.correlation", "remove"),
        (SceneRecord, {"guides": [{"holds": False}]}, "guides.1.holds", "engaged"),
        (StudyRecord, {"planes": 2}, "planes", "compared"),
    ],
)
def test_a_former_key_is_named_with_what_to_write_now(kind, tables, key, fix):
    error = refusal(ConfigError, f"`{key}`", check, tables, kind, "a.toml")
    assert fix in error.fix and f"`{key}` is unknown" not in error.what
