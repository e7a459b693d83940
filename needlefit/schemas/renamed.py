"""Keys of TOML files, and inputs of recordings, that have another name today, by the record that holds them.

A file with an earlier key is refused with the new name; `needlefit migrate` rewrites it. Never change a line
here: add one.
"""

from collections.abc import Mapping
from types import MappingProxyType

from pydantic import BaseModel

RENAMED_KEYS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "FitRecord": {"reading": "layer_count_rule", "hand_tuned": "paper_parameters"},
        "TunedAnalysisRecord": {"reading": "layer_count_rule", "hand_tuned": "paper_parameters"},
        "AdaptationRecord": {"reading": "layer_count_rule", "between": "between_media"},
        "ComparisonRecord": {
            "reading": "layer_count_rule",
            "made": "synthetic",
            "must_win": "positive_control",
        },
        "SeedsRecord": {"generalising": "generalization_studies", "first": "first_seed"},
        "VariationRecord": {"of": "factor"},
        "PlanRecord": {"like": "template_insertion", "entrance": "entry_plane"},
        "EntryPlaneRecord": {"place_mm": "position_mm"},
        "NextInsertionRecord": {"like": "template_insertion"},
        "CandidateEntryRecord": {"place_mm": "position_mm", "bending": "bending_direction"},
        "TrackStudyRecord": {"observes": "observable", "placed_by_mm": "registration_depth_mm"},
        "SampleRecord": {"every": "check_interval"},
        "MarkersRecord": {"known_sd_mm": "reference_sd_mm"},
        "ReconstructionEntryRecord": {"bend_mm": "entry_shift_sd_mm", "bend_deg": "entry_tilt_sd_deg"},
        "CenterlineRecord": {
            "station_mm": "station_spacing_mm",
            "knot_mm": "knot_spacing_mm",
            "patch_mm": "patch_width_mm",
        },
        "GuideRecord": {"holds": "engaged"},
        "GuideMoveRecord": {"holds": "engaged"},
        "RecordingRecord": {"subject": "target"},
    }
)
"""Earlier key -> key of today."""

RENAMED_INPUTS: Mapping[str, str] = MappingProxyType({"guide_holds": "guide_engaged"})
"""Inputs in the rows of a recording."""


def earlier_keys(kind: type[BaseModel]) -> dict[str, str]:
    """Return the keys of a record that had another name, those of its base classes among them."""
    return {
        old: new
        for base in reversed(kind.__mro__)
        for old, new in RENAMED_KEYS.get(base.__name__, {}).items()
    }
