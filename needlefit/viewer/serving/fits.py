"""Messages of the live fit: what the page asks for, the mode, the draws and moved points."""

from typing import Any, get_args

import numpy as np

from needlefit.errors import ModelError
from needlefit.inference.forward_model import find_layers
from needlefit.mechanics.laws import LAWS
from needlefit.viewer.opening.live_fit import KNOTS, FitScope, LiveDraws, LiveMode
from needlefit.viewer.serving.messages import Message
from needlefit.viewer.serving.trials import InteractiveTrial
from needlefit.viewer.viewed_scene import ShownInsertion, ViewedScene

MAX_OFFSET_MM = 50.0
"""A measured point is moved by at most so much, mm."""


def want_fit(trial: InteractiveTrial, message: Message) -> None:
    """Note what a page wants to fit to.

    Raises
    ------
    ModelError
        If nothing is measured, or there is no such choice.
    """
    scope = message.text("scope")
    if trial.viewed_scene.shown is None or scope not in get_args(FitScope):
        raise ModelError(
            f"there is nothing measured to fit to (`{scope:.20}`)",
            expected=f"a measured insertion, and one of {', '.join(get_args(FitScope))}",
        )
    trial.fit.wanted = scope  # type: ignore[assignment]


def read_offsets(message: Message) -> list[float]:
    """Return by how much measured points are moved, mm.

    Raises
    ------
    ModelError
        If these are not so many finite numbers.
    """
    rows = message.content.get("offsets")
    if not isinstance(rows, list) or len(rows) != KNOTS:
        raise ModelError("these are no offsets of points", expected=f"{KNOTS} numbers, mm")
    return [
        Message("points", content={"offset": one}).number("offset", None, MAX_OFFSET_MM, "mm") for one in rows
    ]


def mode_message(mode: LiveMode, shown: ShownInsertion) -> dict[str, Any]:
    """Return the message of fitted values, by the layers that the shown insertion meets."""
    names = LAWS[mode.problem.medium.law].shape_names
    layers = [
        [mode.values[f"mu{layer}_pa"], *(mode.values[f"{name}{layer}"] for name in names)]
        for _, layer in find_layers(shown.insertion)
    ]
    return {
        "kind": "fit",
        "layers": layers,
        "offset_mm": mode.values["bevel_mm"],
        "insertions": len(mode.problem.insertions),
        "misfit": round(mode.misfit, 3),
        "at_bounds": list(mode.at_bounds),
        "seconds": round(mode.seconds, 3),
    }


def draws_message(draws: LiveDraws) -> dict[str, Any]:
    """Return the message of the ridge: mu of the first layer and b of every draw."""
    both = np.log(np.column_stack([draws.mu, draws.bevel]))
    spread = both.std(axis=0)
    correlation = float(np.corrcoef(both.T)[0, 1]) if spread.all() else 0.0
    return {
        "kind": "ridge",
        "mu_pa": draws.mu.tolist(),
        "offset_mm": draws.bevel.tolist(),
        "correlation": correlation,
        "certified": draws.certified,
        "ess": draws.ess,
        "seconds": round(draws.seconds, 3),
    }


def measured_message(viewed_scene: ViewedScene, offsets: list[float]) -> dict[str, Any]:
    """Return the message of the measured needle as it is moved."""
    assert viewed_scene.measured is not None
    x, y = np.round(viewed_scene.measured.points.T, 4).tolist()
    return {"kind": "measured", "x": x, "y": y, "offsets": offsets}
