"""The sampled posterior: draws, diagnostics, and its file (netCDF in the InferenceData layout).

Convergence is diagnosed by R-hat, autocorrelation times and effective sample sizes. A chain is one ensemble:
its draws are pooled over walkers step by step, and split in time. R-hat compares these halves; the
autocorrelation time says how many steps of an ensemble count for one, so that S steps of W walkers are worth
S W / tau draws. Both use normal scores of the ranks, so that heavy tails and the scale do not matter, and are
computed for every parameter, of the principal directions of the draws' covariance (the inverse of the
posterior's information: stiff and sloppy ones), and of the log posterior.
"""

import hashlib
import json
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import scipy

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, DataError
from needlefit.inference.sampling.posterior_file import read_numbers
from needlefit.project.input_files import parse_json

if TYPE_CHECKING:
    import arviz
    import xarray

#: the rule: R-hat below, at least this many autocorrelation times long, and more independent draws than this
#: in the bulk and in the tails of every ensemble
MAX_R_HAT, MIN_LENGTH_TAU, MIN_ESS = 1.01, 50, 400
MIN_ENSEMBLES = 4  #: fewest ensembles whose agreement means something
TAIL_QUANTILES = (0.05, 0.95)  #: quantiles whose indicators tell how well the tails are known
#: autocorrelations are summed up to this many autocorrelation times (Sokal): beyond is noise
WINDOW_TAU = 5.0


@dataclass(frozen=True)
class Convergence:
    """Convergence diagnostics of Q quantities and E ensembles of S steps."""

    quantities: tuple[str, ...]  #: parameters, "direction 1" (the stiffest) and on, "log posterior"
    r_hat: Floats  #: (Q,) naN with fewer than two ensembles
    tau: Floats  #: (E, Q) autocorrelation time in steps; infinite where all walkers stand still
    #: ess_bulk, ess_tail: (E, Q) independent draws, of the value and of the worse of the two tails
    ess_bulk: Floats
    ess_tail: Floats
    steps: int  #: of each ensemble

    @property
    def faults(self) -> tuple[str, ...]:
        """Which parts of the rule are not met; empty if all are."""
        found = []
        if len(self.tau) < MIN_ENSEMBLES:
            count = f"{len(self.tau)} independent ensembles, not {MIN_ENSEMBLES}"
            found.append(f"{count}: too few to show that they agree")
        if len(self.tau) > 1 and not np.all(self.r_hat < MAX_R_HAT):
            at = int(np.argmax(np.nan_to_num(self.r_hat, nan=np.inf)))
            found.append(f"R-hat of {self.quantities[at]} is {self.r_hat[at]:.3g}, not below {MAX_R_HAT}")
        longest = self.tau.max(axis=0)
        if not self.steps > MIN_LENGTH_TAU * longest.max():
            at = int(np.argmax(longest))
            times = f"{MIN_LENGTH_TAU} autocorrelation times of {longest[at]:.3g}"
            found.append(f"{self.steps} steps are not more than {times} ({self.quantities[at]})")
        for where, draws in (("", self.ess_bulk), (" in a tail", self.ess_tail)):
            fewest = draws.min(axis=0)
            if not fewest.min() > MIN_ESS:
                at = int(np.argmin(fewest))
                has = f"an ensemble has {fewest[at]:.0f} independent draws{where} of {self.quantities[at]}"
                found.append(f"{has}, not more than {MIN_ESS}")
        return tuple(found)


def assess_convergence(thetas: Floats, log_density: Floats, names: Sequence[str]) -> Convergence:
    """Return the convergence diagnostics of all quantities, given draws (E, S, W, P) of P `names`."""
    # principal coordinates of the draws' covariance, stiffest first: eigh sorts ascending variances
    _, axes = np.linalg.eigh(np.atleast_2d(np.cov(thetas.reshape(-1, thetas.shape[-1]).T)))  # (P, P)
    along = thetas @ axes
    directions = [f"direction {k + 1}" for k in range(along.shape[-1])]
    columns = np.concatenate([thetas, along, log_density[..., None]], axis=3)  # (E, S, W, Q)
    r_hats, taus, tails = [], [], []
    for values in np.moveaxis(columns, 3, 0):
        scores, folded = _normal_scores(values), _folded_scores(values)
        pooled = (values.shape[0], -1)  # step by step
        slower = [
            autocorrelation_times((values <= q).astype(np.float64))
            for q in np.quantile(values, TAIL_QUANTILES)
        ]
        r_hats.append(_r_hat(scores.reshape(pooled), folded.reshape(pooled)))
        taus.append(autocorrelation_times(scores))
        tails.append(np.maximum(*slower))
    size, tau = thetas.shape[1] * thetas.shape[2], np.stack(taus, axis=1)
    return Convergence(
        quantities=(*names, *directions, "log posterior"),
        r_hat=np.array(r_hats),
        tau=tau,
        ess_bulk=size / tau,
        ess_tail=size / np.stack(tails, axis=1),
        steps=int(thetas.shape[1]),
    )


