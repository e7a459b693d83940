"""Read MATLAB files: N x 3 arrays, also in structs and cells, and structs of x, y and z.

scipy and h5py read them, in a child process: scipy crashes on some damaged files.
"""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needlefit.arrays import Floats
from needlefit.datasets.formats import FileFormat
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.project.input_files import read_bytes
from needlefit.project.reader_process import Arrays, read_in_process, stated_memory_bytes

# Signature of HDF5, which MATLAB uses from version 7.3 on, and its possible positions behind MATLAB's own
# header.
SIGNATURE, SIGNATURE_OFFSETS = b"\x89HDF\r\n\x1a\n", (0, 512, 1024, 2048)
MAX_TEXT_CHARS, MAX_STATED_NUMBERS = 200, 20  # of a text, and numbers in a vector, that are stated of a curve
NAMED_FIELDS = "x, y, z"  # stated, without a text, of a curve whose coordinates are fields of these names
MAX_SHOWN_VARIABLES = 20  # number of variables that a message lists
MAX_EXPANSION = 8  # memory that the content of a file may take, as a multiple of the file's size
READ_BYTES_PER_SECOND = 2**20
EXPECTED_ARRAYS = "N x 3 arrays of numbers, or structs with x, y and z, mm, entry first"


def read_curves(path: Path) -> tuple[dict[str, Points], list[str]]:
    """Return every array of shape (N, 3) or (3, N), N > 3, by name, and the names of what is none.

    Names: `a`, `a_1` in a cell, an array of structs or a stack (N, 3, K) or (K, N, 3), `a_b` in a struct; a
    struct with one such array gives it its name. A struct with vectors x, y and z of one length is a curve,
    too, with `NAMED_FIELDS` in its `stated`, as are texts and single numbers beside a curve, or above it.
    Reads versions 4 to 7 (scipy), 7.3 (h5py).

    DataError if the file is missing, is no MATLAB file, or holds no such array.
    """
    data = read_bytes(path)
    memory = stated_memory_bytes() or MAX_EXPANSION * len(data)
    reader, seconds = f"{__name__}:read_variables", len(data) / READ_BYTES_PER_SECOND
    (variables, stated, unused), found = read_in_process(
        reader, path, {"path": str(path)}, 2 * memory, seconds
    )
    if not found:
        raise DataError(
            f"holds no curve; its variables are "
            f"{', '.join(map(str, variables[:MAX_SHOWN_VARIABLES])) or '(none)'}",
            where=str(path),
            expected=EXPECTED_ARRAYS,
            fix="save the points of the centreline as one N x 3 array",
        )
    curves = {name: Points(path, array, stated=stated[name]) for name, array in found.items()}
    return curves, [f"variable {name} ignored" for name in unused]


def read_variables(arrays: Arrays, path: str) -> tuple[list[str], dict[str, dict[str, str]], list[str]]:
    """Add an array for every curve in a file, in the child process.

    Return the names of all variables, what is stated of each curve, and what is not used.
    """
    from scipy.io import loadmat

    data = read_bytes(Path(path))
    if any(data.startswith(SIGNATURE, at) for at in SIGNATURE_OFFSETS):
        import h5py

        with h5py.File(BytesIO(data), "r") as file:
            named = [key for key in file if not key.startswith("#")]
            variables = {key: _read_hdf_value(file, _get_local_member(file, key)) for key in named}
    else:
        opened: Any = BytesIO(data)  # which it takes, though its stubs do not state it
        variables = loadmat(opened, simplify_cells=True)
        variables = {key: value for key, value in variables.items() if not key.startswith("__")}
    stated: dict[str, dict[str, str]] = {}
    unused: list[str] = []
    for name, array, texts in _iterate_curves("", variables, {}, unused):
        arrays[name] = np.asarray(array, np.float64)
        stated[name] = texts
    return list(variables), stated, unused


