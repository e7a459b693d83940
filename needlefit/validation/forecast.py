"""Predict a planned insertion from a fit: the needle's true shape, and where it would be measured.

There are two bands. The *needle's* comes from the draws of the parameters, and of the depths of layers
and tip. The *measurement's* adds what a scan of it would err by: the errors that the dataset states of its
points and of the entry pose. Neither knows what the model misses.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Dataset
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.draws import Draws, Source, rms_noise_scale, thin_posterior
from needlefit.inference.fit import Callbacks
from needlefit.inference.forward_model import make_options
from needlefit.inference.importance.fit_posterior import draw_by_importance
from needlefit.inference.likelihood.depths import enforce_order
from needlefit.inference.likelihood.observation import pose_sds
from needlefit.inference.optimize import minimize
from needlefit.inference.predictive_distribution import PredictiveMixture
from needlefit.inference.sampling.posterior import load
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.input_files import convert_stored_errors, is_file
from needlefit.project.json_values import to_json_values
from needlefit.project.random_streams import random_stream
from needlefit.project.result_warnings import ResultWarning
from needlefit.project.run_file import read_run
from needlefit.project.threads import one_thread
from needlefit.schemas.medium import MediumRecord
from needlefit.validation.job import Job, Settings
from needlefit.validation.provenance import describe_configuration
from needlefit.validation.stored import posterior_file_names

Floats = NDArray[np.float64]

FORECAST_POINTS = 101
"""Points of a predicted needle, from entry to tip."""

RIGIDITY_TOLERANCE = 0.02
"""Relative difference of two needles' rigidity from which on they are two needles."""


@dataclass(frozen=True)
class Forecast:
    """A predicted needle in the scene's constraint frame, with its uncertainty.

    Attributes
    ----------
    s : (K,) array
        Arc length from the entry, mm.
    x : (K,) array
        Depth of these points along the entry axis, median over draws, mm.
    needle, measured : Mixture
        Of y at each of them, mm: where the needle is, and where it would be measured.
    source : "posterior" or "importance"
    failed : int
        Draws of which the solve failed; they are left out.
    outside : int
        Draws whose needle is outside what the model assumes; they are kept.
    faults : tuple of str
        Why the posterior of the draws is not to be trusted; empty if it is.
    """

    s: Floats
    x: Floats
    needle: PredictiveMixture
    measured: PredictiveMixture
    source: Source
    failed: int
    outside: int = 0
    faults: tuple[str, ...] = ()


@one_thread
def forecast(scene: Scene, draws: Draws, job: Job) -> Forecast:
    """Predict the needle of a planned insertion.

    The scene says needle, depth, layers' places, bevel side and controls; its moduli and bevel offset are
    replaced by the draws': layer n of the scene is layer n of the medium. With each draw the depths of
    layers and tip are drawn too, as they err in a typical insertion of the dataset.

    Raises
    ------
    ConfigError
        If the scene has more layers than the medium, or another needle than the dataset.
    ModelError
        If no draw can be solved.
    """
    _check(scene, job.medium, job.dataset)
    rng = random_stream(job.recipe.seed, job.name, "forecast")
    s = np.linspace(0.0, scene.depth, FORECAST_POINTS)
    curves = [_solve_curve(scene, job.parameters.values(theta), job, s, rng) for theta in draws.thetas]
    kept = [curve for curve in curves if curve is not None]
    solved = np.array([points for points, _ in kept])  # (B, K, 2)
    if not len(solved):
        raise ModelError(
            f"none of {len(curves)} draws of the parameters can be solved for this scene",
            expected="an insertion that the model can follow",
            fix="look at `needlefit simulate` of the scene; lessen its depth or its deflection",
        )
    y = solved[:, :, 1]
    factor = rms_noise_scale(draws, job.parameters, job.recipe.likelihood.noise_scale)
    return Forecast(
        s=s,
        x=np.median(solved[:, :, 0], axis=0),
        needle=PredictiveMixture(y, np.zeros(len(s))),
        measured=PredictiveMixture(y, factor * _measurement_sd(s, job.dataset)),
        source=draws.source,
        failed=len(curves) - len(solved),
        outside=sum(not valid for _, valid in kept),
        faults=draws.faults,
    )


def outside_warnings(forecast: Forecast) -> Iterator[ResultWarning]:
    """Yield a warning where draws give needles outside the model's range of validity."""
    if forecast.outside:
        yield ResultWarning(
            "validity",
            f"{forecast.outside} of {len(forecast.needle.means)} predicted needles are outside what the "
            "model assumes (slopes, shortening, compression, rounding)",
            fix="read the bands with care; `needlefit simulate` of the scene names what is exceeded",
        )


