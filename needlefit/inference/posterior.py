"""The posterior: draws, what they say, and their file (netCDF in the InferenceData layout)."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]

PERCENTILES = (2.5, 16.0, 50.0, 84.0, 97.5)
R_HAT, LENGTH_IN_TAU = 1.01, 50
"""A chain has converged if R-hat is at most this, and it is at least this many autocorrelation times long."""

ENGINE: Literal["h5netcdf"] = "h5netcdf"


@dataclass(frozen=True)
class Posterior:
    """Draws of the free parameters; a chain is one independent ensemble of walkers.

    Attributes
    ----------
    names : tuple of str
        Free parameters, P of them.
    draws : (E, N, P) array
        Values (Pa, mm), not theta; within a chain the walkers of one step follow each other.
    log_posterior : (E, N) array
        Log density in theta of each draw, not normalised.
    walkers : int
        Per ensemble; N = steps kept * walkers.
    acceptance : (E,) array
        Accepted part of each ensemble's proposals.
    autocorrelation_time : (E, P) array
        Estimate, in steps; NaN where the chain is too short or stands still.
    r_hat : (P,) array
        Rank-normalised, split, over the ensembles; NaN with fewer than two.
    burn_in : int
        Steps thrown away before.
    failures : int
        Evaluations that were not a number, or raised, and were given density 0.
    interrupted : bool
    failed : tuple of tuples of theta
        By ensemble the first of these, theta and not values, to be simulated again.
    """

    names: tuple[str, ...]
    draws: Floats
    log_posterior: Floats
    walkers: int
    acceptance: Floats
    autocorrelation_time: Floats
    r_hat: Floats
    burn_in: int
    failures: int
    interrupted: bool
    failed: tuple[tuple[tuple[float, ...], ...], ...] = ()

    @property
    def steps(self) -> int:
        """Steps kept of each ensemble."""
        return int(self.draws.shape[1]) // self.walkers

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the chains have not converged; empty if they have."""
        found = []
        if self.interrupted:
            found.append("the sampler was interrupted")
        if len(self.draws) < 2:
            found.append("a single ensemble cannot show that it has converged")
        elif not np.all(self.r_hat <= R_HAT):
            found.append(f"R-hat is {np.max(self.r_hat):.3g}, above {R_HAT}")
        longest = np.max(self.autocorrelation_time, initial=0.0)
        if not self.steps >= LENGTH_IN_TAU * longest:
            found.append(
                f"{self.steps} steps are less than {LENGTH_IN_TAU} autocorrelation times of {longest:.3g}"
            )
        return tuple(found)

    @property
    def converged(self) -> bool:
        """Whether R-hat and length say so."""
        return not self.faults

    def percentiles(self, at: Sequence[float] = PERCENTILES) -> dict[str, tuple[float, ...]]:
        """Return each parameter's percentiles over all draws (Pa, mm)."""
        flat = self.draws.reshape(-1, len(self.names))
        table = np.percentile(flat, at, axis=0)  # (Q, P)
        return {name: tuple(column.tolist()) for name, column in zip(self.names, table.T, strict=True)}


def save(posterior: Posterior, path: Path) -> None:
    """Write the posterior as netCDF: groups `posterior` and `sample_stats`, dimensions chain and draw.

    Equal posteriors give equal bytes: the file holds no time.
    """
    temporary = path.with_name(path.name + ".part")
    frame = ("chain", "draw")
    draws = {name: (frame, posterior.draws[:, :, k]) for k, name in enumerate(posterior.names)}
    stats = {
        "lp": (frame, posterior.log_posterior),
        "acceptance_rate": (("chain",), posterior.acceptance),
        **{
            f"autocorrelation_time_{name}": (("chain",), posterior.autocorrelation_time[:, k])
            for k, name in enumerate(posterior.names)
        },
    }
    temporary.unlink(missing_ok=True)
    _write(temporary, "posterior", draws, posterior)
    _write(temporary, "sample_stats", stats, posterior)
    temporary.replace(path)


def load(path: Path) -> Posterior:
    """Read what `save` wrote; DataError if the file is no posterior."""
    import xarray

    try:
        with (
            xarray.open_dataset(path, group="posterior", engine=ENGINE) as draws,
            xarray.open_dataset(path, group="sample_stats", engine=ENGINE) as stats,
        ):
            return _read(draws, stats)
    except (OSError, KeyError, ValueError) as error:
        raise DataError(
            f"is no posterior of needlefit: {error}",
            where=str(path),
            mend="write it again with `needlefit tune TARGET --sample`",
        ) from None


def _write(
    path: Path, group: str, variables: Mapping[str, tuple[tuple[str, ...], Floats]], of: Posterior
) -> None:
    import xarray  # late: a study without sampling does not wait for it

    chains, length = of.log_posterior.shape
    dataset = xarray.Dataset(
        variables, coords={"chain": np.arange(chains), "draw": np.arange(length)}, attrs=_attributes(of)
    )
    dataset.to_netcdf(path, group=group, engine=ENGINE, mode="a")


def _attributes(of: Posterior) -> dict[str, str | int | Floats]:
    return {
        "inference_library": "emcee",
        "parameters": ",".join(of.names),
        "walkers": of.walkers,
        "burn_in": of.burn_in,
        "failures": of.failures,
        "failed_theta": json.dumps(of.failed),
        "interrupted": int(of.interrupted),
        "converged": int(of.converged),
        "r_hat": of.r_hat,
    }


def _read(draws: "xarray.Dataset", stats: "xarray.Dataset") -> Posterior:
    names = tuple(str(draws.attrs["parameters"]).split(","))
    return Posterior(
        names=names,
        draws=np.stack([draws[name].to_numpy() for name in names], axis=2),
        log_posterior=stats["lp"].to_numpy(),
        walkers=int(draws.attrs["walkers"]),
        acceptance=stats["acceptance_rate"].to_numpy(),
        autocorrelation_time=np.stack(
            [stats[f"autocorrelation_time_{name}"].to_numpy() for name in names], axis=1
        ),
        r_hat=np.atleast_1d(draws.attrs["r_hat"]),
        burn_in=int(draws.attrs["burn_in"]),
        failures=int(draws.attrs["failures"]),
        interrupted=bool(draws.attrs["interrupted"]),
        failed=tuple(
            tuple(tuple(theta) for theta in ensemble) for ensemble in json.loads(draws.attrs["failed_theta"])
        ),
    )
