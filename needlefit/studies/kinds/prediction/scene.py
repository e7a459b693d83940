"""The scene of a planned insertion: like the deepest fitted one, and under the rules of the fit."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from needlefit.datasets.first_study import describe_scene
from needlefit.datasets.read import read
from needlefit.datasets.select import select_insertions
from needlefit.errors import ConfigError
from needlefit.inference.forward_model import make_options
from needlefit.mechanics.scene import Scene
from needlefit.project.toml import find_named
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import SceneRecord
from needlefit.schemas.study import FitRecord
from needlefit.studies.job import Inputs, Job

RIGIDITY_TOLERANCE = 0.02  #: relative difference of two needles' rigidity from which on they are two needles


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


#: keys of a scene whose values the draws replace
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