def r_hat(chains: Floats) -> float:
    """Return R-hat of one quantity over chains (E, N); NaN with fewer than two chains or four draws.

    All draws are replaced by normal scores of their ranks, every chain is cut in halves, and with B the
    variance between and W the mean variance within halves of length n

        R-hat = sqrt( ((n - 1) W / n + B) / W ),    B = var(means of the halves).

    The larger of two values counts: of the draws, and of their distances from the median (which sees
    chains that differ in width alone). Vehtari et al., Bayesian Analysis 16 (2021) 667.
    """
    return _r_hat(_normal_scores(chains), _folded_scores(chains))


def _r_hat(scores: Floats, folded: Floats) -> float:
    """Return the larger R-hat of two kinds of scores (E, N)."""
    if len(scores) < 2 or scores.shape[1] < 4:
        return float("nan")
    return max(_split_r_hat(scores), _split_r_hat(folded))


def autocorrelation_times(series: Floats) -> Floats:
    """Return the integrated autocorrelation time (E,), in steps, of series (E, S, W) of E ensembles.

    tau = 1 + 2 sum_t rho(t), summed up to the first t >= 5 tau(t). rho is the mean over an ensemble's
    walkers of each one's autocorrelation (Goodman & Weare, Comm. App. Math. Comp. Sci. 5 (2010) 65, take that
    of the walkers' mean, which is the same where walkers are independent, and noisier). Unlike emcee's, it is
    taken about the mean of the whole ensemble: a walker that stays apart from the others counts as slow.
    """
    steps, found = series.shape[1], []
    # padded to twice the length: the FFT's correlation is circular
    size = scipy.fft.next_fast_len(2 * steps, real=True)
    for one in series:
        spectrum = scipy.fft.rfft(one - one.mean(), n=size, axis=0)
        covariance = scipy.fft.irfft(np.mean(np.abs(spectrum) ** 2, axis=1), n=size)[:steps]  # (S,)
        if not covariance[0] > 0.0:
            found.append(math.inf)
            continue
        times = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
        ends = np.flatnonzero(np.arange(steps) >= WINDOW_TAU * times)
        # anticorrelated draws do not count as more than independent ones: the estimate may be noise
        found.append(max(1.0, float(times[ends[0] if len(ends) else -1])))
    return np.array(found)


def _normal_scores(draws: Floats) -> Floats:
    ranks = scipy.stats.rankdata(draws, axis=None).reshape(draws.shape)
    # Blom's offsets 3/8 and 1/4, as in Vehtari et al.
    return scipy.special.ndtri((ranks - 0.375) / (draws.size + 0.25))


def _folded_scores(draws: Floats) -> Floats:
    return _normal_scores(np.abs(draws - np.median(draws)))


def _split_r_hat(chains: Floats) -> float:
    """Return R-hat of the halves of chains (E, N), as they are."""
    n = chains.shape[1] // 2
    halves = np.concatenate([chains[:, :n], chains[:, -n:]])  # (2 E, n)
    within = float(np.mean(np.var(halves, axis=1, ddof=1)))
    between = float(np.var(np.mean(halves, axis=1), ddof=1))
    # walkers that never moved: equal halves agree, others disagree without bound
    if within == 0.0:
        return 1.0 if between == 0.0 else float("inf")
    return float(np.sqrt(((n - 1) / n * within + between) / within))


PERCENTILES = (2.5, 16.0, 50.0, 84.0, 97.5)
NETCDF_ENGINE: Literal["h5netcdf"] = "h5netcdf"


