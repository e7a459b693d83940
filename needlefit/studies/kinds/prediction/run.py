"""A prediction in four steps: what is known of the fit, draws of its parameters, the needle, its warnings."""

import json
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.first_study import describe_scene
from needlefit.datasets.insertion import Insertion, split_boundary_sd
from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.curve_bands import find_bands
from needlefit.inference.draw_simulation import draw_entry_errors, simulate_scene_draws, vary_bevels
from needlefit.inference.draws import Draws, thin_posterior
from needlefit.inference.forward_model import make_options
from needlefit.inference.identifiability.loosened_assumptions import find_model_error
from needlefit.inference.identifiability.profile import minimize_squares
from needlefit.inference.likelihood.pose_errors import draw_rolls, turn_about_x
from needlefit.inference.point_prediction import PointPrediction, choose_point
from needlefit.inference.predictive_mixture import INTERVAL_PROBABILITIES, estimate_end_errors
from needlefit.mechanics.scene import Scene
from needlefit.project.callbacks import no_note
from needlefit.project.checkpoint import NO_CHECKPOINT, Checkpoint, open_checkpoint
from needlefit.project.result_warnings import ResultWarning, to_stored_rows
from needlefit.project.toml import find_named
from needlefit.project.unit_warnings import extrapolation_warnings, scene_warnings
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.run_metadata import PredictionMetadata
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.explorer import choose_drawn
from needlefit.studies.first_page import RunFault, advise, find_fault_kind
from needlefit.studies.fit_warnings import describe_point, write_warning
from needlefit.studies.fold_draws import (
    PREDICTION_DRAWS,
    Specimens,
    choose_specimen,
    draw_fold_parameters,
    measure_prior,
    search_fit,
)
from needlefit.studies.identification import ParameterRow, add_intervals, intervals_of_draws
from needlefit.studies.identity import describe_change, identify
from needlefit.studies.job import Inputs, Job, Settings
from needlefit.studies.kinds.prediction import PredictionRecord
from needlefit.studies.load import begin_run, is_study, prepare_target, prepare_with_held_out
from needlefit.studies.report import find_report, recall
from needlefit.studies.run import Run, posterior_file_names, restore_run

# ---- the needle for all draws of the parameters, its intervals and bands

FORECAST_POINTS = 101  #: number of points of a predicted needle, from entry to tip
NEAR_DRAWS = 20  #: number of draws of which the one nearest to the median is chosen

#: parts of the names of columns: along y, and z
AXES = ("", "z_")


@dataclass(frozen=True)
class Forecast:
    """A predicted needle in the scene's constraint frame, with its uncertainty."""

    s: Floats  #: (K,), arc length from the entry, mm
    needle: Floats  #: (K, 3), the predicted needle, mm
    across: Floats  #: (B, K, 1), in space (B, K, 2): y, and z, of each draw that has a solution, mm
    failed: int  #: draws of which the solve failed; they are left out
    outside: int  #: draws whose needle is outside what the model assumes; they are kept
    point: PointPrediction  #: which needle is predicted
    mode: Mapping[str, float]  #: the parameters of the posterior mode
    nearest: Mapping[str, float] | None  #: of the draw whose tip is nearest to a median
    sets: Sequence[Mapping[str, float]]  #: parameters of all draws, each with a bevel of its own


def tabulate_forecast(forecast: Forecast) -> pd.DataFrame:
    """Return one row per station, mm: s and x, then y, in space z, its intervals and bands."""
    columns = {"s_mm": forecast.s, "x_mm": forecast.needle[:, 0]}
    count, points, directions = forecast.across.shape
    bands = find_bands(forecast.across.transpose(0, 2, 1).reshape(count, -1))  # over y and z together
    for n, axis in enumerate(AXES[:directions]):
        columns[f"needle_{axis}predicted_mm"] = forecast.needle[:, 1 + n]
        for level in INTERVAL_PROBABILITIES:
            pointwise = np.quantile(forecast.across[..., n], [(1 - level) / 2, (1 + level) / 2], axis=0)
            whole = (end.reshape(directions, points)[n] for end in bands.ends(level))
            errors = estimate_end_errors(forecast.across[..., n], level)
            for part, unit, ends in (
                ("needle", "mm", pointwise),
                ("needle", "error_mm", errors),
                ("band", "mm", whole),
            ):
                named = (f"{part}_{axis}{100 * level:.0f}_{end}_{unit}" for end in ("low", "high"))
                columns |= dict(zip(named, ends, strict=True))
    return pd.DataFrame(columns)


