"""The posterior: draws, what they say, and their file (netCDF in the InferenceData layout)."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from needlefit.errors import DataError
from needlefit.inference.sampling.convergence import Convergence
from needlefit.inference.sampling.posterior_file import read_numbers
from needlefit.project.input_files import parse_json

if TYPE_CHECKING:
    import xarray

Floats = NDArray[np.float64]

PERCENTILES = (2.5, 16.0, 50.0, 84.0, 97.5)
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
    moves : str
        As the recipe names them.
    acceptance : (E,) array
        Accepted part of each ensemble's proposals, burn-in included.
    convergence : Convergence
        R-hat, autocorrelation times and independent draws, of the parameters and more.
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
    moves: str
    acceptance: Floats
    convergence: Convergence
    burn_in: int
    failures: int
    interrupted: bool
    failed: tuple[tuple[tuple[float, ...], ...], ...] = ()

    @property
    def steps(self) -> int:
        """Steps kept of each ensemble."""
        return int(self.draws.shape[1]) // self.walkers

    @property
    def r_hat(self) -> Floats:
        """Of the parameters, (P,)."""
        return self.convergence.r_hat[: len(self.names)]

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the chains have not converged; empty if they have."""
        interrupted = ("the sampler was interrupted",) if self.interrupted else ()
        return interrupted + self.convergence.faults

    @property
    def converged(self) -> bool:
        """Whether the rule is met."""
        return not self.faults

    def percentiles(self, at: Sequence[float] = PERCENTILES) -> dict[str, tuple[float, ...]]:
        """Return each parameter's percentiles over all draws (Pa, mm)."""
        flat = self.draws.reshape(-1, len(self.names))
        table = np.percentile(flat, at, axis=0)  # (Q, P)
        return {name: tuple(column.tolist()) for name, column in zip(self.names, table.T, strict=True)}


def save(posterior: Posterior, path: Path) -> None:
    """Write the posterior as netCDF: groups `posterior`, `sample_stats` and `convergence`.

    The first two are InferenceData's, with dimensions chain and draw; the third has what the rule of
    convergence looks at, by chain and quantity. Each says in its attributes whether it was met. Equal
    posteriors give equal bytes: the file holds no time.
    """
    temporary = path.with_name(path.name + ".part")
    temporary.unlink(missing_ok=True)
    for group, dataset in _datasets(posterior).items():
        dataset.to_netcdf(temporary, group=group, engine=ENGINE, mode="a")
    temporary.replace(path)


def load(path: Path) -> Posterior:
    """Read what `save` wrote; DataError if the file is not a posterior, or is damaged."""
    attributes, numbers = read_numbers(path)
    try:
        posterior = _read(attributes, numbers)
    except (DataError, KeyError, TypeError, ValueError) as error:
        raise _unusable(path, f"is not a posterior of needlefit ({type(error).__name__})") from error
    digest = attributes.get("posterior/sha256")  # files from before have none
    if not _alike(posterior):
        raise _unusable(path, "its arrays do not fit together")
    if digest is not None and digest != _digest(posterior):
        raise _unusable(path, "its content was changed: the digest does not match")
    return posterior


def _unusable(path: Path, what: str) -> DataError:
    return DataError(
        what,
        where=str(path),
        expected="the file as `needlefit tune TARGET --sample` wrote it",
        fix="sample again with --sample, or take the file from a copy",
    )


def _alike(of: Posterior) -> bool:
    """Return whether all arrays are of the same ensembles, draws, parameters and quantities."""
    ensembles, quantities = len(of.acceptance), len(of.convergence.quantities)
    numbers = (of.draws, of.log_posterior, of.acceptance, of.convergence.r_hat)
    return (
        ensembles > 0
        and 0 < len(of.names) <= quantities
        and of.log_posterior.shape == of.draws.shape[:2] == (ensembles, of.draws.shape[1])
        and 0 < of.walkers <= of.draws.shape[1]
        and of.acceptance.ndim == 1
        and of.convergence.r_hat.shape == (quantities,)
        and all(
            getattr(of.convergence, field).shape == (ensembles, quantities) for field in _PER_CHAIN.values()
        )
        and all(array.dtype == np.float64 for array in numbers)
        and bool(np.isfinite(of.draws).all())
    )


