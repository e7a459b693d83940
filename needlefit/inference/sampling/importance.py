"""Sample the posterior about a fit by adaptive importance sampling; compute the evidence.

A proposal adapts in rounds. Half of each round's draws come from a mixture of Student's t about the modes
and points along the profiles, half from one that is fitted to all draws so far: they are weighted by the
density of all rounds together (deterministic mixture weights; J.-M. Cornuet, J.-M. Marin, A. Mira, C. P.
Robert, Scand. J. Stat. 39 (2012) 798), and the mixture follows them by steps of expectation and maximisation
over all components (Rao-Blackwellised population Monte Carlo; O. Cappe, R. Douc, A. Guillin, J.-M. Marin,
C. P. Robert, Stat. Comput. 18 (2008) 447). While few draws carry all weight it follows a flatter density, so
that it grows along a ridge instead of falling on its best draws. What is returned are new draws, of the
adapted proposal alone (docs/inference.md, section 8). Parameters that the data leave as their flat prior has
them, such as most alphas, are drawn from that prior.

The largest weights are smoothed (`pareto_smoothing`).

The evidence, the integral of likelihood and prior over theta, is the mean of the weights. That of further
data is the ratio of two evidences: the mean of their likelihood over draws would be decided by a single draw.

The Laplace approximation is the Gaussian with the curvature of the density at its peak. Where that is not
finite the bounds decide.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from needlefit.arrays import Bools, Floats, log_sum_exp
from needlefit.inference.draws import Draws
from needlefit.inference.fit import EVALUATION_ERRORS, Fit
from needlefit.inference.identifiability.directions import UNINFORMED_SD_RATIO
from needlefit.inference.identifiability.information import add_estimated_noise
from needlefit.inference.identifiability.profile import (
    LocalMinimum,
    ProfileSteps,
    minimize_squares,
    trace_profiles,
)
from needlefit.inference.parameter_names import BEVEL_SPREAD
from needlefit.inference.parameters import Parameters
from needlefit.inference.prior_shift import draw_held, log_prior_integral
from needlefit.inference.problem import Problem
from needlefit.inference.sampling.interpolated_density import InterpolatedDensity
from needlefit.inference.sampling.pareto_smoothing import MAX_PARETO_K, smooth_weights
from needlefit.inference.sampling.student_mixture import StudentMixture, join_mixtures


@dataclass
class Evaluator:
    """Evaluate the density of many thetas at once; failures are counted and get density 0."""

    problem: Problem
    jobs: int  #: threads
    failures: int = 0  #: evaluations that were no number, or raised
    interpolated: InterpolatedDensity | None = None  #: in place of the problem's own

    def __call__(self, thetas: Floats) -> Floats:
        """Return the log densities (W,) of `thetas` (W, P)."""
        inside = np.all((thetas >= self.problem.lower) & (thetas <= self.problem.upper), axis=1)
        density = np.full(len(thetas), -math.inf)
        if np.any(inside):
            logs = self._guarded(thetas[inside])
            failed_rows = np.isnan(logs) | (logs == math.inf)
            density[inside] = np.where(failed_rows, -math.inf, logs)
            self.failures += int(failed_rows.sum())
        return density

    def _guarded(self, thetas: Floats) -> Floats:
        """Return the densities, NaN for a theta that raises: it is looked for one by one."""
        try:
            if self.interpolated is not None:
                return self.interpolated(thetas)
            return self.problem.log_posteriors(thetas, self.jobs)
        except EVALUATION_ERRORS:
            if len(thetas) == 1:
                return np.array([math.nan])
            return np.concatenate([self._guarded(theta[None]) for theta in thetas])


#: log densities (W,) of thetas (W, P), -inf where there is none
LogDensityFunction = Callable[[Floats], Floats]
UNIFORM_PRECISION = 12.0  #: precision of a uniform distribution, times its width squared
BOUND_MARGIN = 1e-3  #: distance from a bound, as a fraction of the range, to which a point at it is moved
DIFFERENCE_STEP = 0.1  #: step of second differences, in coordinates in which densities are about one wide


@dataclass(frozen=True)
class LaplaceApproximation:
    """The Gaussian at the peak: theta = centre + axes @ z, with z standard normal."""

    centre: Floats  #: (P,)
    axes: Floats  #: (P, P) columns: principal directions times their standard deviations, sloppiest first


def approximate_by_information(
    information: Floats, centre: Floats, lower: Floats, upper: Floats
) -> LaplaceApproximation:
    """Return the Laplace approximation at `centre` (P,) with its information (P, P), within the bounds (P,).

    It is no wider than a uniform distribution within them. Of a sum of squares the information is J^T J.
    """
    width = upper - lower
    inner = np.clip((centre - lower) / width, BOUND_MARGIN, 1 - BOUND_MARGIN)
    precisions, directions = np.linalg.eigh(information * np.outer(width, width))
    sds = 1.0 / np.sqrt(np.maximum(precisions, 0.0) + UNIFORM_PRECISION)
    return LaplaceApproximation(lower + inner * width, width[:, None] * directions * sds)


def difference_information(log_density: LogDensityFunction, theta: Floats) -> Floats:
    """Return the information (P, P) of a density at its peak (P,), by second differences; 0 where unknown."""
    from scipy.differentiate import hessian  # late: it takes 0.1 s to load

    def evaluate(points: Floats) -> Floats:  # (P, ...) -> (...)
        flat = np.moveaxis(points, 0, -1)
        return log_density(flat.reshape(-1, len(theta))).reshape(flat.shape[:-1])

    with np.errstate(invalid="ignore"):  # -inf less -inf: no curvature is known there
        information = hessian(evaluate, theta, maxiter=1, order=2, initial_step=DIFFERENCE_STEP).ddf
    return -np.nan_to_num(information, posinf=0.0, neginf=0.0)


@dataclass(frozen=True)
class Effort:
    """How many draws an importance sampler makes."""

    draws: int = 250  #: of each round in which the proposal adapts, within the bounds
    rounds: int = 14  #: the most of these
    min_ess: float = 1000.0  #: independent draws that those of the last proposal must be worth
    profiles: bool = True  #: whether the first draws are made along the profiles too, beside the modes

    @property
    def components(self) -> int:
        """Number of components of the mixture that is fitted to the draws."""
        return max(MIN_COMPONENTS, self.draws // DRAWS_PER_COMPONENT)


EFFORT = Effort()
#: effort of the second attempt; still far less than MCMC needs
LARGER_EFFORT = Effort(draws=1000)
EFFORTS = (EFFORT, LARGER_EFFORT)


@dataclass(frozen=True)
class Proposal:
    """What draws are proposed from: a mixture, and independently of it uniform parameters within bounds."""

    mixture: StudentMixture  #: of the parameters that are not uniform
    uniform: Bools  #: (P,)
    lower: Floats  #: (P,)
    upper: Floats  #: (P,)

    def draw(self, count: int, rng: np.random.Generator) -> Floats:
        """Return `count` draws (N, P); those of the mixture may lie outside the bounds."""
        return self._add_uniform(self.mixture.draw(count, rng), rng)

    def draw_inside(self, count: int, rng: np.random.Generator) -> tuple[Floats, float]:
        """Return `count` draws (N, P) within the bounds, and the logarithm of how many tries that took.

        Less that of the volume of the uniform ones: density and tries are then those of all parameters.
        There are fewer draws where hardly any is within the bounds.
        """
        ends = self.lower[~self.uniform], self.upper[~self.uniform]
        # the random numbers do not depend on how many fall outside the bounds
        kept, missing, tries = list[Floats](), count, 0
        for drawn in self.mixture.draw_parts(MAX_TRIES * count, rng, count):
            inside = np.flatnonzero(np.all((drawn >= ends[0]) & (drawn <= ends[1]), axis=1))[:missing]
            kept.append(drawn[inside])
            missing -= len(inside)
            tries += len(drawn) if missing else int(inside[-1]) + 1
            if not missing:
                break
        width = (self.upper - self.lower)[self.uniform]
        return self._add_uniform(np.concatenate(kept), rng), math.log(tries) - float(np.sum(np.log(width)))

    def _add_uniform(self, mixed: Floats, rng: np.random.Generator) -> Floats:
        """Return draws (N, P) of all parameters, given those of the mixture."""
        drawn = np.empty((len(mixed), len(self.uniform)))
        drawn[:, ~self.uniform] = mixed
        ends = self.lower[self.uniform], self.upper[self.uniform]
        drawn[:, self.uniform] = rng.uniform(*ends, size=(len(mixed), len(ends[0])))
        return drawn

    def log_density(self, thetas: Floats) -> Floats:
        """Return the log density (N,) at points (N, P) within the bounds, but for a constant."""
        return self.mixture.log_density(thetas[:, ~self.uniform])

    def add_fitted(
        self, draws: "WeightedDraws", rng: np.random.Generator, components: int, share: float, fits: int = 1
    ) -> "Proposal":
        """Return the proposal joined with mixtures fitted to draws, each from other beginnings.

        Together the `fits` have this `share`.
        """
        some = replace(draws, thetas=draws.thetas[:, ~self.uniform])
        mixtures = [self.mixture, *(_fit_mixture(some, rng, components) for _ in range(fits))]
        return replace(self, mixture=join_mixtures(mixtures, [1 - share, *[share / fits] * fits]))


@dataclass(frozen=True)
class WeightedDraws:
    """Weighted draws of a posterior, and how far their weights can be trusted."""

    thetas: Floats  #: (N, P)
    #: log_density, log_weights: (N,) the weights, smoothed, sum to 1
    log_density: Floats
    log_weights: Floats
    k: float  #: Pareto shape of the weights' tail
    min_ess: float  #: independent draws that they had to be worth
    #: logarithm of the density's integral within the bounds: of the mean weight before smoothing
    log_evidence: float
    proposal: Proposal | None = None  #: from which the last round was drawn: wide, with what the draws taught
    interpolated: InterpolatedDensity | None = None  #: by which the densities were evaluated
    #: of all free parameters: those held are not in `thetas`
    parameters: Parameters | None = None

    @property
    def effective_sample_size(self) -> float:
        """Effective number of independent draws."""
        return compute_ess(self.log_weights)

    @property
    def log_evidence_se(self) -> float:
        """Upper estimate of the Monte Carlo error of `log_evidence`, from the variance of the weights."""
        return 1 / math.sqrt(self.effective_sample_size)

    @property
    def certified(self) -> bool:
        """Whether the draws represent the posterior: Pareto k and effective sample size are good enough."""
        return self.k <= MAX_PARETO_K and self.effective_sample_size >= self.min_ess


#: smallest effective number of draws for each draw that is taken without replacement
MIN_ESS_PER_DISTINCT_DRAW = 3.0


def resample(draws: WeightedDraws, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return indices (`count`,) of draws that represent the posterior without weights.

    Of few, none stands twice: so they are nearer to independent ones (O. Skare, E. Bolviken, L. Holden,
    Scand. J. Stat. 30 (2003) 719). Of many that would flatten the weights, up to the proposal itself where
    all are taken: each then stands as often as its weight says, to within one (systematic resampling).
    """
    finite = np.flatnonzero(np.isfinite(draws.log_weights))
    if len(finite) >= count and draws.effective_sample_size >= MIN_ESS_PER_DISTINCT_DRAW * count:
        keys = draws.log_weights[finite] + rng.gumbel(
            size=len(finite)
        )  # the largest: drawn in turn by weight
        return finite[np.argsort(-keys, kind="stable")[:count]]
    ends = np.cumsum(np.exp(draws.log_weights[finite]))
    places = (np.arange(count) + rng.uniform()) / count * ends[-1]
    return rng.permutation(finite[np.searchsorted(ends[:-1], places, side="right")])


