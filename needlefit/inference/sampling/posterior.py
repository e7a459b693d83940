"""The sampled posterior: draws, convergence, and its file (netCDF in the InferenceData layout)."""

import json
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from needlefit.arrays import Floats
from needlefit.errors import DataError
from needlefit.inference.sampling.posterior_file import GROUPS, read_numbers
from needlefit.project.input_files import parse_json

if TYPE_CHECKING:
    import xarray

#: largest R-hat of draws that have converged: of four parts with 100 independent draws each, of one
#: distribution, 0.7 % exceed it. The means of the parts then have an SD of 0.2 of the draws', not of 0.1
MAX_R_HAT = 1.02
#: largest distance of means of the same posterior by two methods, in standard errors; by chance 1 in 2e6
MAX_APART = 5.0
LOG_POSTERIOR = "log posterior"
#: names of what the file keeps beside arrays; of files of other versions, whatever else they have is left out
_STORED = ("names", "wanted", "burn_in", "failures", "interrupted", "sampler")
UNITS = {"pa": "Pa", "mm": "mm", "deg": "degree"}  #: units of parameters, by the endings of their names
PERCENTILES = (2.5, 16.0, 50.0, 84.0, 97.5)  #: percentiles of each parameter in the table of a posterior


@dataclass(frozen=True)
class Posterior:
    """A sampled posterior: draws of the P free parameters; a chain is one of W walkers."""

    names: tuple[str, ...]  #: free parameters
    draws: Floats  #: (W, N, P) values (Pa, mm), not theta
    log_posterior: Floats  #: (W, N) log density in theta of each draw, not normalised
    acceptance_fraction: Floats  #: (W,) accepted part of each walker's proposals, burn-in included
    #: (P + 1,) R-hat of the parameters and the log posterior, over both halves of the ensemble, each halved
    #: in time
    r_hat: Floats
    autocorrelation_time: Floats  #: (P + 1,) of the same, integrated, in steps
    wanted: int  #: independent draws that were asked for
    burn_in: int  #: steps thrown away before
    failures: int  #: evaluations that were not a number, or raised, and were given density 0
    interrupted: bool = False
    sampler: str = "emcee"  #: its name in the registry
    #: (P,) how far the means lie from those of the certified draws by importance before, in standard errors;
    #: empty where none are known
    apart: Floats = field(default_factory=lambda: np.empty(0))

    @property
    def ess(self) -> Floats:
        """Independent draws (P + 1,) of all walkers together."""
        return self.log_posterior.size / self.autocorrelation_time

    @property
    def best(self) -> Floats:
        """The draw (P,) of the greatest density, Pa, mm."""
        return self.draws.reshape(-1, len(self.names))[self.log_posterior.argmax()]

    @property
    def convergence(self) -> pd.DataFrame:
        """Of each parameter and the log posterior: `r_hat`, `autocorrelation_time` (steps) and `ess`."""
        columns = {name: getattr(self, name) for name in ("r_hat", "autocorrelation_time", "ess")}
        return pd.DataFrame(columns, pd.Index([*self.names, LOG_POSTERIOR], name="quantity"))

    @property
    def faults(self) -> tuple[str, ...]:
        """Why the draws have not converged; empty if they have."""
        problems, quantities = (
            ["the sampler was interrupted"] * self.interrupted,
            (*self.names, LOG_POSTERIOR),
        )
        worst, slowest = int(np.argmax(self.r_hat)), int(np.argmin(self.ess))
        if not self.r_hat[worst] < MAX_R_HAT:
            problems.append(f"R-hat of {quantities[worst]} is {self.r_hat[worst]:.3g}, not below {MAX_R_HAT}")
        if not self.ess[slowest] >= self.wanted:
            has = f"{self.ess[slowest]:.0f} independent draws of {quantities[slowest]}"
            problems.append(f"{has}, not {self.wanted}")
        if self.apart.size and not (far := float(self.apart.max())) < MAX_APART:
            name = self.names[int(np.argmax(self.apart))]
            problems.append(
                f"its mean of {name} is {far:.2g} standard errors from that by importance sampling"
            )
        return tuple(problems)

    def percentiles(self) -> dict[str, tuple[float, ...]]:
        """Return each parameter's percentiles over all draws (Pa, mm)."""
        table = np.percentile(self.draws.reshape(-1, len(self.names)), PERCENTILES, axis=0)  # (Q, P)
        return {name: tuple(column.tolist()) for name, column in zip(self.names, table.T, strict=True)}

    def to_frame(self) -> pd.DataFrame:
        """Return the draws (Pa, mm, degrees): a row for each, by chain and draw, a column a parameter."""
        places = pd.MultiIndex.from_product(
            [range(n) for n in self.log_posterior.shape], names=["chain", "draw"]
        )
        return pd.DataFrame(self.draws.reshape(-1, len(self.names)), places, self.names)

    def to_xarray(self) -> "xarray.DataTree":
        """Return the groups of the netCDF file that `save` writes: draws by chain and draw, with `units`."""
        import xarray

        groups = {name: xarray.Dataset(*parts) for name, parts in _list_groups(self).items()}
        return xarray.DataTree.from_dict(groups)