def forecast(scene: Scene, specimens: Specimens, into: Insertion | None) -> Forecast:
    """Predict the needle of a planned insertion.

    The scene is under the rules of the fit (`make_scene`); draws replace its moduli and bevel offset: layer n
    of the scene is layer n of the medium. With each draw a bevel of this insertion and the depths of layers
    and tip are drawn too, in space also the roll, as they err in a typical insertion of the dataset. The
    specimen is that of the insertion `into`, or, with None, one that is not in the dataset. Where it has no
    draws of its own, those of all insertions together stand in.

    Raises ModelError if no draw can be solved, or the mode cannot.
    """
    job, draws, mode = specimens.job, specimens.draws_in(into), specimens.mode_in(into)
    thetas = draws.thetas if len(draws.thetas) else specimens.draws.thetas
    assert mode is not None
    rng = job.random(job.name, "forecast")
    s = np.linspace(0.0, scene.depth, FORECAST_POINTS)
    sets = vary_bevels([job.parameters.values(theta) for theta in thetas], specimens.bevel_sd_in(into), rng)
    typical = [
        (insertion.depth_sd, np.hypot(*split_boundary_sd(insertion))) for insertion in job.dataset.insertions
    ]
    entry_sd, boundary_sd = np.sqrt(np.mean(np.square(typical), axis=0))
    deep = draw_entry_errors(entry_sd, len(sets), rng)
    wrong = boundary_sd * rng.standard_normal((len(sets), scene.tissue.layers - 1))
    drawn = simulate_scene_draws(sets, job.medium, scene, s, deep, wrong)
    points = drawn.points[drawn.solved]  # (B, K, 3)

    def simulate(values: Mapping[str, float]) -> Floats:
        """Return the needle (K, 3) of one set of values at the depths as they are stated."""
        exact = np.zeros((1, scene.tissue.layers))
        (simulated,) = simulate_scene_draws([values], job.medium, scene, s, exact[:, 0], exact[:, 1:]).points
        return simulated

    needle = simulate(job.parameters.values(mode))
    if not (len(points) and np.isfinite(needle).all()):
        raise ModelError(
            f"{len(points)} of {len(thetas)} draws of the parameters can be solved for this scene, and "
            f"{'not ' * bool(len(points))}their mode",
            fix="look at `needlefit simulate` of the scene; lessen its depth or its deflection",
        )
    outside = int(np.sum(~drawn.valid[drawn.solved]))
    directions = max(job.dataset.directions, 1 + int(points[..., 2].any()))
    roll_sd = math.sqrt(np.mean([insertion.roll_sd**2 for insertion in job.dataset.insertions]))
    points = turn_about_x(points, draw_rolls(roll_sd, directions, len(points), rng))
    compared, point = slice(1, 1 + directions), PointPrediction()
    if not draws.faults:
        problem = job.problem(specimens.fold)
        point = choose_point(
            problem, mode, points[..., compared], lambda theta: simulate(problem.values(theta))[:, compared]
        )
    needle, nearest = point.take(needle, points), None
    if point.is_median:
        away = np.linalg.norm(points[:, -1] - needle[-1], axis=1)
        near = np.flatnonzero(drawn.solved)[np.argsort(away)[:NEAR_DRAWS]]
        nearest = min(
            (sets[n] for n in near), key=lambda values: np.linalg.norm(simulate(values)[-1] - needle[-1])
        )
    return Forecast(
        s,
        needle,
        points[..., compared],
        failed=len(thetas) - len(points),
        outside=outside,
        point=point,
        mode=job.parameters.values(mode),
        nearest=nearest,
        sets=sets,
    )


# ---- the scene: like the deepest fitted insertion, and under the rules of the fit

RIGIDITY_TOLERANCE = 0.02  #: smallest relative difference of the rigidities of two different needles


def describe_like_deepest(
    fit: FitRecord, inputs: Inputs, medium: MediumRecord
) -> tuple[str, dict[str, Any], Path]:
    """Return the deepest insertion of a fit: its id, the keys of a scene like it, the file of the dataset.

    Raises ConfigError or DataError if the data of the fit are missing or wrong.
    """
    dataset = inputs.dataset or read(find_named("dataset", fit.dataset))
    fitted = select_insertions(dataset, fit.tune, fit.layer_count_rule)
    deepest = max(fitted, key=lambda insertion: insertion.depth)
    return deepest.id, describe_scene(dataset, deepest, medium.advance), dataset.path