def compute_ess(log_weights: Floats) -> float:
    """Return the effective sample size of weighted draws, by the variance of their weights."""
    return float(np.exp(2 * log_sum_exp(log_weights) - log_sum_exp(2 * log_weights)))


def sample_by_importance(
    log_density: LogDensityFunction,
    approximations: Sequence[LaplaceApproximation],
    bounds: tuple[Floats, Floats],
    rng: np.random.Generator,
    efforts: Sequence[Effort] = EFFORTS,
    uniform: Bools | None = None,
) -> WeightedDraws:
    """Return weighted draws of a density within its bounds (P,), (P,), given its modes.

    Efforts are made in turn, until the weights can be trusted. Parameters marked `uniform` (P,) are proposed
    uniformly within their bounds, independently of the others.
    """
    uniform = np.zeros(len(bounds[0]), dtype=bool) if uniform is None else uniform
    for effort in efforts:
        by_importance = _make_effort(log_density, approximations, bounds, rng, effort, uniform)
        if by_importance.certified:
            break
    return by_importance


def _make_effort(
    log_density: LogDensityFunction,
    approximations: Sequence[LaplaceApproximation],
    bounds: tuple[Floats, Floats],
    rng: np.random.Generator,
    effort: Effort,
    uniform: Bools,
) -> WeightedDraws:
    # the mixture is one of the other parameters alone
    mixed = np.flatnonzero(~uniform)
    covariances = [(mode.axes @ mode.axes.T)[np.ix_(mixed, mixed)] for mode in approximations]
    factors = np.array([np.linalg.cholesky(covariance) for covariance in covariances])
    centres = np.array([mode.centre[mixed] for mode in approximations])
    shares = np.repeat(np.array([1 - WIDE_SHARE, WIDE_SHARE]) / len(factors), len(factors))
    mixture = StudentMixture(
        shares, np.concatenate([centres, centres]), np.concatenate([factors, WIDE_SCALE * factors])
    )
    first = proposal = Proposal(mixture, uniform, *bounds)
    thetas, density = np.empty((0, len(bounds[0]))), np.empty(0)
    proposals: list[tuple[Proposal, float]] = []  # with the logarithm of the number of tries
    proposed = np.empty((0, 0))  # log density and log tries (R, N) of every proposal at every draw
    while True:
        new, log_tries = proposal.draw_inside(effort.draws, rng)
        thetas, density = np.concatenate([thetas, new]), np.concatenate([density, log_density(new)])
        earlier = [tries + proposal.log_density(new) for proposal, tries in proposals]
        proposals.append((proposal, log_tries))
        log_proposed = log_tries + proposal.log_density(thetas)
        proposed = np.vstack(
            [np.hstack([proposed, np.reshape(earlier, (len(earlier), len(new)))]), log_proposed]
        )
        # deterministic mixture: each draw against all proposals together, not only the one that drew it
        heavy, wanted = log_sum_exp(proposed, axis=0), min(effort.min_ess, ADAPTED_ESS)
        draws = _weigh(thetas, density, heavy, wanted, proposal)
        adapted = draws.certified and len(proposals) >= MIN_ROUNDS
        if adapted or len(proposals) == effort.rounds:
            break
        proposal = first.add_fitted(draws, rng, effort.components, 0.5)
    last = draws
    # The weights of draws that a proposal was fitted to make the evidence too small: new draws of the last
    # proposal alone count. Where they do not suffice, another one is fitted to them.
    for _ in range(LAST_PROPOSALS * adapted):
        components = int(last.effective_sample_size / LAST_ESS_PER_COMPONENT)
        proposal = first.add_fitted(last, rng, max(components, effort.components), LAST_SHARE)
        thetas, density, log_proposed = np.empty((0, len(bounds[0]))), np.empty(0), np.empty(0)
        total = -math.inf
        for _ in range(math.ceil(LAST_DRAWS * effort.min_ess / DRAWS_AT_ONCE)):
            new, log_tries = proposal.draw_inside(DRAWS_AT_ONCE, rng)
            thetas, density = np.concatenate([thetas, new]), np.concatenate([density, log_density(new)])
            log_proposed = np.concatenate([log_proposed, proposal.log_density(new)])
            total = np.logaddexp(total, log_tries)
            last = _weigh(thetas, density, total + log_proposed, effort.min_ess, proposal)
            if last.certified:
                return last
    return replace(draws, min_ess=effort.min_ess)  # of draws to which a proposal was fitted


