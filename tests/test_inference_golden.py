"""What is inferred of simulated needles, tracks and specimens: every number as it was."""

from dataclasses import replace

import numpy as np
import test_inference_document as document
from golden_numbers import assert_golden
from inference_cases import TRUTH, dataset, insertion, measure, medium, problem, two_layers
from problem_cases import make_problem
from test_inference_identify import fit_at, tied_problem
from test_inference_predict import measured as bent

from needlefit.datasets.insertion import Noise
from needlefit.datasets.read import read
from needlefit.inference.baseline_fit import fit_baselines
from needlefit.inference.identifiability.identify import identify, profile_parameters
from needlefit.inference.predict import draw_from_prior
from needlefit.project.locate import find_file
from needlefit.schemas.dataset import MeasurementRecord
from needlefit.schemas.recipe import LikelihoodRecord, WeightsRecord


def rng():
    return np.random.default_rng(11)


def test_verdicts_profiles_and_designs():
    tied, layers = tied_problem(spread=1.2), two_layers(count=2)
    values = {**TRUTH, "mu3_pa": 3e5, "alpha3": 1.0}
    free = medium(1, alpha1={"bounds": [-3, 5]})
    alone = problem(free, [measure(TRUTH, free, insertion(35.0))], noise=Noise(point_sd=0.02))
    bumpy = []
    for one in alone.insertions:
        points = one.points.copy()
        points[:, :2] += 0.02 * np.sin(points[:, :1])
        bumpy.append(replace(one, points=points))
    found = {
        "tied": identify(tied, fit_at(tied, values)),
        "free": identify(problem(free, bumpy), fit_at(problem(free, bumpy), TRUTH)),
        "profiles": profile_parameters(layers, fit_at(layers, TRUTH)),
        "prior": draw_from_prior(tied.parameters, 9, rng()),
    }
    assert_golden("identifiability", found, rtol=1e-4)


def test_baselines():
    shapes = [bent(d, (1e-3, 1e-5, 1e-7), side) for d, side in ((80.0, 1), (95.0, -1))]
    found = {
        pose: {
            name: [*one.coefficients, one.curve(shapes[0])(np.array([20.0, 77.0]))[:, :2]]
            for name, one in fit_baselines(dataset(shapes, pose=pose, drop=10.0), shapes).items()
        }
        for pose in ("known", "free")
    }
    assert_golden("baselines", found)


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
    twin, weights = read(find_file("dataset", "twin")), WeightsRecord()
    chosen = [one for one in twin.insertions if one.id in document.CHOSEN]
    found = {}
    for name, (changes, noise, how) in DENSITIES.items():
        dataset = replace(twin, noise=replace(twin.noise, **noise), **changes)
        plain = [replace(one, sections=None) for one in chosen] if "measurement" in changes else chosen
        one = make_problem(dataset, plain, document.MEDIUM, weights, LikelihoodRecord(**how)).searched
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