#: pattern of keys of a scene whose values the draws replace
_REPLACED = re.compile(
    r"(layers\.\d+\.(mu_pa|alpha|shape(\.\w+)?)|(bevel|steps\.\d+)\.(offset_mm|cut_angle_deg))$"
)
#: rules under which parameters mean what they do: those of a fit are of no use under others
_FITTED_RULES = ("advance", "constraint_spacing_mm", "constraint_switch", "tangent_part")


def make_scene(record: SceneRecord, where: str, medium: MediumRecord, changed: Sequence[str] = ()) -> Scene:
    """Return a planned insertion under the rules of the fit, with the lattice that the scene states.

    `where`: named in errors. `changed`: dotted keys that the user changed in the scene.

    Raises ConfigError if the scene states what the fit does not have, or the user changed what the draws
    replace.
    """
    _require_fitted_rules(record, where, medium)
    dropped = [key for key in changed if _REPLACED.match(key)]
    for n, step in enumerate(record.steps, start=1):
        given = (key for key in ("offset_mm", "cut_angle_deg") if getattr(step, key) is not None)
        dropped += [f"steps.{n}.{key}" for key in given]
    if dropped:
        raise ConfigError(
            f"{', '.join(f'`{key}`' for key in dict.fromkeys(dropped))} would have no effect: draws take "
            "its place",
            where=where,
            expected="needle, depth, depths of layers, bevel side, controls",
            fix="leave it out; `needlefit simulate` takes all values from the scene",
        )
    scene = Scene.from_record(record, where)
    options, stated = make_options(medium), record.rules
    if "element_mm" in stated.model_fields_set:
        options = replace(options, element=stated.element)
    if "first_cell_mm" in stated.model_fields_set:
        options = replace(options, first_cell=stated.first_cell_mm)
    return replace(scene, rules=options)


def _require_fitted_rules(record: SceneRecord, where: str, medium: MediumRecord) -> None:
    """Raise ConfigError where a scene states another rule, law, thickness or friction than the fit used."""
    rules = record.rules
    stated: dict[str, tuple[object, object]] = {
        f"rules.{key}": (getattr(rules, key), getattr(medium, key))
        for key in _FITTED_RULES
        if key in rules.model_fields_set
    }
    for key in ("law", "torsional_friction_n"):
        if key in record.model_fields_set:
            stated[key] = getattr(record, key), getattr(medium, key)
    for n, layer in enumerate(record.layers, start=1):
        stated[f"layers.{n}.friction"] = layer.friction, 0.0
        if "thickness_mm" in layer.model_fields_set:
            stated[f"layers.{n}.thickness_mm"] = layer.thickness_mm, medium.thickness_mm
    for key, (value, fitted) in stated.items():
        if value != fitted:
            raise ConfigError(
                f"`{key}` is {json.dumps(value)}, but the parameters were fitted with {json.dumps(fitted)}",
                where=where,
                expected=f"{json.dumps(fitted)}",
                fix=f"leave `{key}` out, or fit a tissue model with {json.dumps(value)}",
            )


def require_fitted_kind(scene: Scene, job: Job) -> None:
    """Raise ConfigError if a scene has more layers than the medium of a fit, or another needle."""
    if scene.tissue.layers > job.medium.layers:
        raise ConfigError(
            f"the scene has {scene.tissue.layers} layers, the fitted medium {job.medium.layers}",
            expected="at most as many",
            fix="name a scene of the fitted medium",
        )
    ours = scene.needle.flexural_rigidity
    fitted = dict.fromkeys(insertion.needle.flexural_rigidity for insertion in job.insertions)
    if all(abs(ours - rigidity) > RIGIDITY_TOLERANCE * rigidity for rigidity in fitted):
        stated = " or ".join(f"{rigidity:.4g}" for rigidity in fitted)
        raise ConfigError(
            f"the scene's needle has a flexural rigidity of {ours:.4g} N mm^2, the fitted one {stated}",
            expected="the needle that the parameters were fitted with",
            fix="correct [needle] of the scene",
        )


# ---- the run

(POSTERIOR_FILE,) = posterior_file_names(1)