@dataclass(frozen=True)
class Posterior:
    """A sampled posterior: draws of the free parameters; a chain is one independent ensemble of walkers."""

    names: tuple[str, ...]  #: free parameters, P of them
    #: (E, N, P) values (Pa, mm), not theta; within a chain the walkers of one step follow each other
    draws: Floats
    log_posterior: Floats  #: (E, N) log density in theta of each draw, not normalised
    walkers: int  #: per ensemble; N = steps kept * walkers
    moves: str  #: as the recipe names them
    acceptance: Floats  #: (E,) accepted part of each ensemble's proposals, burn-in included
    #: R-hat, autocorrelation times and independent draws, of the parameters and more
    convergence: Convergence
    burn_in: int  #: steps thrown away before
    failures: int  #: evaluations that were not a number, or raised, and were given density 0
    interrupted: bool
    #: by ensemble the first of these, theta and not values, to be simulated again
    failed: tuple[tuple[tuple[float, ...], ...], ...] = ()

    @property
    def steps(self) -> int:
        """Number of steps kept of each ensemble."""
        return int(self.draws.shape[1]) // self.walkers

    @property
    def r_hat(self) -> Floats:
        """R-hat of each parameter, (P,)."""
        # the quantities begin with the parameters; directions and log posterior follow
        return self.convergence.r_hat[: len(self.names)]

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the chains have not converged; empty if they have."""
        interrupted = ("the sampler was interrupted",) if self.interrupted else ()
        return interrupted + self.convergence.faults

    @property
    def converged(self) -> bool:
        """Whether the rule of convergence is met."""
        return not self.faults

    def percentiles(self, at: Sequence[float] = PERCENTILES) -> dict[str, tuple[float, ...]]:
        """Return each parameter's percentiles over all draws (Pa, mm)."""
        flat = self.draws.reshape(-1, len(self.names))
        table = np.percentile(flat, at, axis=0)  # (Q, P)
        return {name: tuple(column.tolist()) for name, column in zip(self.names, table.T, strict=True)}

    def to_xarray(self) -> "xarray.DataTree":
        """Return the groups of the netCDF file that `save` writes: draws in Pa and mm, by chain and draw."""
        import xarray

        return xarray.DataTree.from_dict(_make_datasets(self))

    def to_inference_data(self) -> "arviz.InferenceData":
        """Return the same groups for ArviZ.

        Raises ConfigError if ArviZ is not installed, or its version is 1 or later, which takes `to_xarray()`
        as it is.
        """
        try:
            with warnings.catch_warnings():
                # ArviZ announces its next version once a day
                warnings.simplefilter("ignore", FutureWarning)
                from arviz import InferenceData
        except ImportError:
            raise ConfigError(
                "there is no arviz.InferenceData here",
                expected="ArviZ, a version before 1",
                fix="pip install 'needlefit[arviz]', or use to_xarray(), which ArviZ 1 takes",
            ) from None
        groups: dict[str, Any] = dict(_make_datasets(self))
        return InferenceData(**groups)


def save(posterior: Posterior, path: Path) -> None:
    """Write the posterior as netCDF: groups `posterior`, `sample_stats` and `convergence`.

    The first two are InferenceData's, with dimensions chain and draw; the third has what the rule of
    convergence looks at, by chain and quantity. Each says in its attributes whether it was met. Equal
    posteriors give equal bytes: the file holds no time.
    """
    temporary = path.with_name(path.name + ".part")
    temporary.unlink(missing_ok=True)
    for group, dataset in _make_datasets(posterior).items():
        dataset.to_netcdf(temporary, group=group, engine=NETCDF_ENGINE, mode="a")
    temporary.replace(path)


def load(path: Path) -> Posterior:
    """Read the posterior that `save` wrote; DataError if the file is not a posterior, or is damaged."""
    attributes, numbers = read_numbers(path)
    try:
        posterior = _parse_posterior(attributes, numbers)
    except (DataError, KeyError, TypeError, ValueError) as error:
        raise _file_error(path, f"is not a posterior of needlefit ({type(error).__name__})") from error
    digest = attributes.get("posterior/sha256")  # files from before have none
    if not _is_consistent(posterior):
        raise _file_error(path, "its arrays do not fit together")
    if digest is not None and digest != _digest(posterior):
        raise _file_error(path, "its content was changed: the digest does not match")
    return posterior


def _file_error(path: Path, what: str) -> DataError:
    return DataError(
        what,
        where=str(path),
        expected="the file as `needlefit tune TARGET --sample` wrote it",
        fix="sample again with --sample, or take the file from a copy",
    )


def _is_consistent(posterior: Posterior) -> bool:
    """Return whether all arrays are of the same ensembles, draws, parameters and quantities."""
    rule, draws, walkers = posterior.convergence, posterior.draws, posterior.walkers
    ensembles, quantities = len(posterior.acceptance), len(rule.quantities)
    numbers = (draws, posterior.log_posterior, posterior.acceptance, rule.r_hat)
    return (
        ensembles > 0
        and 0 < len(posterior.names) <= quantities
        and posterior.log_posterior.shape == draws.shape[:2] == (ensembles, draws.shape[1])
        and 0 < walkers <= draws.shape[1]
        and posterior.acceptance.ndim == 1
        and rule.r_hat.shape == (quantities,)
        and all(getattr(rule, field).shape == (ensembles, quantities) for field in _PER_CHAIN.values())
        and all(array.dtype == np.float64 for array in numbers)
        and bool(np.isfinite(draws).all())
    )


