"""Where a planned needle will be: draws of the parameters, simulated in a scene.

There are two bands. The *needle's* comes from the draws of the parameters, of a bevel for each insertion, and
of the depths of layers and tip. The *measurement's* adds what a scan of it would err by: the errors that the
dataset states of its points and of the entry pose. Neither includes model error.

In a specimen that was not tuned on the parameters differ (`new_specimens`). What that adds stands beside the
width that would be left in the specimen tuned on, and after one insertion into the new one.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Dataset, split_boundary_sd
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.forward_model import make_bevel, make_options
from needlefit.inference.likelihood.nodes import enforce_order
from needlefit.inference.likelihood.observation import pose_sds
from needlefit.inference.predict import (
    INTERVAL_PROBABILITIES,
    Draws,
    PredictiveMixture,
    quantile,
    rms_noise_scale,
)
from needlefit.mechanics.control import ModelOptions, Step
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.needle import Needle
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.random_streams import random_stream
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.studies.interval_width import estimate_width_after_one, measure_width
from needlefit.studies.job import Job
from needlefit.studies.new_specimens import NewSpecimens, describe_specimen
from needlefit.studies.planned_draws import PlannedNeedles, vary_bevels
from needlefit.studies.score import Row

FORECAST_POINTS = 101
"""Points of a predicted needle, from entry to tip."""

RIGIDITY_TOLERANCE = 0.02
"""Relative difference of two needles' rigidity from which on they are two needles."""

BANDS = ("needle", "measured")
"""Where the needle is, and where it would be measured."""

SPECIMEN_COLUMNS = (
    *("specimen_treatment", "between_sd_ln_mu", "between_sd_ln_b", "other_specimens"),
    "tip_95_width_mm",
)
"""The first row is what is predicted, the others what would be left of its width."""


@dataclass(frozen=True)
class Forecast:
    """A predicted needle in the scene's constraint frame, with its uncertainty.

    Attributes
    ----------
    s : (K,) array
        Arc length from the entry, mm.
    x : (K,) array
        Depth of these points along the entry axis, median over draws, mm.
    needle, measured : PredictiveMixture
        Of y at each of them, mm: where the needle is, and where it would be measured.
    failed : int
        Draws of which the solve failed; they are left out.
    outside : int
        Draws whose needle is outside what the model assumes; they are kept.
    specimens : tuple of Row
        Rows of `SPECIMEN_COLUMNS`.
    """

    s: Floats
    x: Floats
    needle: PredictiveMixture
    measured: PredictiveMixture
    failed: int
    outside: int
    specimens: tuple[Row, ...]


def tabulate_forecast(forecast: Forecast) -> pd.DataFrame:
    """Return one row per station: s and x, then median and ends of the bands of y, all mm."""
    columns = {"s_mm": forecast.s, "x_mm": forecast.x}
    for name in BANDS:
        mixture: PredictiveMixture = getattr(forecast, name)
        columns[f"{name}_median_mm"] = _find_quantile(mixture, 0.5)
        for level in INTERVAL_PROBABILITIES:
            columns[f"{name}_{100 * level:.0f}_low_mm"] = _find_quantile(mixture, (1 - level) / 2)
            columns[f"{name}_{100 * level:.0f}_high_mm"] = _find_quantile(mixture, (1 + level) / 2)
    return pd.DataFrame(columns)


def _find_quantile(mixture: PredictiveMixture, p: float) -> Floats:
    """Return the quantiles (K,) of probability `p`, mm."""
    if mixture.sd.any():
        return quantile(mixture, p)
    # the CDF of draws without errors is a step function: between two draws its inverse is not unique, and
    # in the sparse tail of a skewed posterior an arbitrary value there can lie outside the measured band
    found: Floats = np.quantile(mixture.means, p, axis=0)
    return found


_REPLACED = re.compile(
    r"(layers\.\d+\.(mu_pa|alpha|shape(\.\w+)?)|(bevel|steps\.\d+)\.(offset_mm|cut_angle_deg))$"
)
"""Keys of a scene whose values the draws replace."""

_FITTED_RULES = ("advance", "constraint_spacing_mm", "constraint_switch", "tangent_part")
"""Rules under which parameters mean what they do: those of a fit are of no use under others."""