#: advice on a fit with which it may be used all the same
MAY_BE_USED = ("predictable", "parameters_undetermined")

FRAMES: Mapping[str, tuple[str, ...]] = {
    "parameters": ParameterRow._fields,  # of the fit
    # a row per point: arc length from the entry, depth along the entry axis, y of the needle, ends of its
    # pointwise intervals ("needle") and of simultaneous bands ("band")
    "forecast": (
        *("s_mm", "x_mm", "needle_predicted_mm"),
        *(
            f"{part}_{level}_{end}_mm"
            for part in ("needle", "band")
            for level in ("50", "95")
            for end in ("low", "high")
        ),
    ),
}


def draw_parameters(
    job: Job, run: Run | None, settings: Settings, checkpoint: Checkpoint = NO_CHECKPOINT
) -> Draws | None:
    """Return draws of the posterior of a run of this fit, or without one about a new fit.

    None after a stop.
    """
    posterior = settings.inputs.posterior if run is None else run.posterior
    (fold,) = job.folds
    if posterior is not None:  # whose mode is the minimum to which its best draw leads
        best = dict(zip(posterior.names, posterior.best.tolist(), strict=True))
        begin = job.parameters.restrict(job.parameters.theta(best))
        mode = job.parameters.extend(minimize_squares(job.problem(fold).searched, begin).theta)
        return replace(thin_posterior(posterior, job.parameters, PREDICTION_DRAWS), mode=mode)
    fit = search_fit(job, fold, "fitted", settings, checkpoint)
    if fit.interrupted:
        return None
    draws = draw_fold_parameters(job, fold, fit, settings).draws
    # without a search that has converged nothing is certified
    judged = replace(draws, faults=(fit.fault, *draws.faults)) if fit.fault else draws
    return None if settings.stop() else judged


class _Known(NamedTuple):
    """What earlier results give to a prediction: a posterior, a verdict; warnings about what is not used."""

    sampled: Run | None
    judged: Run | None
    warnings: list[ResultWarning]


def _find_known(record: PredictionRecord, job: Job, settings: Settings) -> _Known:
    """Return the results of the fit; those of another one, or of earlier versions, are not used."""
    inputs, run_warnings = settings.inputs, list[ResultWarning]()
    if inputs.target is not None:  # a run, from which the job was made
        return _Known(None, inputs.judged, run_warnings)
    sampled = None if record.posterior is None else restore_run(Path(record.posterior))
    if sampled is not None and (changed := describe_change(sampled.metadata.identity, identify(job))):
        problem = f"the posterior of {sampled.name} is not used; changed since: {changed}"
        run_warnings.append(_warn("tune", record.target, problem))
        sampled = None
    if (judged := inputs.judged) is None:
        return _Known(sampled, sampled, run_warnings)
    quiet = replace(settings, note=no_note, inputs=Inputs(dataset=job.measured))
    study = prepare_with_held_out(record, job.name, quiet)
    if changed := describe_change(judged.metadata.identity, identify(study)):
        problem = f"the verdict of {judged.name} is not repeated; changed since: {changed}"
        command = "validate" if judged.kind == "cross_validation" else "tune"
        run_warnings.append(_warn(command, record.target, problem))
        judged = None
    return _Known(sampled, judged, run_warnings)


def _warn(command: str, target: str, problem: str) -> ResultWarning:
    return ResultWarning(
        "data_changed", problem, fix=f"renew it: {shlex.join(('needlefit', command, target))}"
    )


def list_parameters(job: Job, draws: Draws, mode: Mapping[str, float], judged: Run | None) -> pd.DataFrame:
    """Return the parameters and their 95 % intervals: of an earlier result of this fit, else of the draws."""
    if judged is not None and judged.frames["parameters"]["fold"].nunique() == 1:
        return judged.frames["parameters"][list(ParameterRow._fields)]
    parameters, (fold,) = job.parameters, job.folds
    rows = [
        ParameterRow(
            fold.name, "fitted", name, value, parameters.status[name], *parameters.bounds.get(name, ())
        )
        for name, value in mode.items()
    ]
    problem = job.problem(fold).searched
    model_error = find_model_error(problem, problem.parameters.theta(mode))
    intervals = intervals_of_draws(parameters, draws, None)
    rows, _ = add_intervals(rows, [], intervals, parameters.ties, {}, model_error)
    return pd.DataFrame(rows, columns=list(ParameterRow._fields))


