"""Layers of known shape come out of meshes and segmentations where they were; every bad file says so."""

import dataclasses
import math
import re

import numpy as np
import pytest
import trimesh
from layer_cases import (
    BOX,
    CORE,
    HOME,
    NEEDLE,
    PATIENT,
    SHEET,
    labelled,
    save,
    save_mesh,
    save_segments,
    scan,
)
from numpy.testing import assert_allclose
from pytest import approx
from reading_here import child_process_reader, read_here  # noqa: F401 - fixtures
from refusals import refusal

from needlefit.errors import DataError
from needlefit.geometry.frames import Frame
from needlefit.geometry.surfaces import make_sheet
from needlefit.imaging.checks import check_layers, refuse_tunnels
from needlefit.imaging.layers import estimate_along_sd, find_crossed_layers, layers_in_scan, read_layers
from needlefit.imaging.reconstruction import EntryPose
from needlefit.imaging.registration import register
from needlefit.imaging.scans import LayerSource, StagePose

pytestmark = pytest.mark.usefixtures("read_here")

NORMAL = np.array([0.48, 0.6, 0.64])
NO_ERROR = np.zeros(len(NEEDLE))
GRID = labelled(lambda points: 0 * points[:, 0], shape=(200, 200, 200)).grid


def read(*layers, frame=HOME, **changes):
    return read_layers(scan(*layers, **changes), frame, GRID)


def refused(*layers, **changes):
    error = refusal(DataError, "", lambda: read(*layers, **changes))
    assert "fix: " in str(error)
    return str(error)


def on(surface, count=3000, seed=1):
    return trimesh.sample.sample_surface(surface.to_trimesh(), count, seed=seed)[0]


# ---- segmentations


def slabs(points):
    """Layer 1 before the plane n . p = -2, 2 up to 3, 3 beyond; 0 outside a ball of 12 mm."""
    height = points @ NORMAL
    return (1 + (height > -2) + (height > 3)) * (np.linalg.norm(points, axis=1) < 12)


@pytest.fixture(scope="module")
def slabs_file(tmp_path_factory):
    return save(tmp_path_factory.mktemp("labels") / "slabs.nii.gz", labelled(slabs))


def test_planes_through_the_voxels_stay_where_they_are_and_leave_no_gap(slabs_file):
    """Tilted against a tilted grid of 0.46 mm."""
    surfaces = whole, *planes = read(slabs_file)
    assert [(s.kind, s.into) for s in surfaces] == [("solid", 1), ("solid", 2), ("solid", 3)]
    for surface, height in zip(planes, (-2.0, 3.0), strict=True):
        points = on(surface)
        within = points[np.linalg.norm(points, axis=1) < 9]
        off = np.abs(within @ NORMAL - height)
        assert len(within) > 300 and off.mean() < 0.05 and off.max() < 0.2
    # a ball shrinks by s^2 / r = 0.04 mm; the middles of triangles lie within
    assert 11.9 < np.linalg.norm(on(whole), axis=1).mean() < 12
    # the last solid that holds a point is its layer: away from the boundaries that of its label
    points = np.random.default_rng(1).uniform(-7, 7, (400, 3))
    clear = np.minimum(np.abs(points @ NORMAL + 2), np.abs(points @ NORMAL - 3)) > 0.15
    held = np.array([surface.contains(points) for surface in surfaces])  # (layers, points)
    last = held.shape[0] - np.argmax(held[::-1], axis=0)
    np.testing.assert_array_equal(last[clear], slabs(points)[clear])


@pytest.mark.parametrize(
    ("parts", "planes", "segments", "words"),
    [
        (1, 2, [(1, "fat"), (1, "muscle")], "number"),
        (1, 1, [(1, "fat"), (1, "muscle")], "muscle (label 1)"),
        (1, 1, [(1, "fat"), (2, "muscle")], "muscle (label 2)"),
        (2, 1, [(1, "fat")], "labels 1, 2"),
    ],
)
def test_segments_that_are_not_those_of_the_voxels_are_refused(tmp_path, parts, planes, segments, words):
    volume = labelled(lambda p: parts - 1 + (p[:, 0] > 0))
    message = refused(save_segments(tmp_path / "l.seg.nrrd", volume, segments, planes))
    assert words in message and ("Segment Editor" in message) == (words == "number")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (lambda p: 0 * p[:, 0], "holds 0 values"),
        (lambda p: 100 * p[:, 0], "no labels"),
        (lambda p: np.rint(np.abs(p[:, 0]) * 20), "values besides 0"),
        (lambda p: 1 + (np.linalg.norm(p, axis=1) < 0.9), "layer 2.* 0.5 mm"),
    ],
)
def test_files_without_a_segmentation_or_with_a_speck_for_a_layer_are_refused(tmp_path, values, words):
    assert re.search(words, refused(save(tmp_path / "v.nrrd", labelled(values))))


