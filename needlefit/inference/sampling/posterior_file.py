"""Read the netCDF file of a posterior in a child process of limited memory and time.

netCDF files are HDF5 files. The library's reader of their dimensions does not end on some damaged ones; the
numbers are therefore read by their names, without dimensions.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from needlefit.project.input_files import open_regular
from needlefit.project.reader_process import Arrays, read_in_process

#: largest size of a file of draws (bytes); those of the paper's studies have some MB
MAX_POSTERIOR_BYTES = 4 * 2**30

#: size (bytes) of a file of draws that warrants one second of processor time
READ_BYTES_PER_SECOND = 16 * 2**20

GROUPS = ("posterior", "sample_stats", "convergence")


def read_numbers(path: Path) -> tuple[dict[str, str], dict[str, NDArray[np.float64]]]:
    """Return the texts among the attributes and the float64 variables of a file, both by `group/name`.

    Raises DataError if the file is missing, is not HDF5, states more than it holds, or its reader crashes or
    does not end.
    """
    with open_regular(path, MAX_POSTERIOR_BYTES):
        size = path.stat().st_size
    seconds = size / READ_BYTES_PER_SECOND
    reader = "needlefit.inference.sampling.posterior_file:fill_numbers"
    return read_in_process(reader, path, {"path": str(path)}, 3 * size, seconds)


def fill_numbers(arrays: Arrays, path: str) -> dict[str, str]:
    """Add an array for every float64 variable of the file, in the child process; return the attributes."""
    import h5py

    texts: dict[str, str] = {}
    with h5py.File(path, "r") as file:
        for group in GROUPS:
            for name, value in file[group].attrs.items():
                texts |= {f"{group}/{name}": value} if isinstance(value, str) else {}
            for name, variable in file[group].items():
                if isinstance(variable, h5py.Dataset) and variable.dtype == np.float64:
                    arrays[f"{group}/{name}"] = np.asarray(variable[()])
    return texts
