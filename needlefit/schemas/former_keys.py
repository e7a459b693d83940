"""Keys of TOML files that earlier versions had, by the record that held them, and what to write now.

A file with such a key is refused: this table gives the error its fix. Never change a line; add one.
"""

from collections.abc import Mapping
from types import MappingProxyType

from pydantic import BaseModel

# Former key -> key of today, with the same value.
RENAMED_KEYS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "FitRecord": {"reading": "layer_count_rule", "hand_tuned": "paper_parameters"},
        "StudyRecord": {"placed_by_mm": "registration_depth_mm", "fits": "folds"},
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

_SEARCH = "remove it: a fit always searches by least squares; `starts` and `evaluations` are its length"
_SAMPLER = "remove it; write `independent_draws` (how many are wanted) and `densities` (computed at most)"

_PLANES = 'write `compared = "plane"` in place of 1, `compared = "space"` in place of 2'

# Former key that no other one replaces -> what to do.
REMOVED_KEYS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "NoiseRecord": {
            "correlation": "remove it: the error that neighbouring points share falls exponentially, "
            "over `correlation_length_mm`"
        },
        "StudyRecord": dict.fromkeys(
            ("observable", "observes"), "remove it: the dataset states what was measured"
        ),
        "FoldsRecord": dict.fromkeys(("medium", "planes", "priors"), "state it once, before [[folds]]"),
        "RecipeRecord": {
            "algorithm": _SEARCH,
            "approach": _SEARCH,
            "metric_algorithm": "remove it: `metric = true` is enough",
        },
        "FitRecord": {"planes": _PLANES},
        "SampleRecord": dict.fromkeys(
            ("ensembles", "moves", "steps", "burn_in", "every", "check_interval"), _SAMPLER
        ),
    }
)


def find_former_key(kind: type[BaseModel], key: str) -> str:
    """Return what to write now for a former key of a record; "" for any other key."""
    for base in kind.__mro__:
        if new := RENAMED_KEYS.get(base.__name__, {}).get(key):
            return f"write `{new}`"
        if fix := REMOVED_KEYS.get(base.__name__, {}).get(key):
            return fix
    return ""
