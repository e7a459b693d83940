"""What a study does with each observation: how insertions that a fold holds out are predicted, and figures.

Each file has the name of its observation in `inference/likelihood/observations/`. What has no file, or no
prediction of its own, is predicted as points along the needle are.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.datasets.select import count_layers, name_holes
from needlefit.grouping import group_values
from needlefit.inference.curve_bands import CurveBands
from needlefit.inference.draws import Draws
from needlefit.inference.likelihood.compared_points import Curve
from needlefit.inference.likelihood.observations import OBSERVATIONS
from needlefit.inference.point_prediction import PointPrediction
from needlefit.inference.predictive_mixture import PredictiveMixture, crps
from needlefit.project.callbacks import Step, no_step
from needlefit.registry import Registry
from needlefit.reporting.figures import Drawing
from needlefit.reporting.table_files import Row
from needlefit.schemas.run_metadata import CountMetadata
from needlefit.studies.fold_draws import Specimens
from needlefit.studies.job import Job
from needlefit.studies.prediction_scores import (
    AFTER_ONE_COLUMN,
    CURVATURE_CRPS,
    SHAPE_CRPS,
    WIDTH_ERROR_COLUMN,
    score_shape,
)
from needlefit.studies.run import Run

#: Of the table "predictive": the distribution of every insertion held out, and how the measurement fell in
#: it. `tip_pit` is the probability predicted of a tip up to the measured one, `shape_pit` that of the
#: smallest simultaneous band that holds the measured shape; `points_in_95`: whether the pointwise band does.
PREDICTIVE_COLUMNS = (
    *("fold", "insertion", "hole", "specimen", "medium", "layers", "depth_mm", "specimen_treatment"),
    *("between_sd_ln_mu", "between_sd_ln_b", "between_correlation", "other_specimens"),
    *(AFTER_ONE_COLUMN, "draw_source", "certified", "draws", "failed_solves", "tip_measured_mm"),
    *("tip_median_mm", "tip_50_low_mm", "tip_50_high_mm", "tip_95_low_mm", "tip_95_high_mm", "tip_pit"),
    *("tip_in_50", "tip_in_95", "tip_crps_mm", "tip_interval_score_mm", "shape_pit", "shape_in_50"),
    *("shape_in_95", "points_in_50", "points_in_95", "shape_crps_mm", WIDTH_ERROR_COLUMN),
)


Tables = Mapping[str, Sequence[Row]]  #: rows of the tables of a run, by their names


@dataclass(frozen=True)
class HeldOutPrediction:
    """The prediction of one insertion: its rows of the tables of a run, by their names.

    Where "errors" is none of them, `curve` is scored as every method's is. `simulations` counts those that
    were solved, one a draw. `point` is which needle is reported, and `curve` that needle in C, mm: None where
    it has no solution, or without bands. `mode` is the needle of the posterior mode, likewise.
    """

    insertion: str
    rows: Tables
    simulations: CountMetadata
    point: PointPrediction | None = None
    curve: Curve | None = None
    mode: Curve | None = None


@dataclass(frozen=True)
class StudiedObservation:
    """What a study does with insertions that were measured alike."""

    name: str  #: of the observation
    #: run, role -> the figures of what was measured so, the one for the first page first; none without any
    draw: Callable[[Run, str], Mapping[str, Drawing]]
    #: parameters of the fold, insertions, whether with bands, step -> a prediction of each that can be made
    predict: Callable[[Specimens, Sequence[Insertion], bool, Step], Iterator[HeldOutPrediction]] | None = None
    #: whether its predictions have their own rows of the table "errors"
    has_errors: bool = False
    #: job, insertion fitted to, the fit's needle -> rows of tables of a run, by their names
    describe_fitted: Callable[[Job, Insertion, Curve], Tables] = lambda job, insertion, curve: {}
    #: raises an error if insertions of a study cannot be fitted to, or predicted
    check: Callable[[Job], None] = lambda job: None


STUDIED = Registry(StudiedObservation, __name__, "observation of a study")


def find_studied(insertion: Insertion) -> StudiedObservation:
    """Return how an insertion is predicted."""
    name = insertion.observation
    return STUDIED[name if name in STUDIED and STUDIED[name].predict else "points"]


def draw_observations(run: Run, role: str) -> dict[str, Drawing]:
    """Return the figures of all that was measured of insertions of a role, those of whole needles first."""
    ordered = sorted(STUDIED.values(), key=lambda studied: studied.name != "points")
    return {name: drawing for studied in ordered for name, drawing in studied.draw(run, role).items()}


def predict_held_out(
    specimens: Specimens, *, bands: bool = False, step: Step = no_step
) -> Iterator[HeldOutPrediction]:
    """Yield the predictions of the insertions that a fold holds out, kind by kind; see the file of each."""
    held = specimens.fold.validate
    groups, done = group_values((find_studied(insertion), insertion) for insertion in held), 0
    for studied, some in groups.items():
        assert studied.predict is not None

        def count(made: int, _: int, done: int = done) -> None:
            step(done + made, len(held))

        yield from studied.predict(specimens, some, bands, count)
        done += len(some)


def describe_held_out(
    specimens: Specimens,
    insertion: Insertion,
    draws: Draws,
    mixture: PredictiveMixture,
    measured: Floats,
    bands: CurveBands,
) -> Row:
    """Return the cells of "predictive" of an insertion, but for its tip.

    By the `draws` that have a solution the numbers `measured` (K,) have the distribution `mixture`, and
    simultaneous `bands`.
    """
    job = specimens.job
    crps_column = SHAPE_CRPS if OBSERVATIONS[insertion.observation].has_tip else CURVATURE_CRPS
    return {
        "fold": specimens.fold.name,
        "insertion": insertion.id,
        "hole": name_holes(job.dataset).get(insertion.id, insertion.id),
        "specimen": insertion.specimen,
        "medium": insertion.medium,
        "layers": count_layers(insertion, job.record.layer_count_rule),
        "depth_mm": insertion.depth,
        "draw_source": draws.source,
        "certified": not draws.faults,
        "draws": len(draws.thetas),
        "failed_solves": len(draws.thetas) - len(mixture.means),
        AFTER_ONE_COLUMN: math.nan,
        **specimens.describe(insertion),
        **score_shape(mixture, measured, bands.pit(measured)),
        crps_column: float(crps(mixture, measured).mean()),
    }
