"""What is inferred of simulated needles, tracks and specimens: every number as it was."""

from dataclasses import replace

import numpy as np
import test_inference_document as document
from golden_numbers import assert_golden
from problem_cases import make_problem

from needlefit.datasets.read import read
from needlefit.project.locate import find_file
from needlefit.schemas.dataset import MeasurementRecord
from needlefit.schemas.recipe import LikelihoodRecord

DENSITIES = {  # by changes of the data set, its noise and the likelihood
    "sections": ({}, {}, {}),
    "points": ({}, {}, {"measurement": "points", "noise_scale": 1.7}),
    "independent": ({}, {}, {"noise": "independent", "depths": "fixed"}),
    "estimated": ({}, {}, {"noise_scale": "estimated", "measurement": "points"}),
    "fixed": ({}, {"point_sd": 0.05}, {"depths": "fixed", "bevel_spread": 0.0, "measurement": "points"}),
    "free": ({"pose": "free", "drop_proximal": 5.0}, {}, {}),
    "free, fixed": ({"pose": "free"}, {}, {"depths": "fixed", "noise_scale": 0.8}),
    "gaussian": ({"measurement": MeasurementRecord(operator="gaussian", width_mm=3.0)}, {}, {}),
    "spline": ({"measurement": MeasurementRecord(operator="spline", knot_spacing_mm=9.0)}, {}, {}),
    "bias": (
        {"measurement": MeasurementRecord(operator="unknown", bias_sd_mm=0.05, bias_length_mm=8.0)},
        {},
        {},
    ),
}


def test_densities_of_shipped_insertions():
    twin = read(find_file("dataset", "twin"))
    chosen = [one for one in twin.insertions if one.id in document.CHOSEN]
    found = {}
    for name, (changes, noise, how) in DENSITIES.items():
        dataset = replace(twin, noise=replace(twin.noise, **noise), **changes)
        plain = [replace(one, sections=None) for one in chosen] if "measurement" in changes else chosen
        one = make_problem(dataset, plain, document.MEDIUM, LikelihoodRecord(**how)).searched
        values = document.VALUES | {"bevel_spread": 0.07, "noise_scale": 1.3}
        theta = np.log([values[key] for key in one.parameters.free])
        residuals, jacobian = one.jacobian(theta)
        found[name] = [
            one.log_posterior(theta),
            -(residuals @ jacobian),
            one.objective(theta),
            len(residuals),
            np.linalg.norm(residuals),
        ]
    assert_golden("densities", found)
