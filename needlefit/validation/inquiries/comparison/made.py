"""A dataset made for one study, in memory: needles that follow the model, measured with stated errors."""

import hashlib
import json
import math
from pathlib import Path

import numpy as np

from needlefit.datasets.insertion import Dataset, Insertion, Noise
from needlefit.errors import ConfigError
from needlefit.geometry.frames import Frame
from needlefit.mechanics.needle import Needle
from needlefit.project.records.comparison import MadeNeedleRecord, MadeRecord
from needlefit.project.records.medium import MediumRecord
from needlefit.project.streams import stream
from needlefit.validation.calibration.measured import measured

SPACING = 1.0
"""Distance of measured points along a needle, mm."""

MEDIUM = "made"


def made(name: str, record: MadeRecord, medium: MediumRecord, seed: int) -> Dataset:
    """Return the dataset that a record states, of a medium of one layer.

    Raises
    ------
    ConfigError
        If a needle has no solution.
    """
    planned = [_planned(number, one, record) for number, one in enumerate(record.insertions, start=1)]
    empty = _dataset(name, record, ())
    seen = []
    for one in planned:
        found = measured(empty, one, record.values, medium, stream(seed, name, "made", one.id))
        if found is None:
            raise ConfigError(
                f"made insertion {one.id} has no solution",
                where=f"study {name}",
                key="made",
                mend="move the base less",
            )
        seen.append(found)
    return _dataset(name, record, tuple(seen))


def _planned(number: int, one: MadeNeedleRecord, record: MadeRecord) -> Insertion:
    """Return one insertion as it is planned: straight along x."""
    x = np.linspace(0.0, one.depth_mm, math.ceil(one.depth_mm / SPACING) + 1)
    straight = np.column_stack([x, np.zeros(len(x))])
    return Insertion(
        id=f"made-{number:02d}",
        medium=MEDIUM,
        specimen=f"made-{number:02d}",
        layers=1,
        layers_alternative=1,
        depth=one.depth_mm,
        side=one.side,
        frame=Frame(np.zeros(3), np.eye(3)),
        pose_source="stage",
        pose_shift_sd=0.0,
        pose_angle_sd=math.radians(record.pose_angle_sd_deg),
        centerline=np.column_stack([straight, np.zeros(len(x))]),
        planar=straight,
        out_of_plane=np.zeros(len(x)),
        boundaries=np.empty(0),
        sequence=(1,),
        boundary_sd=0.0,
        depth_sd=record.depth_sd_mm,
        base_moved=one.base_moved_mm,
    )


def _dataset(name: str, record: MadeRecord, insertions: tuple[Insertion, ...]) -> Dataset:
    stated = record.noise
    noise = Noise(
        stated.registration_mean_mm,
        stated.point_sd_mm,
        stated.correlated_sd_mm,
        stated.correlation_length_mm,
    )
    text = json.dumps(record.model_dump(mode="json"), sort_keys=True)
    return Dataset(
        name=name,
        title=record.title,
        origin="synthetic",
        needle=Needle.from_record(record.needle),
        insertions=insertions,
        media=(MEDIUM,),
        noise=noise,
        pose="known",
        drop_proximal=0.0,
        path=Path(),
        digest=hashlib.sha256(text.encode()).hexdigest(),
        outer_diameter=record.needle.outer_diameter_mm,
    )