def _weigh(
    thetas: Floats, density: Floats, proposed: Floats, min_ess: float, proposal: Proposal
) -> WeightedDraws:
    """Return draws (N, P) weighted by their density over that of all proposals and tries together, (N,)."""
    heavy = density - proposed
    log_evidence = float(log_sum_exp(heavy))
    return WeightedDraws(thetas, density, *smooth_weights(heavy), min_ess, log_evidence, proposal)


EM_STEPS = 6  #: number of steps of expectation and maximisation between rounds
#: effective number of draws for each component, by which a flatter density is chosen
MIN_ESS_PER_COMPONENT = 12.0
MIN_COMPONENTS = 2  #: smallest number of components of the fitted mixture
DRAWS_PER_COMPONENT = 125  #: number of draws of one round for each component
MIN_ROUNDS = 3  #: smallest number of rounds after which a proposal may count as adapted
ADAPTED_ESS = 250.0  #: effective number of draws of all rounds from which on a proposal counts as adapted
MAX_TRIES = 50  #: largest number of tries for a draw within the bounds
LAST_ESS_PER_COMPONENT = 30.0  #: effective number of draws for each component of the last proposal
LAST_SHARE = 0.7  #: share of the fitted part of the last proposal
LAST_DRAWS = 4.0  #: largest number of draws of the last proposal, over the wanted effective number
LAST_PROPOSALS = 3  #: largest number of last proposals
DRAWS_AT_ONCE = 1000  #: number of draws of the last proposal between two checks of their weights
WIDENING = 1.4  #: factor on the fitted scales, so that tails are reached
WIDE_SHARE = 0.3  #: share of the first mixture that is wider, for ridges that bend away where they begin
WIDE_SCALE = 3.0  #: factor by which that share is wider
MIN_COVARIANCE_FRACTION = 1e-4  #: smallest covariance of a component, as a fraction of that of all draws


