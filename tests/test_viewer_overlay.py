"""The errors of a needle on the page, against closed forms."""

import math
import shutil

import numpy as np
import pytest
from inference_cases import TRUTH, dataset, insertion, measure, medium
from page_files import run_node
from pytest import approx

from needlefit.mechanics.shape import NeedleShape
from needlefit.viewer.measured import encode_insertion

PLAN = insertion(40.0, [17.5], (1, 2))
MEASURED = measure(TRUTH, medium(), PLAN)


def straight(depth, status="converged"):
    x, none = np.array([depth - 150.0, depth]), np.zeros(2)
    cut = np.zeros((1, 3)), np.zeros((1, 4))
    return NeedleShape(x, none, none, none, none, *cut, status, 0)  # type: ignore[arg-type]


def oblique(angle, depth=40.0):
    """A measured needle that runs straight at an angle to the entry axis."""
    s = np.linspace(0, depth, 9)
    planar = s[:, None] * [math.cos(angle), math.sin(angle)]
    return insertion(depth).with_points(planar)


ERRORS = """
import {readFileSync} from 'node:fs'
const {computeErrors} = await import(PAGE + 'model/errors.js')
const {measured, depths} = JSON.parse(readFileSync(0, 'utf8'))
const positions = (s) => s.flatMap((one) => [one, 0])
const straight = (depth) => ({shape: {x: [depth - 150, depth], depth, planes: 1}, positions})
console.log(JSON.stringify(depths.map((depth) => computeErrors(straight(depth), measured))))
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="no Node.js")
def test_errors_up_to_the_depth_in_common():
    """Of straight needles of some depths from one that is measured at an angle."""
    angle, depths, one = 0.05, (12.5, 39.999, 40.0, 55.0), oblique(0.05)
    measured = encode_insertion(dataset([one]), one, 0.2, straight(one.depth))
    for depth, found in zip(depths, run_node(ERRORS, {"measured": measured, "depths": depths}), strict=True):
        upto = min(depth, 40.0)
        chord = 2 * upto * math.sin(angle / 2)
        assert found["te_mm"] == approx(chord)
        assert found["ipe_mean_mm"] == approx(chord / 2)
        assert found["edp_percent"] == approx(100 * chord / (upto * math.sin(angle)))
        assert (found["upto_mm"], found["whole"]) == (upto, depth == 40.0)