def make_scene(record: SceneRecord, where: str, medium: MediumRecord, changed: Sequence[str] = ()) -> Scene:
    """Return a planned insertion under the rules of the fit, with the lattice that the scene states.

    Parameters
    ----------
    where : str
        Named in errors.
    changed : sequence of str
        Dotted keys that the user changed in the scene.

    Raises
    ------
    ConfigError
        If the scene states what the fit does not have, or the user changed what the draws replace.
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
    scene, options, stated = Scene.from_record(record, where), make_options(medium), record.rules
    if "element_mm" in stated.model_fields_set:
        options = replace(options, element=stated.element)
    if "first_cell_mm" in stated.model_fields_set:
        options = replace(options, first_cell=stated.first_cell_mm)
    return replace(scene, rules=options)


def _require_fitted_rules(record: SceneRecord, where: str, medium: MediumRecord) -> None:
    """Raise ConfigError where a scene states another rule, law or thickness than the fit used."""
    rules, layers = record.rules, list(enumerate(record.layers, start=1))
    stated = [(f"rules.{key}", key, getattr(rules, key)) for key in rules.model_fields_set & {*_FITTED_RULES}]
    stated += [("law", "law", record.law)] if "law" in record.model_fields_set else []
    stated += [
        (f"layers.{n}.thickness_mm", "thickness_mm", layer.thickness_mm)
        for n, layer in layers
        if "thickness_mm" in layer.model_fields_set
    ]
    for key, name, value in sorted(stated):
        fitted = getattr(medium, name)
        if value != fitted:
            raise ConfigError(
                f"`{key}` is {json.dumps(value)}, but the parameters were fitted with {json.dumps(fitted)}",
                where=where,
                expected=f"{json.dumps(fitted)}: fitted parameters hold for this value alone",
                fix=f"leave `{key}` out, or fit a tissue model with `{name} = {json.dumps(value)}`",
            )
    for n, layer in layers:
        if layer.friction:
            raise ConfigError(
                f"`layers.{n}.friction` is {layer.friction:g}, but the fit was made without friction",
                where=where,
                expected="0",
                fix=f"leave `layers.{n}.friction` out",
            )


def forecast(
    scene: Scene, draws: Draws, job: Job, new: NewSpecimens | None = None, otherwise: str = "same"
) -> Forecast:
    """Predict the needle of a planned insertion.

    The scene says needle, depth, layers' places, bevel side and controls, under the rules of the fit
    (`make_scene`); its moduli and bevel offset are replaced by the draws': layer n of the scene is layer n of
    the medium. With each draw a bevel of this insertion and the depths of layers and tip are drawn too, as
    they err in a typical insertion of the dataset. With `new` the insertion goes into a specimen that is not
    in the dataset; without, `otherwise` is what its specimen is called.

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
    thetas = draws.thetas if new is None else new.move(draws.thetas, None, rng)
    found = _simulate_draws(scene, thetas, job, s, rng)
    points = found.points[found.solved]  # (B, K, 2)
    if not len(points):
        raise ModelError(
            f"none of {len(thetas)} draws of the parameters can be solved for this scene",
            expected="an insertion that the model can follow",
            fix="look at `needlefit simulate` of the scene; lessen its depth or its deflection",
        )
    sd = _measurement_sd(
        s, job.dataset, rms_noise_scale(draws, job.parameters, job.recipe.likelihood.noise_scale)
    )
    tips = found.points[:, -1, 1]
    rows = [describe_specimen(new, None, otherwise) | {"tip_95_width_mm": measure_width(tips)}]
    if new is not None:
        again, same = (
            _simulate_draws(scene, some, job, s, rng).points[:, -1, 1] for some in (thetas, draws.thetas)
        )
        known = tips + sd[-1] * rng.standard_normal(len(tips))
        left = {"one insertion": estimate_width_after_one(again, known), "same": measure_width(same)}
        rows += [
            describe_specimen(None, None, name) | {"tip_95_width_mm": width} for name, width in left.items()
        ]
    return Forecast(
        s=s,
        x=np.median(points[:, :, 0], axis=0),
        needle=PredictiveMixture(points[:, :, 1], np.zeros(len(s))),
        measured=PredictiveMixture(points[:, :, 1], sd),
        failed=len(thetas) - len(points),
        outside=int(np.sum(~found.valid[found.solved])),
        specimens=tuple(rows),
    )


def _simulate_draws(
    scene: Scene, thetas: Floats, job: Job, s: Floats, rng: np.random.Generator
) -> PlannedNeedles:
    """Return the needles of parameters (B, P) at arc lengths `s` (K,), each of its own bevel and depths."""
    new_bevel_sd = job.problem(job.folds[0]).new_bevel_sd
    sets = vary_bevels([job.parameters.values(theta) for theta in thetas], new_bevel_sd, rng)
    typical = [(one.depth_sd, np.hypot(*split_boundary_sd(one))) for one in job.dataset.insertions]
    entry_sd, boundary_sd = np.sqrt(np.mean(np.square(typical), axis=0))
    deep = entry_sd * rng.standard_normal(len(sets))
    wrong = boundary_sd * rng.standard_normal((len(sets), scene.tissue.layers - 1))
    points, valid = np.full((len(sets), len(s), 2), np.nan), np.zeros(len(sets), dtype=np.bool_)
    for n, values in enumerate(sets):
        shape = simulate_steps(*_make_inputs(scene, values, job, float(deep[n]), wrong[n]))
        if shape.converged:
            points[n], valid[n] = compute_positions(shape, s + deep[n]), shape.valid
    return PlannedNeedles(points, valid)


def _make_inputs(
    scene: Scene, values: Mapping[str, float], job: Job, deep: float, wrong: Floats
) -> tuple[Needle, Tissue, tuple[Step, ...], ModelOptions]:
    """Return the arguments of `simulate_steps` with the errors of one draw, mm."""
    layers = range(1, scene.tissue.layers + 1)
    tissue = Tissue(
        np.array([values[f"mu{n}_pa"] * 1e-6 for n in layers]),
        [[values[name] for name in row] for row in LAWS[job.medium.law].name_shape(layers)],
        enforce_order(scene.tissue.boundaries + deep + wrong),
        np.array([job.medium.thickness_mm]),
        law=job.medium.law,
    )
    steps = tuple(
        replace(step, depth=step.depth + deep, bevel=make_bevel(values, job.medium, step.bevel.side))
        for step in scene.steps
    )
    return scene.needle, tissue, steps, scene.rules


def _measurement_sd(s: Floats, dataset: Dataset, scale: float) -> Floats:
    """Return the deviation (K,) of a measured y about the needle's, mm; of a typical insertion.

    The scale of the noise is none of the pose.
    """
    noise = dataset.noise
    pose = np.array([pose_sds(one, noise) for one in dataset.insertions])  # (N, 3)
    shift, angle, _ = np.sqrt(np.mean(pose**2, axis=0))  # a shift along hardly moves y
    stated = [
        noise.correlated_sd**2 if one.sd is None else float(np.mean(one.sd**2)) for one in dataset.insertions
    ]
    points = noise.point_sd**2 + np.mean(stated)
    total: Floats = np.sqrt(scale**2 * points + shift**2 + (angle * s) ** 2)
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