def _fit_mixture(draws: WeightedDraws, rng: np.random.Generator, components: int) -> StudentMixture:
    """Return a mixture fitted to the draws as they stand for the density, or a power of it."""
    weights = _flatten_weights(draws, MIN_ESS_PER_COMPONENT * components)
    thetas = draws.thetas
    mean = weights @ thetas
    whole = (thetas - mean).T @ ((thetas - mean) * weights[:, None])
    least = MIN_COVARIANCE_FRACTION * whole + 1e-12 * np.eye(len(mean))
    # components that share the volume of the whole covariance among them
    factor = components ** (-1 / len(mean)) * np.linalg.cholesky(whole + least)
    centres = thetas[rng.choice(len(thetas), size=components, p=weights)]
    fitted = StudentMixture(
        np.full(components, 1 / components), centres, np.repeat(factor[None], components, 0)
    )
    for _ in range(EM_STEPS):
        fitted = fitted.refit(thetas, weights, least)
    return StudentMixture(fitted.weights, fitted.centres, WIDENING * fitted.factors)


def _flatten_weights(draws: WeightedDraws, fewest: float) -> Floats:
    """Return weights (N,) of the highest power, at most 1, of the density that leaves `fewest` independent
    draws.
    """
    finite = np.flatnonzero(np.isfinite(draws.log_weights))
    density = draws.log_density[finite]
    drawn = density - draws.log_weights[finite]  # log density of all rounds together, but for a constant

    def log_weights(power: float) -> Floats:
        return power * (density - density.max()) - drawn

    def missing(power: float) -> float:
        return compute_ess(log_weights(power)) - min(fewest, 0.5 * len(finite))

    power = 1.0
    if missing(1.0) < 0:
        # the effective sample size falls as the power rises; at power 0 it is the largest possible
        power = float(brentq(missing, 0.0, 1.0, xtol=1e-3)) if missing(0.0) > 0 else 0.0
    weights = np.zeros(len(draws.thetas))
    weights[finite] = np.exp(log_weights(power) - log_sum_exp(log_weights(power)))
    return weights


