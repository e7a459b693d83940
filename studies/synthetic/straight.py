"""Simulate insertions straight along x into one layer, measured with the errors that are stated."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion
from needlefit.datasets.read import make_noise
from needlefit.errors import ConfigError
from needlefit.geometry.frames import Frame
from needlefit.mechanics.needle import Needle
from needlefit.project.json_values import digest_values
from needlefit.project.random_streams import random_stream
from needlefit.project.toml import check, read_given
from needlefit.schemas.dataset import NoiseRecord
from needlefit.schemas.medium import MediumRecord
from needlefit.schemas.scene import NeedleRecord
from needlefit.studies.simulated_data import simulate_measurement

MEDIUM = "made"
POINT_SPACING_MM = 1.0  # distance of measured points along a needle, mm


def simulate_dataset(data: Mapping[str, Any], medium: str, seed: int) -> Dataset:
    """Return a dataset without files, for `score_study` and `estimate_evidence`.

    Parameters
    ----------
    data : table
        `title`; the true `values` (Pa, mm); the `needle`, as in a scene; `noise`, as in a dataset;
        optionally `pose_angle_sd_deg` and `depth_sd_mm`; and `insertions`: a list of tables with
        `depth_mm`, `side` (1 or -1) and `base_moved_mm`, how far the base moves across afterwards.
    medium : str
        The tissue model that generates the shapes, of one layer.
    seed : int
        Of the errors of measurement.

    Raises
    ------
    ConfigError
        If a key is wrong, or an insertion has no solution.
    """
    dataset = Dataset(
        name="simulated",
        title=data["title"],
        origin="synthetic",
        insertions=(),
        media=(MEDIUM,),
        noise=make_noise(check(data["noise"], NoiseRecord, "noise")),
        pose="known",
        drop_proximal=0.0,
        path=Path(),
        digest=digest_values(dict(data)),
    )
    model, _ = read_given("medium", medium, MediumRecord)
    measurements = []
    for number, stated in enumerate(data["insertions"], start=1):
        straight = make_straight_insertion(f"made-{number:02d}", stated, data)
        rng = random_stream(seed, "simulated", "made", straight.id)
        measured = simulate_measurement(dataset, straight, data["values"], model, rng)
        if measured is None:
            raise ConfigError(f"simulated insertion {straight.id} has no solution", fix="move the base less")
        measurements.append(measured)
    return replace(dataset, insertions=tuple(measurements))


def make_straight_insertion(name: str, stated: Mapping[str, Any], data: Mapping[str, Any]) -> Insertion:
    """Return one insertion as it is planned."""
    depth = stated["depth_mm"]
    x = np.linspace(0.0, depth, math.ceil(depth / POINT_SPACING_MM) + 1)
    straight = np.column_stack([x, np.zeros((len(x), 2))])
    return Insertion(
        id=name,
        medium=MEDIUM,
        specimen=name,
        needle=Needle.from_record(check(data["needle"], NeedleRecord, "needle")),
        layers=1,
        layers_alternative=1,
        depth=depth,
        side=stated.get("side", 1),
        frame=Frame(np.zeros(3), np.eye(3)),
        pose_source="stage",
        pose_shift_sd=0.0,
        pose_angle_sd=math.radians(data.get("pose_angle_sd_deg", 0.0)),
        centerline=straight,
        points=straight,
        boundaries=np.empty(0),
        sequence=(1,),
        boundary_sd=0.0,
        depth_sd=data.get("depth_sd_mm", 0.0),
        base_moved=stated.get("base_moved_mm", 0.0),
    )
