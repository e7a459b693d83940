"""Surfaces and their crossings against closed forms."""

import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from pytest import approx
from refusals import refused_file
from synthetic.design import make_cylinder

from needlefit.geometry.crossings import find_crossings, find_path_crossings, measure_enclosed_length
from needlefit.geometry.meshes import extract_solid
from needlefit.geometry.surfaces import Surface, find_mesh_faults, make_sheet, read_surface

seeds = st.integers(0, 2**32 - 1)


def line(start, end, points=23):
    return np.linspace(np.asarray(start, float), np.asarray(end, float), points)


@given(seeds, st.integers(2, 60))
def test_crossings_of_a_plane_match_the_formula(seed, points):
    rng = np.random.default_rng(seed)
    center, normal, start, direction = rng.normal(size=(4, 3)) * [[5], [1], [20], [1]]
    direction /= np.linalg.norm(direction)
    slope = normal @ direction / np.linalg.norm(normal)
    assume(abs(slope) > 0.05)
    depth = normal @ (center - start) / (normal @ direction)
    assume(abs(depth) > 1e-3 and abs(depth - 50) > 1e-3)
    met = find_crossings(
        line(start, start + 50 * direction, points), [make_sheet("plane", center, normal, 5000, into=2)]
    )
    if 0 < depth < 50:
        assert met.sequence == (1, 2)
        assert met.arc == approx([depth], abs=1e-6)
        assert_allclose(met.points, [start + depth * direction], atol=1e-6)
    else:
        assert met.sequence == (1,) and met.points.shape == (0, 3)


@given(st.floats(-9, 9), st.floats(-0.5, 0.5))
def test_crossings_of_a_cylinder_match_the_formula(offset, tilt):
    """Radius 10 about y; a line at x = offset enters and leaves at z = -+sqrt(100 - offset^2)."""
    facets = 192
    solid = make_cylinder("tumour", ((0, -60, 0), (0, 60, 0)), 10.0, into=4, facets=facets)
    met = find_crossings(line((offset, -30 * tilt, -30), (offset, 30 * tilt, 30)), [solid])
    half, stretch = np.sqrt(100 - offset**2), np.hypot(1, tilt)
    sagitta = 10 * (1 - np.cos(np.pi / facets)) / (half / 10) * stretch
    assert met.sequence == (1, 4, 1)
    assert met.arc == approx([(30 - half) * stretch, (30 + half) * stretch], abs=1.01 * sagitta + 1e-9)


TOP = make_sheet("top", (0, 0, 0), (0, 0, 1), 80, into=2)


def test_what_is_a_crossing():
    # on the diagonal of the square, and at a point of the curve
    assert find_crossings([(0, 0, -10), (0, 0, 10)], [TOP]).sequence == (1, 2)
    assert find_crossings([(0, 0, -10), (0, 0, 0), (0, 0, 10)], [TOP]).arc.tolist() == [10]
    assert find_crossings([(0, 0, -10), (5, 1, 0), (10, 0, -10)], [TOP]).sequence == (1,)
    assert find_crossings([(3, 1, 0), (3, 1, 10)], [TOP]).sequence == (2,)
    assert find_crossings([(3, 1, -10), (3, 1, 0)], [TOP]).sequence == (1,)
    jagged = [(0, 1, -5), (0, 1, 0.1), (0, 1, -0.1), (0, 1, 0.2), (0, 1, 5)]
    assert find_crossings(jagged, [TOP]).sequence == (1, 2)
    met = find_crossings(line((0, 0, 0), (0, 0, 40)), [])
    assert met.sequence == (1,) and met.arc.shape == (0,) and met.points.shape == (0, 3)


def test_sheets_lead_inward_and_a_solid_wins():
    deep = make_sheet("deep", (0, 0, 20), (0, 0.2, 1), 200, into=3)
    core = make_cylinder("core", ((0, -30, 20), (0, 30, 20)), 5.0, into=4)
    met = find_crossings(line((0, 0, -10), (0, 0, 40)), [core, deep, TOP])
    assert met.sequence == (1, 2, 4, 3)
    assert met.arc == approx([10, 25, 35], abs=0.02)
    below = find_crossings(line((0, 0, 21), (0, 0, 40)), [core, deep, TOP])
    assert below.sequence == (4, 1)  # no sheet was crossed on the way


def test_many_curves_cross_as_each_does_alone():
    deep = make_sheet("deep", (0, 0, 20), (0, 0.2, 1), 200, into=3)
    surfaces = [make_cylinder("core", ((0, -30, 20), (0, 30, 20)), 5.0, into=4), deep, TOP]
    across = np.random.default_rng(4).uniform(-9, 9, (40, 1, 2)) * np.linspace(0, 1, 31)[:, None] ** 2
    along = np.linspace(-10, np.linspace(-5, 40, 40), 31).T[..., None]
    curves = np.concatenate([across, along], axis=2)
    met = find_path_crossings(curves, surfaces)
    for n, curve in enumerate(curves):
        alone = find_crossings(curve, surfaces)
        count = len(alone.arc)
        assert tuple(met.layers[n, : count + 1]) == alone.sequence and not met.layers[n, count + 1 :].any()
        assert_allclose(met.points[n, :count], alone.points, atol=1e-9)
        assert_allclose(met.arc[n, :count], alone.arc, atol=1e-9)
        assert np.isnan(met.arc[n, count:]).all()
    assert len(np.unique(met.layers, axis=0)) == 6