def _digest(of: Posterior) -> str:
    """Return the SHA-256 of all that a posterior holds."""
    rule = of.convergence
    about = [of.names, of.walkers, of.moves, of.burn_in, of.failures, int(of.interrupted), of.failed]
    found = hashlib.sha256(json.dumps([*about, rule.quantities, rule.steps, of.draws.shape]).encode("utf-8"))
    for array in (of.draws, of.log_posterior, of.acceptance, rule.r_hat, rule.tau, rule.bulk, rule.tail):
        found.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return found.hexdigest()


def _datasets(of: Posterior) -> "dict[str, xarray.Dataset]":
    import xarray  # late: a study without sampling does not wait for it

    chains, length = of.log_posterior.shape
    frame = {"chain": np.arange(chains), "draw": np.arange(length)}
    by = {"chain": np.arange(chains), "quantity": list(of.convergence.quantities)}
    draws = {name: (tuple(frame), of.draws[:, :, k]) for k, name in enumerate(of.names)}
    stats = {"lp": (tuple(frame), of.log_posterior), "acceptance_rate": (("chain",), of.acceptance)}
    found = {name: (tuple(by), getattr(of.convergence, field)) for name, field in _PER_CHAIN.items()}
    found["r_hat"] = (("quantity",), of.convergence.r_hat)
    about = _attributes(of)
    return {
        "posterior": xarray.Dataset(draws, coords=frame, attrs=about),
        "sample_stats": xarray.Dataset(stats, coords=frame, attrs=about),
        "convergence": xarray.Dataset(found, coords=by, attrs={**about, "steps": of.convergence.steps}),
    }


_PER_CHAIN = {"autocorrelation_time": "tau", "ess_bulk": "bulk", "ess_tail": "tail"}
"""Variables of the group `convergence` by what holds them."""


def _attributes(of: Posterior) -> dict[str, str | int]:
    return {
        "inference_library": "emcee",
        "state": "converged" if of.converged else f"NOT CONVERGED: {'; '.join(of.faults)}",
        "parameters": ",".join(of.names),
        "walkers": of.walkers,
        "moves": of.moves,
        "burn_in": of.burn_in,
        "failures": of.failures,
        "failed_theta": json.dumps(of.failed),
        "interrupted": int(of.interrupted),
        "converged": int(of.converged),
        "sha256": _digest(of),
    }


def _read(attributes: Mapping[str, Any], numbers: Mapping[str, Floats]) -> Posterior:
    """Return the posterior of what a file holds, by `group/name`."""
    about = {name: attributes[f"posterior/{name}"] for name in _ATTRIBUTES}
    names = tuple(str(about["parameters"]).split(","))
    return Posterior(
        names=names,
        draws=np.stack([numbers[f"posterior/{name}"] for name in names], axis=2),
        log_posterior=numbers["sample_stats/lp"],
        walkers=int(about["walkers"]),
        moves=str(about["moves"]),
        acceptance=numbers["sample_stats/acceptance_rate"],
        convergence=Convergence(
            quantities=tuple(attributes["convergence/quantity"]),
            r_hat=numbers["convergence/r_hat"],
            **{field: numbers[f"convergence/{name}"] for name, field in _PER_CHAIN.items()},
            steps=int(attributes["convergence/steps"]),
        ),
        burn_in=int(about["burn_in"]),
        failures=int(about["failures"]),
        interrupted=bool(about["interrupted"]),
        failed=_thetas(parse_json(str(about["failed_theta"]), "failed_theta")),
    )


def _thetas(lists: Sequence[Sequence[Sequence[float]]]) -> tuple[tuple[tuple[float, ...], ...], ...]:
    return tuple(tuple(tuple(map(float, theta)) for theta in ensemble) for ensemble in lists)


_ATTRIBUTES = (
    "parameters", "walkers", "moves", "burn_in", "failures", "interrupted", "failed_theta",
)  # fmt: skip
