"""MATLAB files: every N x 3 array in them, whatever it is nested in."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.datasets.formats.points import Points
from needlefit.errors import DataError
from needlefit.project.reading import read_bytes

Floats = NDArray[np.float64]

SIGNATURE, PLACES = b"\x89HDF\r\n\x1a\n", (0, 512, 1024, 2048)
"""Of HDF5, which MATLAB writes from version 7.3 on behind a head of its own; and where it may stand."""

EXPECTED = "N x 3 arrays of numbers, mm, entry first"


def read_curves(path: Path) -> dict[str, Points]:
    """Return every array of shape (N, 3), N > 3, by its name: `a`, `a_1` in a cell, `a_b` in a struct.

    Reads versions 4 to 7 (scipy) and 7.3 (h5py).

    Raises
    ------
    DataError
        If the file is missing, is no MATLAB file, or holds no such array.
    """
    data = read_bytes(path)
    try:
        variables = _hdf(data) if _is_hdf(data) else _classic(data)
    except Exception as error:  # the readers raise whatever the bytes provoke
        raise DataError(
            f"cannot be read: {error}",
            where=str(path),
            expected="a MATLAB .mat file",
            mend="save it again, e.g. save(file, 'x', '-v7')",
        ) from None
    found = {
        name: Points(path, array) for key, value in variables.items() for name, array in _arrays(key, value)
    }
    if not found:
        raise DataError(
            f"holds no curve; its variables are {', '.join(variables) or '(none)'}",
            where=str(path),
            expected=EXPECTED,
            mend="save the points of the centreline as one N x 3 array",
        )
    return found


def read_points(path: Path) -> Points:
    """Return the one N x 3 array of a file; DataError if there are several."""
    curves = read_curves(path)
    if len(curves) > 1:
        raise DataError(
            f"holds {len(curves)} curves: {', '.join(curves)}",
            where=str(path),
            expected="one N x 3 array",
            mend="save one insertion a file",
        )
    return next(iter(curves.values()))


def _arrays(name: str, value: Any) -> Iterator[tuple[str, Floats]]:  # noqa: ANN401 - whatever MATLAB saved
    if isinstance(value, dict):
        for key, part in value.items():
            yield from _arrays(f"{name}_{key}", part)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for number, part in enumerate(value if isinstance(value, list) else value.ravel(), 1):
            yield from _arrays(f"{name}_{number}", part)
    elif isinstance(value, np.ndarray) and _is_curve(value):
        yield name, np.ascontiguousarray(value, dtype=np.float64)


def _is_curve(value: NDArray[Any]) -> bool:
    real = np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value)
    return bool(real and value.ndim == 2 and value.shape[1] == 3 and value.shape[0] > 3)


def _classic(data: bytes) -> dict[str, Any]:
    from scipy.io import loadmat

    opened: Any = BytesIO(data)  # which it takes, though its stubs do not say so
    variables = loadmat(opened, simplify_cells=True)
    return {key: value for key, value in variables.items() if not key.startswith("__")}


def _is_hdf(data: bytes) -> bool:
    return any(data.startswith(SIGNATURE, at) for at in PLACES)


def _hdf(data: bytes) -> dict[str, Any]:
    import h5py

    with h5py.File(BytesIO(data), "r") as file:
        return {key: _hdf_value(file, file[key]) for key in file if not key.startswith("#")}


def _hdf_value(file: Any, item: Any) -> Any:  # noqa: ANN401 - h5py has no stubs
    """Return a struct as a dict, a cell array as a list, a matrix as MATLAB shows it (the file turns it)."""
    if hasattr(item, "keys"):
        return {key: _hdf_value(file, item[key]) for key in item}
    if item.dtype == object:
        return [_hdf_value(file, file[reference]) for reference in np.ravel(item[()])]
    return np.asarray(item[()]).T