def test_faults_of_surfaces():
    core = make_cylinder("core", ((0, 0, 0), (0, 0, 20)), 5.0, into=4)
    grid = TOP.to_trimesh().subdivide().subdivide()
    inner = int(np.argmin(np.linalg.norm(grid.triangles_center, axis=1)))
    holed = np.arange(len(grid.faces)) != inner
    two = trimesh.util.concatenate(
        [TOP.to_trimesh(), make_sheet("far", (0, 0, 9), (0, 0, 1), 10, 2).to_trimesh()]
    )
    unbounded = np.array([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]])
    found = [
        find_mesh_faults(surface)
        for surface in (
            replace(core, faces=core.faces[1:]),
            replace(core, kind="sheet"),
            replace(core, faces=core.faces[:, ::-1]),
            replace(TOP, vertices=grid.vertices, faces=grid.faces[holed]),
            replace(TOP, faces=np.array([[0, 1, 2], [0, 3, 2]])),
            replace(TOP, vertices=two.vertices, faces=two.faces),
            replace(core, faces=core.faces[:0]),
            replace(TOP, vertices=unbounded, faces=np.array([[0, 1, 2]])),
        )
    ]
    assert [len(faults) for faults in found] == [1] * 8 and len({faults[0] for faults in found}) == 8
    assert "1" in found[3][0] and "2" in found[5][0]  # a hole, and two pieces


def test_places_inside_a_solid_are_told_where_rays_meet_its_edges():
    """Of a cube of 8 mm: rays from places at whole millimetres meet diagonals of its faces, and its edges."""
    box = trimesh.creation.box((8.0, 8.0, 8.0))
    cube = Surface("cube", np.array(box.vertices), np.array(box.faces), "solid", 2)
    places = np.stack(np.meshgrid(*[np.arange(-6.0, 7.0)] * 3), axis=-1).reshape(-1, 3)
    reach = np.abs(places).max(axis=1)
    assert_array_equal(cube.contains(places[reach != 4]), reach[reach != 4] < 4)


def test_the_largest_piece_of_a_mesh_is_closed():
    # A box of 8 x 8 x 8 with a cavity of 2 x 2 x 2, beside a box of 4 x 4 x 4, all inside out.
    boxes = [trimesh.creation.box((size,) * 3) for size in (8, 2, 4)]
    boxes[1].invert()
    boxes[2].apply_translation([20, 0, 0])
    whole = trimesh.util.concatenate(boxes)
    found, others = extract_solid("box", whole.vertices, whole.faces[:, ::-1], into=3)
    assert (found.kind, found.into, len(found.faces)) == ("solid", 3, 12)
    assert found.volume == approx(512) and find_mesh_faults(found) == []
    assert others == approx((8 + 64) / 512)


# ---- mesh files that are damaged, claim more than they hold, or name other files

REFUSED = [  # of other damage see `test_fuzz`
    ("beyond.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 4000000000 1 2\n"),
    ("archive.ply", b"PK\3\4" + bytes(100)),
    ("text.stl", b"root:x:0:0\n"),
    ("words.stl", b"solid x\nendsolid x\n"),
    ("count.stl", bytes(80) + struct.pack("<I", 5) + bytes(50), "134", "334"),
]


@pytest.mark.parametrize(("name", "content", "numbers"), [(name, it, rest) for name, it, *rest in REFUSED])
def test_files_without_a_mesh_are_refused(tmp_path, name, content, numbers):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    error = refused_file(read_surface, path, "sheet", 2)
    assert "x:0" not in str(error) and "Error" not in error.what
    assert name != "words.stl" or all(form in error.expected for form in ("STL", "PLY", "OBJ"))
    assert all(number in error.what for number in numbers)


@pytest.mark.parametrize(("slit_deg", "length"), [(0, 30), (25, 30), (70, 0)])
def test_a_tunnel_with_a_narrow_slit_encloses_a_curve_and_a_wide_one_does_not(slit_deg, length):
    """Of twelve directions around the curve a slit of 25 degrees lets one through at most, of 70 two."""
    angles = np.radians(np.linspace(slit_deg, 360, 73) - 12)
    ring = 2.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    low, high = (np.column_stack([np.full(len(ring), x), ring]) for x in (-5.0, 35.0))
    rows = np.arange(len(ring) - 1)
    faces = np.concatenate(
        [
            np.column_stack([rows, rows + 1, rows + 1 + len(ring)]),
            np.column_stack([rows, rows + 1 + len(ring), rows + len(ring)]),
        ]
    )
    tunnel = Surface("t", np.concatenate([low, high]), faces, "sheet", 2)
    assert measure_enclosed_length(line([0, 0, 0], [30, 0, 0]), tunnel, 2.5) == approx(length)