#: largest difference of the log density of a start's end from the best one's with which it is a mode
MAX_LOG_DENSITY_GAP = 10.0
#: distance of two ends, as a fraction of the bounds' distance, below which they are one mode
MIN_MODE_DISTANCE = 1e-3
#: steps of the profiles along which draws begin: coarse, down to densities of a thousandth of the peak's
PROFILE_STEPS = ProfileSteps(stop_deviance=14.0, root_rise=1.2, min_gain=0.5)


def find_modes(fit: Fit, width: Floats) -> Floats:
    """Return the distinct modes (M, P) that a fit found, the best first; `width` (P,) of the bounds."""
    starts = sorted(fit.starts, key=lambda start: (start.objective, start.index))
    plausible = [start for start in starts if start.objective <= fit.objective + MAX_LOG_DENSITY_GAP]
    modes: list[Floats] = []
    for end in (np.array(start.theta) for start in plausible):
        if all(np.max(np.abs(end - other) / width) > MIN_MODE_DISTANCE for other in modes):
            modes.append(end)
    return np.array(modes)


def sample_about_modes(
    problem: Problem,
    modes: Sequence[LocalMinimum],
    rng: np.random.Generator,
    jobs: int = 1,
    efforts: Sequence[Effort] = EFFORTS,
) -> WeightedDraws:
    """Return weighted draws of a posterior whose modes, the best first, a search by Gauss-Newton has met.

    Draws and modes are of the parameters that are searched.
    """
    parameters, problem = problem.parameters, problem.searched
    uniform = find_uninformed(problem, modes[0])
    traced = list_profile_points(problem, modes[0], jobs, uniform) if efforts[0].profiles else []
    points = [*modes, *traced]
    bounds = (problem.lower, problem.upper)
    # each with the information of its search: that costs no density
    approximations = [approximate_by_information(point.information, point.theta, *bounds) for point in points]
    nodes = None if problem.plain is None else InterpolatedDensity(problem, jobs)
    evaluator = Evaluator(problem, jobs, interpolated=nodes)
    about_modes = sample_by_importance(evaluator, approximations, bounds, rng, efforts, uniform)
    log_evidence = about_modes.log_evidence + log_prior_integral(parameters)
    return replace(about_modes, interpolated=nodes, log_evidence=log_evidence, parameters=parameters)


