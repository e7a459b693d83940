"""Tip tracks for the tests: simulated with the model itself, so their truth is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from inference_cases import medium
from numpy.random import default_rng
from problem_cases import make_problem

from needlefit import Needle
from needlefit.datasets.insertion import Dataset, Noise
from needlefit.datasets.observations.tip_track import TipReadings, make_track
from needlefit.inference.forward_model import PreparedModel

NEEDLE = Needle(200.0, 2.5e4)
NOISE = Noise(point_sd=0.02)
TRUTH = {"mu1_pa": 3e4, "alpha1": 1.0, "bevel_mm": 0.03, "guide_distance_mm": 20.0}
DEPTH = np.arange(0.0, 61.0, 5.0)
#: where the guide stood on the way to each reading, mm
GUIDE = np.array([0.0, 0, 1, 3, 4, 4, 2, 0, -1, -2, -2, 0, 1])
#: the same across it
GUIDE_Z = np.array([0.0, 1, 1, 0, -2, -3, -3, -1, 0, 2, 3, 3, 2])

MEDIUM = medium(
    1,
    mu1_pa={"bounds": [1e3, 1e7]},
    bevel_mm={"bounds": [1e-4, 0.3]},
    guide_distance_mm={"bounds": [2.0, 100.0]},
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


def track(
    name,
    guide,
    depth=DEPTH,
    side=1,
    guide_z=None,
    roll=0.0,
):
    """A run not yet measured: its tip is 0; with `guide_z` it is in space, its bevel rolled, degrees."""
    guides = np.column_stack([guide] if guide_z is None else [guide, guide_z])
    readings = TipReadings(depth, np.zeros((len(depth), guides.shape[1])), guides)
    turns = ((0.0, roll),) if roll else ()
    return make_track(name, "gel", "gel", NEEDLE, side, readings, (np.empty(0), (1,)), turns)


def with_tip(one, tip, tip_z=None):
    """The run with these readings of its tip."""
    z = one.points[:, 2] if tip_z is None else tip_z
    return replace(one, points=np.column_stack([one.points[:, 0], tip, z]))


def simulate_tips(tracks):
    """The tips (1, n) of every run at the truth."""
    return simulate_deflections(tracks, [one.points[:, 0] for one in tracks])


def simulate_deflections(tracks, at):
    """The tips (1, K) of every run at its depths `at` (K,), at the truth."""
    points = PreparedModel(MEDIUM, tracks).read_points([TRUTH], at)
    return tuple(one[..., 1] for one in points)


def simulate_in_space(one):
    """The tips (n, 2) along y and z of a run at the truth."""
    ((points,),) = PreparedModel(MEDIUM, [one]).read_points([TRUTH], [one.points[:, 0]])
    return np.asarray(points[:, 1:])


def measured_in_space(one, seed, slopes=(0.0, 0.0)):
    """The same of a run in space, in a frame with these slopes along y and z."""
    noise = NOISE.point_sd * default_rng(seed).normal(size=(len(one.points), 2))
    return with_tip(one, *(simulate_in_space(one) + noise + np.outer(one.points[:, 0], slopes) + 3.0).T)


def measured(one, shift=0.0, slope=0.0, seed=None):
    """The run as the model has it at the truth, in such a frame, with noise if seeded."""
    (tip,) = simulate_tips([one])
    noise = 0.0 if seed is None else NOISE.point_sd * default_rng(seed).normal(size=len(one.points))
    return with_tip(one, tip[0] + shift + slope * one.points[:, 0] + noise)


def dataset(tracks, compared="plane"):
    found = Dataset(
        "cases", "cases", "synthetic", tuple(tracks), ("gel",), NOISE, "tracker", 0.0, Path(), "0"
    )
    return replace(found, compared=compared)


def problem(tracks, medium=MEDIUM, compared="plane"):
    return make_problem(dataset(tracks, compared), tracks, medium)


def written(folder, tracks, toml=TOML):
    """A folder with the runs as somebody's table, depths beginning anywhere."""
    rows, in_space = [], all(one.directions == 2 for one in tracks)
    for one in tracks:
        places = [one.points[:, 0] + 0.7, one.points[:, 1], one.guide.y - 25.0, np.ones(len(one.points))]
        places += [one.points[:, 2], one.guide.z + 4.0] if in_space else []
        rows += [
            ",".join([one.id, one.medium, *(f"{x:.5f}" for x in row)]) for row in zip(*places, strict=True)
        ]
    folder.mkdir(parents=True, exist_ok=True)
    head = HEAD.replace("\n", ",tip_z_mm,guide_z_mm\n") if in_space else HEAD
    (folder / "steps.csv").write_text(head + "\n".join(rows) + "\n")
    (folder / "dataset.toml").write_text(toml)
    return folder
