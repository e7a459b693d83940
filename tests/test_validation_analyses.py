"""Simulated needles: of a dataset that is not scanned, and of a base that moves."""

from dataclasses import replace

import numpy as np
import pytest

from needlefit.datasets.read import read
from needlefit.inference.forward_model import PreparedModel, predict
from needlefit.inference.parameters import Parameters
from needlefit.mechanics.control import Bevel, Controls, ModelOptions, Step
from needlefit.mechanics.shape import compute_positions
from needlefit.mechanics.simulate import simulate_steps
from needlefit.mechanics.tissue import Tissue
from needlefit.project.locate import find_file
from needlefit.synthetic.build import build_dataset
from needlefit.synthetic.design import select_designs
from tests.inference_cases import NEEDLE, insertion, medium


def test_a_twin_that_is_not_scanned_is_nearly_the_one_that_was(tmp_path):
    """Same truth, same places of the markers: what differs is what voxels add."""
    names = ("phantom2-03", "phantom3-05", "chicken-02")
    found = {one.id: one for one in read(build_dataset(tmp_path, 1, select_designs(names))).insertions}
    scanned = {one.id: one for one in read(find_file("dataset", "twin")).insertions}
    for name in names:
        one, other = found[name], scanned[name]
        assert one.sequence == other.sequence and one.side == other.side
        assert one.depth == pytest.approx(other.depth, abs=0.2)
        assert one.deflection == pytest.approx(other.deflection, abs=0.3)
        np.testing.assert_allclose(one.boundaries, other.boundaries, atol=0.05)
        assert one.pose_shift_sd == pytest.approx(other.pose_shift_sd, rel=0.01)
    assert "Nothing was scanned" in read(tmp_path).notes[0]


MOVED = replace(insertion(40.0), base_moved=8.0)
THIN = medium(layers=1).model_copy(update={"thickness_mm": 5.0})
SOFT = {"mu1_pa": 3e3, "alpha1": 1.0, "bevel_mm": 0.03}


def test_a_base_that_moves_does_so_once_the_needle_is_in():
    bevel = Bevel(0.03)
    tissue = Tissue(np.array([3e-3]), np.array([1.0]), np.empty(0), np.array([5.0]))
    steps = (Step(40.0, bevel), Step(40.0, bevel, Controls(base_y=8.0)))
    shape = predict(SOFT, THIN, MOVED)
    assert shape.u == pytest.approx(
        simulate_steps(NEEDLE, tissue, steps, ModelOptions(tolerance=1e-9)).u, abs=1e-9
    )
    still = predict(SOFT, THIN, replace(MOVED, base_moved=0.0))
    assert shape.constraints == pytest.approx(still.constraints, abs=1e-9)  # the cut stays where it was
    assert compute_positions(shape, np.array([0.0]))[0, 1] > 1.0  # the tissue gives way at the entry
    (lanes,) = PreparedModel(THIN, [MOVED]).simulate([SOFT])
    assert lanes.u[0] == pytest.approx(shape.u, abs=1e-6)


def test_a_moved_bases_needle_has_exact_derivatives():
    parameters = Parameters.from_record(THIN)
    theta, s = parameters.theta(SOFT), np.linspace(0.0, 40.0, 9)
    ((_, (slopes,)),) = PreparedModel(THIN, [MOVED]).differentiate([SOFT], parameters, [s])
    for k, move in enumerate(1e-4 * np.eye(len(theta))):
        ends = [predict(parameters.values(theta + sign * move), THIN, MOVED) for sign in (1, -1)]
        by = (compute_positions(ends[0], s) - compute_positions(ends[1], s)) / 2e-4
        assert slopes[:, :, k] == pytest.approx(by, rel=1e-3, abs=1e-6)
