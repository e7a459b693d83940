"""Problems of insertions that no study selects, and what insertions of a dataset have in common."""

from needlefit.inference.likelihood.stated_errors import PLAIN_LIKELIHOOD
from needlefit.inference.parameters import Parameters, with_hyperparameters
from needlefit.inference.problem import Problem
from needlefit.schemas.recipe import WeightsRecord

#: of a dataset: what its insertions have in common, along x into one layer
ALONG_X = """[insertions.constants]
medium = "gel"
specimen = "block"
layers = 1
entry_x_mm = 0.0
entry_y_mm = 0.0
entry_z_mm = 0.0
entry_dx = 1.0
entry_dy = 0.0
entry_dz = 0.0
bevel_x = 0.0
bevel_y = 1.0
bevel_z = 0.0
pose_source = "stage"
pose_shift_sd_mm = 0.1
pose_angle_sd_deg = 0.2

[media.gel]
"""


def make_problem(
    dataset,
    insertions,
    medium,
    likelihood=PLAIN_LIKELIHOOD,
    weights=None,
):
    """Return the problem of fitting `medium` to `insertions`; what the medium frees is searched."""
    parameters = with_hyperparameters(Parameters.from_record(medium), likelihood)
    return Problem(
        dataset, tuple(insertions), medium, parameters, weights or WeightsRecord(), likelihood=likelihood
    )
