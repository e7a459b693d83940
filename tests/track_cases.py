"""Tip tracks for the tests: simulated with the model itself, so their truth is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from needlefit.datasets.insertion import Dataset, Noise, TipReadings, TipTrack, make_track
from needlefit.inference.forward_model import simulate_deflections
from needlefit.inference.problem import Problem, make_problem
from needlefit.mechanics.needle import Needle
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.recipe import WeightsRecord

NEEDLE = Needle(200.0, 2.5e4)
NOISE = Noise(point_sd=0.02)
TRUTH = {"mu1_pa": 3e4, "alpha1": 1.0, "bevel_mm": 0.03, "guide_distance_mm": 20.0}
DEPTH = np.arange(0.0, 61.0, 5.0)
#: where the guide stood on the way to each reading, mm
GUIDE = np.array([0.0, 0, 1, 3, 4, 4, 2, 0, -1, -2, -2, 0, 1])

MEDIUM = MediumRecord.model_validate(
    {
        "schema": 1,
        "layers": 1,
        "parameters": {
            "mu1_pa": {"bounds": [1e3, 1e7]},
            "alpha1": {"fixed": 1.0},
            "bevel_mm": {"bounds": [1e-4, 0.3]},
            "guide_distance_mm": {"bounds": [2.0, 100.0]},
        },
    }
)

HEAD = "run,phantom,at_mm,x_mm,stage_mm,ok\n"
TOML = """
schema = 1
name = "mine"
origin = "synthetic"
license = "none"
source = "made up"

[needle]
length_mm = 200.0
flexural_rigidity_nmm2 = 2.5e4

[noise]
point_sd_mm = 0.02
slope_sd_deg = 1.0

[tip_tracks]
file = "steps.csv"

[tip_tracks.columns]
id = "run"
medium = "phantom"
depth_mm = "at_mm"
tip_mm = "x_mm"
guide_mm = "stage_mm"
valid = "ok"

[media.gel]
"""


def track(name: str, guide: np.ndarray, depth: np.ndarray = DEPTH, side: int = 1) -> TipTrack:
    """A run not yet measured: its tip is 0."""
    readings = TipReadings(depth, np.zeros(len(depth)), guide)
    return make_track(name, "gel", "gel", side, readings, (np.empty(0), (1,)))


def with_tip(one: TipTrack, tip: np.ndarray) -> TipTrack:
    """The run with these readings of its tip."""
    return replace(one, planar=np.column_stack([one.depths, tip]))


def simulate_tips(tracks: list[TipTrack]) -> tuple[np.ndarray, ...]:
    """The tips (1, n) of every run at the truth."""
    return simulate_deflections([TRUTH], MEDIUM, NEEDLE, tracks, [one.depths for one in tracks])


def measured(one: TipTrack, shift: float = 0.0, slope: float = 0.0, seed: int | None = None) -> TipTrack:
    """The run as the model has it at the truth, in such a frame, with noise if seeded."""
    (tip,) = simulate_tips([one])
    noise = 0.0 if seed is None else NOISE.point_sd * np.random.default_rng(seed).normal(size=len(one.tip))
    return with_tip(one, tip[0] + shift + slope * one.depths + noise)


def dataset(tracks: list[TipTrack]) -> Dataset:
    return Dataset(
        "cases", "cases", "synthetic", NEEDLE, tuple(tracks), ("gel",), NOISE, "tracker", 0.0, Path(), "0"
    )


def problem(tracks: list[TipTrack], medium: MediumRecord = MEDIUM) -> Problem:
    return make_problem(dataset(tracks), tracks, medium, WeightsRecord())


def written(folder: Path, tracks: list[TipTrack], toml: str = TOML) -> Path:
    """A folder with the runs as somebody's table, depths beginning anywhere."""
    rows = [
        f"{one.id},{one.medium},{depth + 0.7:.4f},{tip:.5f},{guide - 25.0:.4f},1"
        for one in tracks
        for depth, tip, guide in zip(one.depths, one.tip, one.guide, strict=True)
    ]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "steps.csv").write_text(HEAD + "\n".join(rows) + "\n")
    (folder / "dataset.toml").write_text(toml)
    return folder