def _solve_curve(
    scene: Scene, values: Mapping[str, float], job: Job, s: Floats, rng: np.random.Generator
) -> tuple[Floats, bool] | None:
    """Return the points (K, 2) of one draw's needle at arc lengths `s`, and its validity; or None."""
    layers = range(1, scene.tissue.layers + 1)
    typical = [(one.depth_sd, one.boundary_sd) for one in job.dataset.insertions]
    entry_sd, boundary_sd = np.sqrt(np.mean(np.square(typical), axis=0))
    deep, wrong = entry_sd * rng.normal(), boundary_sd * rng.normal(size=scene.tissue.layers - 1)
    tissue = Tissue(
        np.array([values[f"mu{n}_pa"] * 1e-6 for n in layers]),
        np.array([values[f"alpha{n}"] for n in layers]),
        enforce_order(scene.tissue.boundaries + deep + wrong),
        np.array([job.medium.thickness_mm]),
        law=job.medium.law,
    )
    steps = tuple(
        replace(step, depth=step.depth + deep, bevel=replace(step.bevel, offset=values["bevel_mm"]))
        for step in scene.steps
    )
    shape = simulate_steps(scene.needle, tissue, steps, make_options(job.medium))
    return (compute_positions(shape, s + deep), shape.valid) if shape.converged else None


def _measurement_sd(s: Floats, dataset: Dataset) -> Floats:
    """Return the deviation (K,) of a measured y about the needle's, mm; of a typical insertion."""
    noise = dataset.noise
    pose = np.array([pose_sds(one, noise) for one in dataset.insertions])  # (N, 3)
    shift, angle, _ = np.sqrt(np.mean(pose**2, axis=0))  # a shift along hardly moves y
    total: Floats = np.sqrt(noise.point_sd**2 + noise.correlated_sd**2 + shift**2 + (angle * s) ** 2)
    return total


def _check(scene: Scene, medium: MediumRecord, dataset: Dataset) -> None:
    if scene.tissue.layers > medium.layers:
        raise ConfigError(
            f"the scene has {scene.tissue.layers} layers, the fitted medium {medium.layers}",
            expected="at most as many: layer n of the scene is layer n of the medium",
            fix="name a scene of the fitted medium, or fit a medium with more layers",
        )
    ours, fitted = scene.needle.flexural_rigidity, dataset.needle.flexural_rigidity
    if abs(ours - fitted) > RIGIDITY_TOLERANCE * fitted:
        raise ConfigError(
            f"the scene's needle has a flexural rigidity of {ours:.4g} N mm^2, the fitted one {fitted:.4g}",
            expected="the needle that the parameters were fitted with: mu and b depend on it",
            fix="correct [needle] of the scene",
        )


FORECAST_DRAWS = 400
"""Of the parameters, of which a planned needle is predicted."""

(POSTERIOR_FILE,) = posterior_file_names(1)


@one_thread
def draw_parameters(job: Job, run: Path, settings: Settings, required: bool = False) -> Draws | None:
    """Return draws of the posterior stored in the folder `run`, or, if it has none, about a new fit.

    Returns
    -------
    Draws or None
        None where the search was interrupted.

    Raises
    ------
    ConfigError
        If the posterior is of other data or another configuration, or there is none though it is required.
    """
    if is_file(run / POSTERIOR_FILE):
        require_same_configuration(job, run)
        with convert_stored_errors(run / POSTERIOR_FILE):
            return thin_posterior(load(run / POSTERIOR_FILE), job.parameters, FORECAST_DRAWS)
    if required:
        raise ConfigError(
            f"holds no {POSTERIOR_FILE}",
            where=str(run),
            expected="the folder of a run of one fold that was sampled",
            fix="sample it (`needlefit tune TARGET --sample`), or leave --run out",
        )
    (fold,) = job.folds
    problem = job.problem(fold)
    rng = random_stream(job.recipe.seed, job.name, fold.name, "fitted", "starts")
    fit = minimize(problem, job.recipe, rng, Callbacks(stop=settings.stop, jobs=settings.jobs))
    if fit.interrupted:
        return None
    found = draw_by_importance(
        problem, fit, FORECAST_DRAWS, random_stream(job.recipe.seed, job.name, "predict"), settings.jobs
    )
    faults = (*((fit.fault,) if fit.fault else ()), *found.faults)
    return Draws(found.thetas, found.source, faults)


def require_same_configuration(job: Job, run: Path) -> None:
    """Raise ConfigError if the run in a folder has other data or another configuration than `job`."""
    recorded, ours = read_run(run), describe_configuration(job)
    pairs = {key: (recorded.get(key), ours[key]) for key in ("dataset", "medium", "folds")}
    recipe = recorded.get("recipe")
    theirs = recipe.get("likelihood") if isinstance(recipe, dict) else None
    pairs["likelihood"] = (theirs, job.recipe.likelihood.model_dump(mode="json"))
    for key, (found, wanted) in pairs.items():
        if found != to_json_values(wanted):
            raise ConfigError(
                f"its posterior is of another {key}",
                where=str(run),
                expected=f"the {key} that {job.name} names now",
                fix="sample again (`needlefit tune TARGET --sample`), or name the right one with --run",
            )