# ---- meshes


def test_meshes_are_numbered_and_brought_into_the_world(tmp_path):
    sheet, core = (save_mesh(tmp_path / name, mesh) for name, mesh in (("s.stl", SHEET), ("c.ply", CORE)))
    assert [(s.kind, s.into) for s in read(sheet, core)] == [("sheet", 2), ("solid", 3)]
    stated = LayerSource(sheet, "sheet", 3), LayerSource(core, "solid", 2)
    assert [s.into for s in read(*stated)] == [3, 2]
    [there] = read(core, frame=PATIENT, surfaces_in="scan")
    [here] = read(core, frame=PATIENT)
    assert_allclose(there.vertices, PATIENT.to_world(here.vertices), atol=1e-9)
    assert_allclose([here.vertices.min(axis=0), here.vertices.max(axis=0)], CORE.bounds, atol=1e-4)
    away = save_mesh(tmp_path / "away.stl", CORE.copy().apply_translation([200, 0, 0]))
    assert str(away) in refused(core, away, surfaces_in="scan")
    again = save_mesh(tmp_path / "again.stl", SHEET)
    assert str(again) in refused(sheet, core, again)


@pytest.mark.parametrize(
    ("name", "space", "sign"),
    [*((name, "RAS", [-1, -1, 1]) for name in ("a.stl", "a.ply", "a.obj")), ("a.stl", "", [1, 1, 1])],
)
def test_axes_stated_by_slicer_are_used(tmp_path, name, space, sign):
    file = save_mesh(tmp_path / name, SHEET, space)
    [found] = read(file)
    assert sorted(np.round(found.vertices, 4).tolist()) == sorted((SHEET.vertices * sign).round(4).tolist())


BALL = trimesh.creation.icosphere(subdivisions=3, radius=15)


@pytest.mark.parametrize(
    ("mesh", "kind", "words"),
    [
        (trimesh.Trimesh(BALL.vertices, BALL.faces[1:]), "solid", "1 hole, 3 open edges"),
        (BOX, "sheet", "closed"),
        (BOX.copy().apply_scale(1e3), "solid", "mm across"),
    ],
)
def test_a_mesh_that_is_no_boundary_is_refused_with_its_fault(tmp_path, mesh, kind, words):
    file = save_mesh(tmp_path / "m.stl", mesh)
    message = refused(LayerSource(file, kind, 2))
    assert words in message and str(file) in message


# ---- crossings and their deviations


def tilted(degrees):
    """A sheet through (10, 0, 0) whose normal is tilted from x toward y."""
    angle = math.radians(degrees)
    return make_sheet("sheet", (10, 0, 0), (math.cos(angle), math.sin(angle), 0), 100, into=2)


def deviation(degrees, surface=0.0, across=0.0, **more):
    """The deviation of the depth of a sheet, 10 mm deep, tilted by so many degrees."""
    return find_crossed_layers(NEEDLE, HOME, (tilted(degrees),), surface, NO_ERROR + across, **more).sd[0]


def test_depths_count_along_c_and_deviations_grow_as_the_needle_grazes():
    frame = Frame(np.array([-2.0, 0, 0]), np.eye(3))
    layers = find_crossed_layers(NEEDLE, frame, (tilted(0), tilted(40)), 0.0, NO_ERROR)
    assert layers.boundaries == approx([12.0]) and layers.sequence == (1, 2)
    assert_allclose(layers.points, [[10, 0, 0]], atol=1e-9)
    # A surface's own counts by 1 / cos, one across the needle by the tangent of the angle.
    for degrees in [0.0, 30.0, 60.0, 89.9]:
        angle = math.radians(degrees)
        assert deviation(degrees, surface=0.1) == approx(0.1 / math.cos(angle), rel=1e-6)
        assert deviation(degrees, across=0.2) == approx(0.2 * math.tan(angle), abs=1e-9)
    assert deviation(0, surface=0.4, along_sd=0.3) == approx(0.5)


