"""Likelihoods that are wrong on purpose: a check that does not notice them proves nothing."""

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from needlefit.datasets.insertion import Insertion
from needlefit.inference.problem import Problem
from needlefit.inference.ties import NOISE_SCALE

Control = Literal["sigma", "prior", "pose", "shuffled"]

CONTROLS: tuple[Control, ...] = get_args(Control)

TOO_SURE = 0.7
"""What the control "sigma" takes the deviations of noise and pose for, as a part of the true ones."""


def broken(problem: Problem, control: Control | None, scale: float) -> Problem:
    """Return the problem as a wrong computation would have it; `scale` is the true one of the noise.

    "sigma" underrates noise and pose and does not estimate them, "pose" takes every pose as it was measured,
    "shuffled" confounds the shapes of the shallowest and the deepest insertion (of one alone the side of its
    bevel). "prior" leaves the problem as it is, for there nothing is inferred at all.
    """
    if control == "sigma":
        how = problem.likelihood.model_copy(update={"noise_scale": TOO_SURE * scale})
        parameters = problem.parameters
        if NOISE_SCALE in parameters.names:
            others = [name for name in parameters.free if name != NOISE_SCALE]
            parameters = parameters.with_only(others, {NOISE_SCALE: TOO_SURE * scale})
        return replace(problem, likelihood=how, parameters=parameters)
    if control == "pose":
        noise = replace(problem.dataset.noise, registration_mean=0.0)
        dataset = replace(problem.dataset, noise=noise, pose="known")
        sure = (replace(one, pose_shift_sd=0.0, pose_angle_sd=0.0) for one in problem.insertions)
        return replace(problem, dataset=dataset, insertions=tuple(sure))
    if control == "shuffled":
        return replace(problem, insertions=_shuffled(problem.insertions))
    return problem


def _shuffled(insertions: tuple[Insertion, ...]) -> tuple[Insertion, ...]:
    if len(insertions) == 1:
        return (replace(insertions[0], side=-insertions[0].side),)
    order = np.argsort([one.depth for one in insertions], kind="stable")
    first, last = int(order[0]), int(order[-1])
    swapped = list(insertions)
    swapped[first] = _with_shape(insertions[first], insertions[last])
    swapped[last] = _with_shape(insertions[last], insertions[first])
    return tuple(swapped)


def _with_shape(one: Insertion, other: Insertion) -> Insertion:
    """Return an insertion with the measured shape of another."""
    return replace(
        one,
        planar=other.planar,
        centerline=other.centerline,
        out_of_plane=other.out_of_plane,
        sd=other.sd,
    )
