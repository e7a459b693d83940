"""What a measurement does to shapes: cross-sections, their file, and the likelihood of their spline."""

import math
from dataclasses import replace

import needles
import numpy as np
import pytest
from inference_cases import TRUTH, assert_one_density, medium
from numpy.testing import assert_allclose
from problem_cases import make_problem
from refusals import refusal

from needlefit.datasets.read import check, read
from needlefit.datasets.sections import format_sections
from needlefit.errors import DataError
from needlefit.geometry.smoothing_spline import SplineSections, design_matrix, fit_matrices, make_knots
from needlefit.inference.forward_model import predict
from needlefit.inference.likelihood.observation import whiten_deflections
from needlefit.inference.likelihood.observations import make_observation, read_points
from needlefit.inference.likelihood.observations.sections import SHARED_ERROR_LENGTH_MM, select_sections
from needlefit.schemas.dataset import MeasurementRecord
from needlefit.schemas.recipe import LikelihoodRecord

TRUE, MEDIUM = TRUTH | {"bevel_mm": needles.BEVEL}, medium()
KNOT, SIGMA = 15.0, 0.02


def with_sections(dataset, insertion):
    """Return an insertion measured without noise: a spline through cross-sections, with 30 mm of shaft."""
    shape = predict(TRUE, MEDIUM, insertion)
    s = np.append(np.arange(-30.0, insertion.depth - 4, 0.5), insertion.depth)
    q = s + 30.0
    places = read_points(insertion, shape, s)
    weights = np.where(np.arange(len(s)) % 7 == 3, 0.2, 1.0)
    sections = SplineSections(
        q, s, insertion.frame.to_world(places), weights, make_knots(0.0, q[-1], KNOT), SIGMA, 0.002
    )
    fit = fit_matrices(q, weights, sections.knots)
    along = np.linspace(30.0, q[-1], 80)
    smooth = design_matrix(along, sections.knots) @ fit.operator @ places
    return replace(insertion.with_points(smooth[:, :2]), sections=sections)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    dataset = read(needles.build(tmp_path_factory.mktemp("needles")))
    measured = tuple(with_sections(dataset, one) for one in dataset.insertions)
    return replace(dataset, insertions=measured)


def test_cross_sections_move_with_the_points(scanned):
    one = scanned.insertions[-1]
    moved = one.map_points(lambda points: points + np.array([0, 0.5, 0]))
    before, after = (make_observation(scanned, each) for each in (one, moved))
    assert after.rows == before.rows
    assert_allclose(after.measured - before.measured, [[0, 0.5]] * len(before.measured), atol=1e-9)


def test_smoothing_moves_points_but_not_residuals_and_the_gradient_is_exact(scanned):
    one = scanned.insertions[-1]
    stored = make_observation(scanned, one)
    shape = predict(TRUE, MEDIUM, one)
    at_truth = whiten_deflections(stored, read_points(one, shape, stored.nodes.s[0])[:, 1])
    assert stored.rows == len(fit_matrices(one.sections.q, one.sections.weights, one.sections.knots).spread)
    assert stored.nodes.s[0].min() < -25
    assert_allclose(at_truth, 0, atol=1e-6)
    points = make_observation(scanned, one, likelihood=LikelihoodRecord(measurement="points"))
    exact = read_points(one, shape, points.nodes.s[0])[:, 1]
    assert np.abs(exact - points.measured[:, 1]).max() > 0.002  # what the spline rounds, mm
    problem = make_problem(scanned, scanned.insertions[:2], MEDIUM)
    theta = problem.parameters.theta(TRUE) + 0.05
    assert_one_density(problem, theta, rtol=1e-4)