def run(name: str, record: PredictionRecord, settings: Settings) -> Run:
    """Predict the planned insertion of a record.

    Raises ConfigError or DataError if anything the record names is missing or wrong, or its posterior is of
    something else. ModelError if no draw can be solved.
    """
    job = prepare_target(record, settings)
    scene = make_scene(record.scene, record.scene_name, job.medium)
    scene_name = record.scene_name.rpartition("/")[2]
    title = record.scene.title or scene_name
    specimens = Specimens(job, job.folds[0], jobs=settings.jobs)
    where = record.specimen or ("new" if job.record.specimens == "others" else "training only")
    if record.specimen is None and job.record.same_specimen and not specimens.separate:
        where = "same"
    into = choose_specimen(specimens, where)
    about = begin_run(name, record, job, f"Prediction: {title}")
    require_fitted_kind(scene, job)
    sampled, judged, changed = _find_known(record, job, settings)
    checkpoint = open_checkpoint(settings.checkpoint, settings.resume, about.metadata.work, settings.note)
    for change in changed:
        settings.note(f"warning: {change} ({change.help_command})")  # before the work, which takes long
    fitted = draw_parameters(job, sampled, settings, checkpoint)
    if fitted is None:
        return replace(about, interrupted=True)
    if shifts := measure_prior(job, job.folds[0], fitted.thetas):
        job = job.holding([held for held, shift in shifts.items() if shift.is_hidden])
    specimens = replace(specimens, job=job, draws=fitted)
    draws = specimens.draws_in(into)
    forecasted = forecast(scene, specimens, into)
    needle = tabulate_forecast(forecasted).assign(scene=title, converged=not draws.faults)
    warned = [*job.warnings, *changed, *scene_warnings(record.scene, record.scene_name)]
    if forecasted.outside:
        share = f"{forecasted.outside} of {len(forecasted.across)} predicted needles"
        problem = f"{share} are outside what the model assumes (slopes, shortening, compression)"
        warned.append(ResultWarning("validity", problem, fix="read its intervals with care"))
    depths = [insertion.depth for insertion in job.folds[0].tune]
    z_unfitted = forecasted.across.shape[2] > job.dataset.directions
    warned += extrapolation_warnings(scene.depth, depths, z_unfitted=z_unfitted)
    chosen = describe_point(forecasted.point, job.parameters)
    if forecasted.point.is_median:
        warned.append(write_warning("predictive_median", {**chosen, "text": "median_of_scene"}))
    if draws.faults:
        needle.loc[:, needle.columns.str.contains("_low_|_high_")] = np.nan
    named = {"scene_name": scene_name, "posterior": record.posterior and Path(record.posterior).name}
    return replace(
        about,
        record=about.record.model_copy(update=named),
        frames={
            "forecast": needle,
            "parameters": list_parameters(
                job, specimens.replace_mean(fitted), forecasted.mode, sampled or judged
            ),
        },
        metadata=about.metadata.extend(
            PredictionMetadata,
            study=about.metadata.study | named,
            draw_source=draws.source,
            pareto_k=draws.pareto_k,
            ess=draws.effective_sample_size,
            draws=len(forecasted.across),
            specimen="others" if into is None else where,
            fit_verdict=None if judged is None else recall(judged),
            fit_run=None if judged is None else judged.name,
            fit_changed=changed[-1].what if changed else "",
            fit_advice=None if judged is None else _recall_advice(judged),
            held_out_by_target=settings.inputs.target is None and is_study(record.target),
            failed_solves=forecasted.failed,
            outside_validity=forecasted.outside,
            not_converged=list(draws.faults),
            mode=dict(forecasted.mode),
            nearest=forecasted.nearest and dict(forecasted.nearest),
            **chosen,
            drawn=None if draws.faults else choose_drawn(forecasted.sets),
            warnings=to_stored_rows(warned),
        ),
        faults=tuple(RunFault(find_fault_kind(draws), words) for words in draws.faults),
    )


def _recall_advice(judged: Run) -> dict[str, Any] | None:
    """Return what a fit needs before its predictions are used; None if it may be used."""
    advice = find_report(judged).first_page(judged).advice
    if advice is None or advice.finding in MAY_BE_USED:
        advice = advise(["fit_untested"], {}) if judged.kind == "fit" else None
    return None if advice is None else asdict(advice)