def _iterate_curves(
    name: str,
    value: Any,  # noqa: ANN401 - whatever MATLAB saved
    stated: dict[str, str],
    unused: list[str],
) -> Iterator[tuple[str, Floats, dict[str, str]]]:
    """Yield name, points and what is stated of every curve in a value; add what is none to `unused`."""
    is_cell = isinstance(value, np.ndarray) and value.dtype == object
    if is_cell and all(isinstance(one, int | float) for one in value.flat):
        value = value.astype(np.float64)  # a cell array of numbers
    if isinstance(value, dict):
        columns, value = _take_columns(value)
        texts = {key: text for key, part in value.items() if (text := _to_text(part)) is not None}
        others = {key: part for key, part in value.items() if key not in texts}
        is_one = columns is None and sum(_to_points(part) is not None for part in others.values()) == 1
        named = stated | texts | {NAMED_FIELDS: ""}
        here = [] if columns is None else [(name or "curve", columns, named)]
        for key, part in others.items():
            own = name if name and is_one and _to_points(part) is not None else f"{name}_{key}".strip("_")
            here += _iterate_curves(own, part, stated | texts, unused)
        if not here:  # nothing that the texts could be stated of
            unused += [f"{name}.{key}".strip(".") for key in texts]
        yield from here
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for number, part in enumerate(value if isinstance(value, list) else value.ravel(), 1):
            yield from _iterate_curves(f"{name}_{number}", part, stated, unused)
    elif isinstance(value, np.ndarray) and value.ndim == 3 and 3 in value.shape[1:]:  # curves of one size
        stack = value if value.shape[2] == 3 < value.shape[1] else np.moveaxis(value, 2, 0)
        yield from _iterate_curves(name, [*stack], stated, unused)
    elif (points := _to_points(value)) is not None:
        yield name, points, stated
    else:
        unused.append(name)


def _to_points(value: Any) -> Floats | None:  # noqa: ANN401 - whatever MATLAB saved
    """Return an array of shape (N, 3) or (3, N) as points (N, 3); None for anything else."""
    if not isinstance(value, np.ndarray) or not _is_real(value) or value.ndim != 2:
        return None
    if 3 not in value.shape or max(value.shape) <= 3:
        return None
    return np.ascontiguousarray(value if value.shape[1] == 3 else value.T, dtype=np.float64)


def _to_text(value: Any) -> str | None:  # noqa: ANN401 - whatever MATLAB saved
    """Return a text, a number or a few numbers as text; None for anything else."""
    if isinstance(value, str):
        return value[:MAX_TEXT_CHARS].strip()
    array = np.asarray(value) if isinstance(value, int | float | np.ndarray | np.generic) else None
    if array is None or array.size > MAX_STATED_NUMBERS or max(array.shape, default=1) != max(array.size, 1):
        return None
    if not (_is_real(array) or array.dtype == bool):
        return None
    return ", ".join(f"{float(one):.10g}" for one in array.ravel())


def _take_columns(fields: dict[str, Any]) -> tuple[Floats | None, dict[str, Any]]:
    """Return the points (N, 3) in the fields x, y and z of a struct or None, and its other fields."""
    named = {key.lower(): key for key in fields if key.lower() in ("x", "y", "z")}
    vectors = [np.asarray(fields[named[axis]]) for axis in "xyz" if axis in named]
    sizes = {one.size for one in vectors if _is_real(one) and one.size == max(one.shape, default=0) > 3}
    if len(vectors) != 3 or len(sizes) != 1 or not all(map(_is_real, vectors)):
        return None, fields
    others = {key: value for key, value in fields.items() if key not in named.values()}
    return np.column_stack([one.ravel() for one in vectors]).astype(np.float64), others


def _is_real(value: NDArray[Any]) -> bool:
    return bool(np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value))


def _get_local_member(group: Any, key: str) -> Any:  # noqa: ANN401 - h5py has no stubs
    """Return a member of a group; ValueError if it lies in another file, which links may name."""
    import h5py

    item = group[key] if isinstance(group.get(key, getlink=True), h5py.HardLink) else None
    if item is None or getattr(item, "external", None) or getattr(item, "is_virtual", False):
        raise ValueError("not in this file")
    return item


def _read_hdf_value(file: Any, item: Any) -> Any:  # noqa: ANN401 - h5py has no stubs
    """Return a struct as a dict, a cell array or array of structs as a list, a text, or a matrix as MATLAB
    shows it (the file turns it).
    """
    if hasattr(item, "keys"):
        members = {key: _get_local_member(item, key) for key in item}
        fields = {key: _read_hdf_value(file, member) for key, member in members.items()}
        # In an array of structs every field is an array of references, without the class of a cell array.
        is_array = fields and all(
            isinstance(fields[key], list) and member.attrs.get("MATLAB_class") != b"cell"
            for key, member in members.items()
        )
        if is_array and len({len(part) for part in fields.values()}) == 1:
            return [dict(zip(fields, parts, strict=True)) for parts in zip(*fields.values(), strict=True)]
        return fields
    if item.external or item.is_virtual:  # reached by a reference
        raise ValueError("not in this file")
    if item.dtype == object:
        return [_read_hdf_value(file, file[reference]) for reference in np.ravel(item[()])]
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, np.ravel(item[()])[:MAX_TEXT_CHARS]))
    return np.asarray(item[()]).T


MAT = FileFormat("mat", (".mat",), read_curves)
