"""Fit parameters to measured needles while they are shown: the mode, and draws about it.

The mode is found by Gauss-Newton steps with the exact Jacobian, from the parameters that are shown; the draws
are importance-weighted about it. All insertions have one b, and errors of depths are linear.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Literal

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.datasets.insertion import Insertion
from needlefit.errors import FitError
from needlefit.geometry.curves import arc_length
from needlefit.inference.forward_model import ParameterDraws, find_layers, select_layer_draws
from needlefit.inference.identifiability.profile import LocalMinimum, minimize_squares
from needlefit.inference.likelihood.observation import PLAIN_LIKELIHOOD
from needlefit.inference.problem import Problem, make_problem
from needlefit.inference.sampling.importance import (
    Effort,
    resample_draws,
    sample_about_modes,
)
from needlefit.mechanics.laws import LAWS
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.simulate import simulate_steps
from needlefit.schemas.medium import MediumRecord, ParameterRecord
from needlefit.schemas.recipe import WeightsRecord
from needlefit.viewer.opening import open_target
from needlefit.viewer.overlays import make_measured_overlay
from needlefit.viewer.viewed_scene import ShownInsertion, ViewedScene

FitScope = Literal["insertion", "specimen", "dataset"]

#: less than a study takes: the draws are waited for
EFFORT = Effort(draws=200, rounds=2, min_ess=100.0, profiles=False)
SHOWN_DRAWS = 100  #: draws of the band and of the ridge
KNOTS = 6  #: points of a measured needle that can be dragged, evenly spread from entry to tip
#: bounds of the parameters of a medium that is not described
MU_BOUNDS_PA, BEVEL_BOUNDS_MM = (1e3, 1e9), (1e-3, 0.5)
BOUND_TOLERANCE = 1e-3  #: a parameter this near to a bound, in theta, ends there


@dataclass(frozen=True)
class LiveMode:
    """The fitted values (Pa, mm) of all parameters, and how long they took, s."""

    problem: Problem
    minimum: LocalMinimum
    values: Mapping[str, float]
    #: root mean square of the residuals in their standard deviations; about 1 where the model is right
    misfit: float
    at_bounds: tuple[str, ...]  #: parameters that end at a bound
    seconds: float

    def to_message(self, insertion: Insertion) -> dict[str, Any]:
        """Return the message of fitted values, by the layers that an insertion meets."""
        names = ("mu{}_pa", *(f"{name}{{}}" for name in LAWS[self.problem.medium.law].shape_names))
        layers = [layer for _, layer in find_layers(insertion)]
        return {
            "kind": "fit",
            "layers": [[self.values[name.format(layer)] for name in names] for layer in layers],
            "offset_mm": self.values["bevel_mm"],
            "insertions": len(self.problem.insertions),
            "misfit": round(self.misfit, 3),
            "at_bounds": list(self.at_bounds),
            "seconds": round(self.seconds, 3),
        }


@dataclass(frozen=True)
class LiveDraws:
    """Draws about a mode."""

    spread: ParameterDraws  #: for the band and plans
    mu: Floats  #: mu, bevel: (B,) Of the first layer's modulus, Pa, and of b, mm: the ridge
    bevel: Floats
    certified: bool  #: whether the weights can be trusted
    ess: float
    seconds: float

    def to_message(self) -> dict[str, Any]:
        """Return the message of the ridge: mu of the first layer and b of every draw."""
        both = np.log(np.column_stack([self.mu, self.bevel]))
        return {
            "kind": "ridge",
            "mu_pa": self.mu.tolist(),
            "offset_mm": self.bevel.tolist(),
            "correlation": float(np.corrcoef(both.T)[0, 1]) if both.std(axis=0).all() else 0.0,
            "certified": self.certified,
            "seconds": round(self.seconds, 3),
        }


def select_insertions(shown: ShownInsertion, scope: FitScope) -> tuple[Insertion, ...]:
    """Return the insertions of the same medium that are fitted to; the one shown is as it is shown."""
    keys = {"insertion": ("id",), "specimen": ("medium", "specimen"), "dataset": ("medium",)}[scope]
    others = [one for one in shown.dataset.insertions if one.id != shown.insertion.id]
    same = [one for one in others if all(getattr(one, key) == getattr(shown.insertion, key) for key in keys)]
    return (shown.insertion, *same)


def find_mode(shown: ShownInsertion, insertions: Sequence[Insertion]) -> LiveMode:
    """Return the fit nearest to the parameters shown; FitError if no needle is found on the way."""
    began = perf_counter()
    medium = _free_medium(shown.medium)
    problem = make_problem(shown.dataset, insertions, medium, WeightsRecord(), PLAIN_LIKELIHOOD)
    known = problem.values(problem.parameters.expected) | dict(shown.values)
    found = minimize_squares(problem, problem.parameters.theta(known))
    if not np.isfinite(found.value):
        raise FitError(
            "the fit finds no needle with the parameters that it begins with",
            expected="parameters with which every needle has a solution",
            fix="change them by hand, then fit again",
        )
    values = problem.values(found.theta)
    misfit = float(np.sqrt(np.mean(problem.compute_misfits(found.theta) ** 2)))
    gaps = np.minimum(found.theta - problem.lower, problem.upper - found.theta)
    at_bounds = tuple(np.array(problem.parameters.free)[gaps < BOUND_TOLERANCE].tolist())
    return LiveMode(problem, found, values, misfit, at_bounds, perf_counter() - began)


def draw_about(mode: LiveMode, insertion: Insertion, seed: int) -> LiveDraws:
    """Return draws about a mode, for the layers that an insertion meets; on one core."""
    began, problem = perf_counter(), mode.problem
    rng = np.random.default_rng(seed)
    weighted = sample_about_modes(problem, [mode.minimum], rng, efforts=(EFFORT,))
    draws = resample_draws(weighted, SHOWN_DRAWS, rng)
    table = pd.DataFrame([problem.values(theta) for theta in draws.thetas])
    layers = [layer for _, layer in find_layers(insertion)]
    return LiveDraws(
        select_layer_draws(table, layers, problem.medium.law),
        table[f"mu{layers[0]}_pa"].to_numpy(dtype=np.float64),
        table["bevel_mm"].to_numpy(dtype=np.float64),
        weighted.certified,
        weighted.effective_sample_size,
        perf_counter() - began,
    )


def move_points(original: ShownInsertion, offsets: Sequence[float]) -> ShownInsertion:
    """Return an insertion moved along y by so many mm at `KNOTS` places, linear between.

    Cross-sections move with the centreline, so that the fit keeps its likelihood, and the shaft outside with
    the entry. Without an offset it is the insertion as measured.
    """
    if not any(offsets):
        return original
    one, knots = original.insertion, np.linspace(0, 1, KNOTS)

    def shift(points: Floats, s: Floats) -> Floats:
        moved = points.copy()
        moved[:, 1] += np.interp(s / s[-1], knots, offsets)
        return moved

    s, sections = arc_length(one.planar), one.sections
    centerline = one.frame.to_world(shift(one.frame.to_local(one.centerline), s))
    if sections is not None:
        local = shift(one.frame.to_local(sections.points), sections.s)
        sections = replace(sections, points=one.frame.to_world(local))
    moved = replace(one, planar=shift(one.planar, s), centerline=centerline, sections=sections)
    return replace(original, insertion=moved)


def show_moved(viewed_scene: ViewedScene, moved: ShownInsertion) -> ViewedScene:
    """Return a scene that shows another measured needle in the place of its own."""
    scene = Scene.from_record(viewed_scene.record, viewed_scene.name)
    shape = simulate_steps(scene.needle, scene.tissue, scene.steps, scene.rules)
    floor = viewed_scene.measured.floor if viewed_scene.measured else None
    known = float("nan") if floor is None else floor
    overlay = make_measured_overlay(moved.dataset, moved.insertion, known, shape)
    return replace(viewed_scene, measured=overlay, shown=moved)


def _free_medium(medium: MediumRecord) -> MediumRecord:
    """Return a medium with something to fit: one whose parameters are all fixed gets moduli and b free."""
    if any(one.fixed is None and one.tie is None for one in medium.parameters.values()):
        return medium
    freed = {
        name: ParameterRecord(bounds=BEVEL_BOUNDS_MM if name == "bevel_mm" else MU_BOUNDS_PA)
        for name in medium.parameters
        if name == "bevel_mm" or name.startswith("mu")
    }
    return medium.model_copy(update={"parameters": {**medium.parameters, **freed}})


def tabulate_draws(name: str) -> pd.DataFrame:
    """Return the draws of the fit of one insertion, DATASET/ID, as the table beside a scene holds them.

    The scene `phantom2_fitted` has such a table:

        python -m needlefit.viewer.live_fit twin/phantom2-05 > configs/scenes/phantom2_fitted.draws.csv
    """
    shown = open_target(name).shown
    assert shown is not None
    mode = find_mode(shown, (shown.insertion,))
    spread = draw_about(mode, shown.insertion, shown.seed).spread
    columns = {f"mu{n}_pa": column * 1e6 for n, column in enumerate(spread.mu.T, start=1)}
    return pd.DataFrame(columns | {"bevel_mm": spread.bevel})


if __name__ == "__main__":
    tabulate_draws(sys.argv[1]).to_csv(sys.stdout, index=False, float_format="%.5g")