def find_uninformed(problem: Problem, mode: LocalMinimum) -> Bools:
    """Return which parameters (P,) have a flat prior to which the data add nothing, by the information.

    At least one parameter is not among them.
    """
    width = problem.upper - problem.lower
    axes = approximate_by_information(mode.information, mode.theta, problem.lower, problem.upper).axes
    ratios = np.sqrt(UNIFORM_PRECISION * np.sum(axes**2, axis=1)) / width
    informed = problem.parameters.prior.stated_names
    uninformed = np.array([name not in informed for name in problem.names]) & (ratios >= UNINFORMED_SD_RATIO)
    uninformed[int(np.argmin(ratios))] = False
    return uninformed


def list_profile_points(
    problem: Problem, mode: LocalMinimum, jobs: int, uninformed: Bools
) -> list[LocalMinimum]:
    """Return points along the profiles, about a mode, of parameters neither tied nor a spread.

    Nor of those marked `uninformed` (P,), which are drawn without.

    A plateau beside the peak, where the data no longer tell a layer from none, may hold a tenth of the
    posterior and end far from the peak. A mixture that grows from the peak alone may never reach it, and the
    weights do not show it.
    """
    stated = {*(tie.name for tie in problem.parameters.prior.ties), BEVEL_SPREAD}
    traced = [k for k, name in enumerate(problem.names) if name not in stated and not uninformed[k]]
    paths = trace_profiles(problem.near(mode.theta), traced, mode, jobs, steps=PROFILE_STEPS)
    # without the optimum, which comes first
    points = [point for path in paths.values() for point in path.points[1:]]
    return [point for point in points if point.value - mode.value <= 2 * MAX_LOG_DENSITY_GAP]


def sample_about_fit(
    problem: Problem,
    fit: Fit,
    rng: np.random.Generator,
    jobs: int = 1,
    efforts: Sequence[Effort] = EFFORTS,
) -> WeightedDraws:
    """Return weighted draws of the posterior about a fit with at least one free parameter.

    Where the dataset states no noise, the fit's residuals stand for it; a fit of the metric objective is
    first led to the posterior's peak. What the fit held is held here, too.
    """
    theta = np.array(fit.theta)
    noisy = add_estimated_noise(problem.holding(fit.held), theta)
    # the minimum of the metric is no mode of the posterior
    of_posterior = fit.minimized == "posterior"
    ends = find_modes(fit, problem.upper - problem.lower) if of_posterior else theta[None]
    modes = [minimize_squares(noisy.searched, end) for end in noisy.parameters.restrict(ends)]
    return sample_about_modes(noisy, modes, rng, jobs, efforts)


def resample_draws(draws: WeightedDraws, count: int, rng: np.random.Generator) -> Draws:
    """Return `count` unweighted draws; their `faults` say so if the weights are not certified."""
    warning = (
        f"draws by importance are not certified: Pareto k is {draws.k:.2f} (at most {MAX_PARETO_K}), the "
        f"effective sample size is {draws.effective_sample_size:.0f} (at least {draws.min_ess:.0f})"
    )
    thetas = draws.thetas[resample(draws, count, rng)]
    if draws.parameters is not None:  # of a stream of its own: the others do not depend on it
        thetas = draw_held(draws.parameters, thetas, rng.spawn(1)[0])
    faults = () if draws.certified else (warning,)
    return Draws(thetas, "importance", faults, draws.k, draws.effective_sample_size)
