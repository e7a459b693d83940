"""Layers that a scan shows around a needle: planes of known place in noise, rays and beside markers."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from needlefit.geometry.crossings import find_surface_hits
from needlefit.geometry.curves import arc_length
from needlefit.imaging.layer_proposal import propose_layers
from needlefit.imaging.volume import Volume, to_patient

SPACING = 0.6
SHAPE = (90, 56, 56)
MIDDLE = np.array([16.8, 16.8])


def needle(bend=2.0):
    """A needle along S from 2 to 48 mm, which enters at 10 mm and bends toward +P."""
    z = np.linspace(2.0, 48.0, 93)
    part = np.clip(z - 10, 0, None) / 38
    return np.column_stack([np.full_like(z, MIDDLE[0]), MIDDLE[1] + bend * part**2, z])


def scan(*interfaces, levels=(40.0, 0.0, 45.0), noise=20.0, tilt=0.0, seed=1):
    """Layers whose faces pass the axis at `interfaces` (S, mm); tilted toward L, in radians."""
    volume = Volume(np.zeros(SHAPE, np.float32), np.zeros(3), np.full(3, SPACING), np.eye(3))
    k, j, i = np.indices(SHAPE)
    points = to_patient(volume, np.stack([i, j, k], axis=-1).reshape(-1, 3))
    height = points[:, 2] - np.tan(tilt) * (points[:, 0] - MIDDLE[0])
    values = np.full(len(points), -1000.0)
    values[height > 10] = levels[0]
    for at, before, behind in zip(interfaces, levels, levels[1:], strict=False):
        values += (behind - before) / (1 + np.exp(-(height - at) / 0.25))
    axis = needle()
    beside = np.hypot(
        points[:, 0] - np.interp(points[:, 2], axis[:, 2], axis[:, 0]),
        points[:, 1] - np.interp(points[:, 2], axis[:, 2], axis[:, 1]),
    )
    values[(beside < 0.9) & (points[:, 2] < 48)] = 3000
    values += noise * np.random.default_rng(seed).normal(size=len(values))
    return Volume(values.reshape(SHAPE).astype(np.float32), volume.origin, volume.spacing, volume.direction)


def arcs(*heights):
    """Lengths along the needle from its entry at which it passes S."""
    axis = needle()
    s = arc_length(axis)
    return np.interp(heights, axis[:, 2], s) - np.interp(10.0, axis[:, 2], s)


@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("noise", [10.0, 40.0])
def test_layers_are_found_where_they_are(tilt, noise):
    found = propose_layers(scan(22.0, 36.0, tilt=tilt, noise=noise), needle(), 8.0)
    errors = np.array([one.at for one in found]) - arcs(22.0, 36.0)
    deviations = np.array([one.sd for one in found])
    assert (np.abs(errors) < 0.15 + noise / 200).all()
    assert (np.abs(errors) < 3.5 * deviations).all()
    assert (deviations < 0.6).all()
    assert_allclose([one.step for one in found], [-40, 45], atol=8)
    assert_allclose([one.tilt for one in found], tilt, atol=0.08)


def test_a_proposed_surface_is_crossed_at_its_stated_depth_and_a_ball_moves_nothing():
    volume = scan(22.0, 36.0)
    points = to_patient(volume, np.argwhere(np.ones(SHAPE, bool))[:, ::-1]).reshape(*SHAPE, 3)
    ball = np.linalg.norm(points - [MIDDLE[0] + 8, MIDDLE[1], 22.5], axis=-1) < 2.5
    volume.values[ball] = 3000
    found = propose_layers(volume, needle(), 8.0)
    assert_allclose([one.at for one in found], arcs(22.0, 36.0), atol=0.15)
    volume = scan(22.0, 36.0, tilt=0.2)
    for one in propose_layers(volume, needle(), 8.0):
        assert_allclose(find_surface_hits(needle(), one.surface) - 8.0, one.at, atol=0.05)


def test_nothing_is_proposed_where_nothing_shows():
    for levels in [(40.0,), (40.0, 36.0)]:
        assert propose_layers(scan(22.0, levels=levels), needle(), 8.0) == ()
    volume = scan(levels=(40.0,))
    slope = np.linspace(0, -25, SHAPE[0])[:, None, None]
    tilted = Volume(volume.values + slope.astype(np.float32), volume.origin, volume.spacing, volume.direction)
    assert propose_layers(tilted, needle(), 8.0) == ()