def test_an_error_along_one_direction_alone_is_one_of_that_direction(scanned):
    """Slices lean by 30 degrees from y."""
    one, hidden, angle = replace(scanned.insertions[-1], roll_sd=0.0), 0.3, math.radians(30.0)
    across = one.frame.rotation @ [0.0, math.cos(angle), math.sin(angle)]
    sections = replace(one.sections, shared_along=hidden * across)
    planned = replace(one, sections=sections, boundary_sd=0.0, depth_sd=0.0)
    data = replace(scanned, compared="space")
    plain, found, flat = map(make_observation, (data, data, scanned), (one, planned, planned))
    added, size = found.point_covariance - plain.point_covariance, len(plain.point_covariance) // 2
    along_z = added[size:, size:] / math.sin(angle) ** 2
    known = select_sections(one)
    fade = np.exp(-np.abs(known.s[:, None] - known.s) / SHARED_ERROR_LENGTH_MM)
    assert_allclose(along_z, hidden**2 * known.operator @ fade @ known.operator.T, atol=1e-12)
    assert_allclose(added[:size, :size], math.cos(angle) ** 2 * along_z, atol=1e-12)
    assert_allclose(added[:size, size:], math.sin(angle) * math.cos(angle) * along_z, atol=1e-12)
    assert_allclose(flat.point_covariance, found.point_covariance[:size, :size], atol=1e-15)


STORED = 'operator = "spline"\nsections = "sections/{id}.toml"'


def with_measurement(folder, text, sections=()):
    """A dataset in `folder` with this [measurement], and such files of cross-sections."""
    file = needles.build(folder)
    stated = f"[measurement]\n{text}\n\n[media.gel]"
    file.write_text(file.read_text().replace("[media.gel]", stated))
    for name, some in sections:
        path = file.parent / "sections" / f"{name}.toml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(format_sections(some))
    return file


def test_sections_are_written_and_read(scanned, tmp_path):
    along = {"shared_along": np.array([0.0, 0.1, -0.2])}
    folder = with_measurement(
        tmp_path / "plain",
        STORED,
        [(one.id, replace(one.sections, **along)) for one in scanned.insertions],
    ).parent
    assert check(folder) == []
    dataset = read(folder)
    assert dataset.measurement == MeasurementRecord(operator="spline", sections="sections/{id}.toml")
    assert_allclose(dataset.insertions[2].sections.shared_along, along["shared_along"])
    assert_allclose(dataset.insertions[2].sections.s, scanned.insertions[2].sections.s, atol=1e-5)
    file = folder / "sections/needle-3.toml"
    file.write_text(file.read_text().replace("q_mm = [0.0, 0.5", "q_mm = [0.5, 0.0"))
    assert [str(file) in str(fault.where) for fault in check(folder)] == [True]
    file.unlink()
    refusal(DataError, "", read, folder)


@pytest.mark.parametrize(("shift", "faults"), [((0, 0.01, 0), 0), ((0, 0.3, 0), 1), ((0, 0, 30), 1)])
def test_sections_off_the_centreline_or_without_knots_are_refused(scanned, tmp_path, shift, faults):
    pairs = [(one.id, one.sections) for one in scanned.insertions]
    name, some = pairs[2]
    pairs[2] = (name, replace(some, points=some.points + np.array(shift)))
    found = check(with_measurement(tmp_path / "n", STORED, pairs))
    assert [f"{name}.toml" in fault.where for fault in found] == [True] * faults
    pairs[2] = (name, replace(some, weights=np.where(some.q > 0.6 * some.q[-1], 0.0, some.weights)))
    (fault,) = check(with_measurement(tmp_path / "m", STORED, pairs))
    assert f"{name}.toml" in fault.where and fault.fix


def test_knots_closer_than_points_are_refused(tmp_path):
    file = with_measurement(tmp_path / "n", 'operator = "spline"\nknot_spacing_mm = 2.0')
    folder = file.parent / "centerlines"
    for path in folder.iterdir():  # a point every 3 mm or so
        head, *lines = path.read_text().splitlines()
        path.write_text("\n".join([head, *lines[:: len(lines) // 12], lines[-1]][: 1 + 14]) + "\n")
    text = "".join(line for line in file.read_text().splitlines(True) if not line.startswith('"'))
    file.write_text(text)
    (fault,) = check(file)
    assert f"{file}, key" in fault.where
    file.write_text(text.replace("knot_spacing_mm = 2.0", "knot_spacing_mm = 8.0"))
    dataset = read(file)
    assert all(np.isfinite(make_observation(dataset, one).whitening).all() for one in dataset.insertions)
