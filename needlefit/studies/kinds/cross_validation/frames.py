"""The tables of a fit or cross-validation: each has at least the columns that its maker declares."""

from collections.abc import Mapping
from types import MappingProxyType

from needlefit.studies.fold_draws import DRAW_COLUMNS, POPULATION_COLUMNS
from needlefit.studies.identification import IDENTIFICATION_COLUMNS, PROFILE_COLUMNS, ParameterRow
from needlefit.studies.kinds.cross_validation.rows import DIRECTION_COLUMNS, ERROR_FIT_COLUMNS, START_COLUMNS
from needlefit.studies.needle_placement import NEEDLE_COLUMNS
from needlefit.studies.observations import PREDICTIVE_COLUMNS
from needlefit.studies.observations.tip_track import END_COLUMNS, READING_COLUMNS
from needlefit.studies.prediction_scores import BAND_COLUMNS, SENSOR_COLUMNS
from needlefit.studies.score import ERROR_COLUMNS, SHAPE_COLUMNS

FRAMES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "errors": ERROR_COLUMNS,
        "shapes": SHAPE_COLUMNS,
        "starts": START_COLUMNS,
        "parameters": ParameterRow._fields,
        "error_fit": ERROR_FIT_COLUMNS,
        "directions": DIRECTION_COLUMNS,
        "identification": IDENTIFICATION_COLUMNS,
        "profiles": PROFILE_COLUMNS,
        "predictive": PREDICTIVE_COLUMNS,
        "bands": BAND_COLUMNS,
        "curvature": SENSOR_COLUMNS,
        "readings": READING_COLUMNS,
        "ends": END_COLUMNS,
        "draws": DRAW_COLUMNS,
        "population": POPULATION_COLUMNS,
        "needles": NEEDLE_COLUMNS,
    }
)