@pytest.fixture(scope="module")
def shifted():
    """A registration whose only errors are shifts, of 0.3 mm along any axis."""
    markers = np.array([[0.0, 0, 0], [50, 0, 0], [0, 30, 0], [10, 20, 40]])
    found = register(PATIENT.to_local(markers), markers, 0.1)
    return dataclasses.replace(found, turn_covariance=1e-12 * np.eye(3), shift_variance=0.09)


def test_errors_of_the_registration_count_across_the_needle_and_surfaces_move_with_it(
    shifted, slabs_file, tmp_path
):
    assert deviation(0, surface=0.4, registration=shifted) == approx(0.4)
    tilt = math.radians(60)
    expected = math.hypot(0.4, 0.3 * math.sin(tilt)) / math.cos(tilt)
    assert deviation(60, surface=0.4, registration=shifted) == approx(expected)
    mesh = save_mesh(tmp_path / "core.stl", CORE)
    pose = EntryPose(np.zeros(3), np.array([1.0, 0, 0]), "shaft", 0.1, 0.01, 0.2)
    for one, with_registration, along in (
        (scan(mesh), True, math.hypot(0.2, 0.3)),
        (scan(mesh, surfaces_in="scan"), False, 0.2),
        (scan(slabs_file), False, 0.2),
        (scan(mesh, stage=StagePose(pose.origin, pose.direction, 0.05, 0.001)), True, 0.05),
    ):
        assert layers_in_scan(one) != with_registration
        between = shifted if with_registration else None
        assert estimate_along_sd(one, pose, between) == approx(along)


def cross(*surfaces):
    return find_crossed_layers(NEEDLE, HOME, surfaces, 0.0, NO_ERROR)


def sheet_at(*place, size=60, into=2):
    return make_sheet(f"sheet {place}", place, (1, 0, 0), size, into)


def check(crossed, **counted):
    return [*check_layers(scan(**counted), crossed, NEEDLE)]


@pytest.mark.parametrize(
    ("surfaces", "words"),
    [
        ([sheet_at(11.5, 0, 0), sheet_at(60, 0, 0, into=3)], ""),  # ahead
        ([sheet_at(11.5, 0, 0), sheet_at(20, 200, 0, into=3)], r"cross sheet \(20, 200, 0\) \("),
        ([sheet_at(10, 12, 0, size=10)], r"\b7\.0 mm"),  # its rim
        ([sheet_at(55, 0, 0)], r"\b15\.0 mm"),
    ],
)
def test_surfaces_that_are_not_crossed_are_named_with_the_gap(surfaces, words):
    warnings = check(cross(*surfaces))
    assert len(warnings) == bool(words) and re.search(words, "".join(warnings))


def test_layers_counted_must_be_met():
    crossed = cross()
    assert crossed.sequence == (1,) and len(crossed.boundaries) == 0 and crossed.points.shape == (0, 3)
    assert check(crossed, layers=1) == []
    crossed = cross(tilted(0))
    assert check(crossed, layers=2) == check(crossed, layers=3, layers_alternative=2) == []
    with pytest.raises(DataError, match=r"2 layers.*\b10\.00 mm.*\b3\b"):
        check(crossed, layers=3)


# ---- doubts


def drilled(points, end):
    """Two layers, parted at x = 0, in a ball of 12 mm, without a tunnel of 1.5 mm around x < end."""
    tunnel = (np.hypot(points[:, 1], points[:, 2]) < 1.5) & (points[:, 0] < end)
    return (1 + (points[:, 0] > 0)) * (np.linalg.norm(points, axis=1) < 12) * ~tunnel


AXIS = np.column_stack([np.linspace(-20, 8, 60), np.zeros((60, 2))])
"""A needle along x, its tip in the second layer."""


@pytest.mark.parametrize("end", [8.0, 20.0])
def test_layers_drawn_around_the_needle_are_refused(end, tmp_path):
    """Within 1.5 mm of it voxels are 0, up to its tip, where both layers would be crossed, or beyond."""
    tunnel = save(tmp_path / "tunnel.nrrd", labelled(lambda p: drilled(p, end)))
    with pytest.raises(DataError, match=r"around the needle.*layer_1 \(along (19|20) mm\), layer_2") as error:
        refuse_tunnels(read(tunnel), AXIS)
    assert "voxels" in error.value.fix
