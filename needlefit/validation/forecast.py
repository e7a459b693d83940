"""What a fit predicts of a planned insertion: where the needle will be, and where it would be measured.

Two bands are told apart. The *needle's* comes from the draws of the parameters alone. The *measurement's*
adds what a scan of it would err by: the errors that the dataset states of its points and of the entry pose.
Neither knows what the model misses.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.insertion import Dataset
from needlefit.errors import ConfigError, ModelError
from needlefit.inference.draws import Draws, Source
from needlefit.inference.likelihood.pose import pose_sds
from needlefit.inference.parameters import Parameters
from needlefit.inference.predict import rules
from needlefit.inference.predictive import Mixture
from needlefit.mechanics.batch import Batch, positions_each
from needlefit.mechanics.lanes import follow_batches
from needlefit.mechanics.scene import Scene
from needlefit.mechanics.tissue import Tissue
from needlefit.project.plain import plain
from needlefit.project.records.medium import MediumRecord
from needlefit.validation.job import Job
from needlefit.validation.provenance import work

Floats = NDArray[np.float64]

STATIONS = 101
"""Points of a predicted needle, from entry to tip."""

ALIKE = 0.02
"""Relative difference of two needles' rigidity from which on they are two needles."""


@dataclass(frozen=True)
class Forecast:
    """A predicted needle in the scene's constraint frame.

    Attributes
    ----------
    s : (K,) array
        Arc length from the entry, mm.
    x : (K,) array
        Depth of these points along the entry axis, median over draws, mm.
    needle, measured : Mixture
        Of y at each of them, mm: where the needle is, and where it would be measured.
    source : "posterior" or "laplace"
    failed : int
        Draws of which the solve failed; they are left out.
    faults : tuple of str
        Why the posterior of the draws has not converged; empty if it has, or none was sampled.
    """

    s: Floats
    x: Floats
    needle: Mixture
    measured: Mixture
    source: Source
    failed: int
    faults: tuple[str, ...] = ()


def forecast(
    scene: Scene, draws: Draws, parameters: Parameters, medium: MediumRecord, dataset: Dataset, jobs: int = 1
) -> Forecast:
    """Return where the needle of a planned insertion will be.

    The scene says needle, depth, layers' places, bevel side and controls; its moduli and bevel offset are
    replaced by the draws': layer n of the scene is layer n of the medium.

    Raises
    ------
    ConfigError
        If the scene has more layers than the medium, or another needle than the dataset.
    ModelError
        If no draw can be solved.
    """
    _check(scene, medium, dataset)
    sets = [parameters.values(theta) for theta in draws.thetas]
    (shapes,) = follow_batches([_batch(scene, sets, medium)], jobs)
    s = np.linspace(0.0, scene.depth, STATIONS)
    good = shapes.converged
    if not good.any():
        raise ModelError(
            f"none of {len(sets)} draws of the parameters can be solved for this scene",
            expected="an insertion that the model can follow",
            mend="look at `needlefit simulate` of the scene; lessen its depth or its deflection",
        )
    points = positions_each(shapes, s)[good]  # (B, K, 2)
    y = points[:, :, 1]
    sd = _measurement(s, dataset)
    return Forecast(
        s=s,
        x=np.median(points[:, :, 0], axis=0),
        needle=Mixture(y, np.zeros(len(s))),
        measured=Mixture(y, sd),
        source=draws.source,
        failed=int((~good).sum()),
        faults=draws.faults,
    )


def _batch(scene: Scene, sets: Sequence[Mapping[str, float]], medium: MediumRecord) -> Batch:
    layers = range(1, scene.tissue.layers + 1)
    tissue = Tissue(
        scene.tissue.mu,
        np.array([sets[0][f"alpha{n}"] for n in layers]),
        scene.tissue.boundaries,
        np.array([medium.thickness_mm]),
        law=medium.law,
    )
    return Batch(
        scene.needle,
        tissue,
        scene.steps,
        rules(medium),
        mu=np.array([[values[f"mu{n}_pa"] * 1e-6 for n in layers] for values in sets]),
        alpha=np.array([[values[f"alpha{n}"] for n in layers] for values in sets]),
        offset=np.array([values["bevel_mm"] for values in sets]),
    )


def _measurement(s: Floats, dataset: Dataset) -> Floats:
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
            mend="name a scene of the fitted medium, or fit a medium with more layers",
        )
    ours, fitted = scene.needle.flexural_rigidity, dataset.needle.flexural_rigidity
    if abs(ours - fitted) > ALIKE * fitted:
        raise ConfigError(
            f"the scene's needle has a flexural rigidity of {ours:.4g} N mm^2, the fitted one {fitted:.4g}",
            expected="the needle that the parameters were fitted with: mu and b depend on it",
            mend="correct [needle] of the scene",
        )


def require_same(job: Job, run: Path) -> None:
    """Raise ConfigError if the run in a folder is of other data or another configuration than `job`."""
    said = json.loads((run / "run.json").read_text(encoding="utf-8"))
    for key in ("dataset", "medium", "folds"):
        if said.get(key) != plain(work(job)[key]):
            raise ConfigError(
                f"its posterior is of another {key}",
                where=str(run),
                expected=f"the {key} that {job.name} names now",
                mend="sample again (`needlefit tune TARGET --sample`), or name the right one with --run",
            )