def _digest(posterior: Posterior) -> str:
    rule = posterior.convergence
    header = [
        posterior.names, posterior.walkers, posterior.moves, posterior.burn_in, posterior.failures,
        int(posterior.interrupted), posterior.failed, rule.quantities, rule.steps, posterior.draws.shape,
    ]  # fmt: skip
    found = hashlib.sha256(json.dumps(header).encode("utf-8"))
    numbers = (posterior.draws, posterior.log_posterior, posterior.acceptance)
    for array in (*numbers, rule.r_hat, rule.tau, rule.ess_bulk, rule.ess_tail):
        # little endian on every machine, so that the digest does not depend on it
        found.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return found.hexdigest()


def _make_datasets(posterior: Posterior) -> "dict[str, xarray.Dataset]":
    import xarray  # late: a study without sampling does not wait for it

    chains, length = posterior.log_posterior.shape
    frame = {"chain": np.arange(chains), "draw": np.arange(length)}
    by = {"chain": np.arange(chains), "quantity": list(posterior.convergence.quantities)}
    draws = {name: (tuple(frame), posterior.draws[:, :, k]) for k, name in enumerate(posterior.names)}
    stats = {
        "lp": (tuple(frame), posterior.log_posterior),
        "acceptance_rate": (("chain",), posterior.acceptance),
    }
    found = {name: (tuple(by), getattr(posterior.convergence, field)) for name, field in _PER_CHAIN.items()}
    found["r_hat"] = (("quantity",), posterior.convergence.r_hat)
    header = _attributes(posterior)
    return {
        "posterior": xarray.Dataset(draws, coords=frame, attrs=header),
        "sample_stats": xarray.Dataset(stats, coords=frame, attrs=header),
        "convergence": xarray.Dataset(
            found, coords=by, attrs={**header, "steps": posterior.convergence.steps}
        ),
    }


#: variables of the group `convergence` by what holds them
_PER_CHAIN = {"autocorrelation_time": "tau", "ess_bulk": "ess_bulk", "ess_tail": "ess_tail"}


def _attributes(posterior: Posterior) -> dict[str, str | int]:
    return {
        "inference_library": "emcee",
        "state": "converged" if posterior.converged else f"NOT CONVERGED: {'; '.join(posterior.faults)}",
        "parameters": ",".join(posterior.names),
        "walkers": posterior.walkers,
        "moves": posterior.moves,
        "burn_in": posterior.burn_in,
        "failures": posterior.failures,
        "failed_theta": json.dumps(posterior.failed),
        "interrupted": int(posterior.interrupted),
        "converged": int(posterior.converged),
        "sha256": _digest(posterior),
    }


def _parse_posterior(attributes: Mapping[str, Any], numbers: Mapping[str, Floats]) -> Posterior:
    header = {name: attributes[f"posterior/{name}"] for name in _ATTRIBUTES}
    names = tuple(str(header["parameters"]).split(","))
    return Posterior(
        names=names,
        draws=np.stack([numbers[f"posterior/{name}"] for name in names], axis=2),
        log_posterior=numbers["sample_stats/lp"],
        walkers=int(header["walkers"]),
        moves=str(header["moves"]),
        acceptance=numbers["sample_stats/acceptance_rate"],
        convergence=Convergence(
            quantities=tuple(attributes["convergence/quantity"]),
            r_hat=numbers["convergence/r_hat"],
            **{field: numbers[f"convergence/{name}"] for name, field in _PER_CHAIN.items()},
            steps=int(attributes["convergence/steps"]),
        ),
        burn_in=int(header["burn_in"]),
        failures=int(header["failures"]),
        interrupted=bool(header["interrupted"]),
        failed=to_tuples(parse_json(str(header["failed_theta"]), "failed_theta")),
    )


def to_tuples(lists: Sequence[Sequence[Sequence[float]]]) -> tuple[tuple[tuple[float, ...], ...], ...]:
    """Return lists of thetas, by ensemble, as tuples."""
    return tuple(tuple(tuple(map(float, theta)) for theta in ensemble) for ensemble in lists)


_ATTRIBUTES = (
    "parameters", "walkers", "moves", "burn_in", "failures", "interrupted", "failed_theta",
)  # fmt: skip
