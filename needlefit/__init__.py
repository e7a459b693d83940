"""needlefit: fit and cross-validate bevel-tip needle models on measured insertions.

The names below are resolved when first used, so that `import needlefit` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from needlefit.api import (
        estimate_elpd,
        fit,
        load_dataset,
        load_medium,
        load_run,
        predict,
        sample,
        validate,
        write_prior,
    )
    from needlefit.errors import NeedlefitError
    from needlefit.inference.optimize import minimize
    from needlefit.inference.problem import Problem
    from needlefit.mechanics.batch import (
        Batch,
        Jacobian,
        Jacobians,
        NeedleShapes,
        linearize,
        linearize_batches,
        simulate_batches,
    )
    from needlefit.mechanics.compression import compute_stress
    from needlefit.mechanics.control import Bevel, Controls, Guide, ModelOptions, Step, TrackedTip
    from needlefit.mechanics.needle import Needle
    from needlefit.mechanics.scene import Scene
    from needlefit.mechanics.session import Session
    from needlefit.mechanics.shape import NeedleShape, compute_positions
    from needlefit.mechanics.simulate import simulate, simulate_steps
    from needlefit.mechanics.tissue import Tissue
    from needlefit.schemas.scene import SceneRecord
    from needlefit.studies.run import Run
    from needlefit.studies.steering import Steering

__version__ = "0.1.0"

__all__ = [
    "Batch",
    "Bevel",
    "Controls",
    "Guide",
    "Jacobian",
    "Jacobians",
    "ModelOptions",
    "Needle",
    "NeedleShape",
    "NeedleShapes",
    "NeedlefitError",
    "Problem",
    "Run",
    "Scene",
    "Session",
    "Steering",
    "Step",
    "Tissue",
    "TrackedTip",
    "compute_positions",
    "compute_stress",
    "estimate_elpd",
    "fit",
    "linearize",
    "linearize_batches",
    "load_dataset",
    "load_medium",
    "load_run",
    "minimize",
    "open_scene",
    "predict",
    "sample",
    "simulate",
    "simulate_batches",
    "simulate_steps",
    "validate",
    "write_prior",
]


def __dir__() -> list[str]:
    return __all__


_HOMES = {
    "api": "estimate_elpd fit load_dataset load_medium load_run predict sample validate write_prior",
    "errors": "NeedlefitError",
    "inference.optimize": "minimize",
    "inference.problem": "Problem",
    "mechanics.batch": "Batch Jacobian Jacobians NeedleShapes linearize linearize_batches simulate_batches",
    "mechanics.compression": "compute_stress",
    "mechanics.control": "Bevel Controls Guide ModelOptions Step TrackedTip",
    "mechanics.needle": "Needle",
    "mechanics.scene": "Scene",
    "mechanics.session": "Session",
    "mechanics.shape": "NeedleShape compute_positions",
    "mechanics.simulate": "simulate simulate_steps",
    "mechanics.tissue": "Tissue",
    "studies.run": "Run",
    "studies.steering": "Steering",
}
"""Names by the module in which they are."""


def open_scene(scene: "str | Path | SceneRecord | Mapping[str, Any]") -> "Scene":
    """Return the scene that a bare name such as `phantom1`, a path, or a table of its keys means.

    Raises
    ------
    ConfigError
        If there is no such scene, or it holds a wrong, missing or unknown key.
    """
    from needlefit.mechanics.scene import Scene
    from needlefit.project.result_warnings import issue_warnings
    from needlefit.project.toml import read_given
    from needlefit.project.unit_warnings import scene_warnings
    from needlefit.schemas.scene import SceneRecord

    record, name = read_given("scene", scene, SceneRecord)
    opened = Scene.from_record(record, f"scene {name}")
    issue_warnings(scene_warnings(record, f"scene {name}"))
    return opened


def __getattr__(name: str) -> object:
    home = next((home for home, names in _HOMES.items() if name in names.split()), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{home}"), name)
    return value