def thin_chains(posterior: Posterior, count: int) -> Floats:
    """Return `count` draws (B, P), or all of fewer, evenly spread over all chains and steps."""
    flat = posterior.draws.reshape(-1, len(posterior.names))
    return flat[np.linspace(0, len(flat) - 1, min(count, len(flat))).astype(np.int64)]


def save(posterior: Posterior, path: Path) -> None:
    """Write the posterior as netCDF: groups `posterior`, `sample_stats` and `convergence`.

    The first two are InferenceData's, with dimensions chain and draw; the third has the criteria of
    convergence, by quantity. Equal posteriors give equal bytes: the file holds no time.
    """
    import h5netcdf  # xarray takes 0.7 s to load
    import h5py

    written = BytesIO()  # to a disk that is full HDF5 cannot write: it ends the interpreter
    with h5netcdf.File(written, "w") as file:
        for name, (variables, coordinates, header) in _list_groups(posterior).items():
            group = file.create_group(name)
            group.attrs.update(header)
            for dimension, values in coordinates.items():
                group.dimensions[dimension] = len(values)
                kind = h5py.string_dtype() if dimension == "quantity" else None
                group.create_variable(dimension, (dimension,), kind, np.asarray(values, kind))
            for variable, (dimensions, values, attributes) in variables.items():
                group.create_variable(variable, dimensions, data=values).attrs.update(attributes)
    path.write_bytes(written.getvalue())


def load(path: Path) -> Posterior:
    """Read the posterior that `save` wrote; DataError if the file is not a posterior, or is damaged."""
    attributes, numbers = read_numbers(path)
    try:
        about: dict[str, Any] = parse_json(attributes["posterior/about"], "about")
        about["names"] = tuple(about["names"])
        return Posterior(
            draws=np.stack([numbers[f"posterior/{name}"] for name in about["names"]], axis=2),
            log_posterior=numbers["sample_stats/lp"],
            acceptance_fraction=numbers["sample_stats/acceptance_rate"],
            r_hat=numbers["convergence/r_hat"],
            autocorrelation_time=numbers["convergence/autocorrelation_time"],
            apart=numbers.get("convergence/apart", np.empty(0))[:-1],
            **{name: about[name] for name in about.keys() & set(_STORED)},
        )
    except (DataError, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"is not a posterior of needlefit, or a damaged one: {error}",
            expected="the file as `needlefit tune` wrote it",
            fix="tune again",
            where=path,
        ) from error


#: variables as xarray takes them (dimensions, values, attributes), coordinates, and attributes of a group
_Group = tuple[dict[str, tuple[tuple[str, ...], Floats, dict[str, str]]], dict[str, Any], dict[str, str]]


def _list_groups(posterior: Posterior) -> dict[str, _Group]:
    numbers = {f"posterior/{name}": posterior.draws[:, :, k] for k, name in enumerate(posterior.names)} | {
        "sample_stats/lp": posterior.log_posterior,
        "sample_stats/acceptance_rate": posterior.acceptance_fraction,
        "convergence/r_hat": posterior.r_hat,
        "convergence/autocorrelation_time": posterior.autocorrelation_time,
        "convergence/ess": posterior.ess,
        "convergence/apart": np.resize(np.append(posterior.apart, 0.0), posterior.r_hat.shape),
    }
    about = json.dumps({name: getattr(posterior, name) for name in _STORED})
    header = {
        "inference_library": posterior.sampler,
        "state": "; ".join(("NOT CONVERGED", *faults)) if (faults := posterior.faults) else "converged",
        "about": about,
    }
    frame = dict(zip(("chain", "draw"), map(np.arange, posterior.log_posterior.shape), strict=True))
    coordinates: dict[str, dict[str, Any]] = dict.fromkeys(GROUPS, frame)
    coordinates["convergence"] = {"quantity": [*posterior.names, LOG_POSTERIOR]}
    groups: dict[str, _Group] = {group: ({}, coordinates[group], header) for group in GROUPS}
    for key, array in numbers.items():
        group, name = key.split("/")
        unit = UNITS.get(name.rpartition("_")[2], "1")
        groups[group][0][name] = (tuple(coordinates[group])[: array.ndim], array, {"units": unit})
    return groups
