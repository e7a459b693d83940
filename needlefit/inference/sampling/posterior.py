"""The sampled posterior: draws, diagnostics, and its file (netCDF in the InferenceData layout)."""

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from needlefit.arrays import Floats
from needlefit.errors import ConfigError, DataError
from needlefit.inference.sampling.convergence import Convergence
from needlefit.inference.sampling.posterior_file import read_numbers
from needlefit.project.input_files import parse_json

if TYPE_CHECKING:
    import arviz
    import xarray


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
    """Return the SHA-256 of all that a posterior holds."""
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
    """Return the posterior of what a file holds, by `group/name`."""
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
