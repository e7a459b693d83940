"""Profile likelihoods of all parameters about a fit."""

from dataclasses import dataclass

import numpy as np

from needlefit.inference.fit import Fit
from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD, is_determined_by_data
from needlefit.inference.identifiability.information import add_estimated_noise, linearize
from needlefit.inference.identifiability.profile import (
    LikelihoodProfile,
    minimize_squares,
    summarize_profile,
    trace_profiles,
)
from needlefit.inference.problem import Problem
from needlefit.project.callbacks import Step, Stop, never_stop, no_step


@dataclass(frozen=True)
class FitProfiles:
    """The profiles of all parameters of one fit that are not held."""

    parameters: tuple[LikelihoodProfile, ...]  #: in the order of theta
    scale: float  #: what deviances were divided by: the reduced chi-square where it is above 1
    gain: float  #: how much higher than at the fit the log posterior is at the best point met on the way
    best: tuple[float, ...]  #: Theta of that point


def profile_parameters(
    problem: Problem,
    fit: Fit,
    jobs: int = 1,
    stop: Stop = never_stop,
    step: Step = no_step,
) -> FitProfiles:
    """Compute the profiles about a fit; the result does not depend on the number of threads.

    Where the dataset states no noise, the fit's residuals stand for it. `stop` leaves out what has not begun.
    `step` is as of `trace_profiles`.
    """
    parameters, theta = problem.parameters, np.array(fit.theta)
    noisy, theta = add_estimated_noise(problem, theta).searched, parameters.restrict(theta)
    optimum = minimize_squares(noisy, theta)
    scale = max(1.0, linearize(noisy, optimum.theta)[2])
    paths = trace_profiles(noisy, range(len(noisy.names)), optimum, jobs, stop, scale, step=step)
    profiles = tuple(summarize_profile(noisy, k, path, scale) for k, path in sorted(paths.items()))
    at_fit = noisy.jacobian(theta)[0]
    # residuals are those of the posterior: of a metric fit their gain means nothing
    gain = 0.5 * (float(at_fit @ at_fit) - optimum.value) if fit.minimized == "posterior" else 0.0
    return FitProfiles(profiles, scale, gain, tuple(parameters.extend(optimum.theta).tolist()))


def is_determined_by_profile(profile: LikelihoodProfile, prior_sd: float) -> bool:
    """Return whether its 95 % interval ends on both sides and is that of a determined parameter.

    `prior_sd` is the standard deviation of the prior of its coordinate of theta.
    """
    sd = (profile.high - profile.low) / (2 * NORMAL_95_HALF_WIDTH_SD)  # of a Gaussian of this interval
    return profile.closed and is_determined_by_data(profile.name, sd, prior_sd)
