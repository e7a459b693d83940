"""Read files of MATLAB, HDF5 and numpy: N x 3 or N x 2 arrays, also in structs and cells, and x, y and z.

scipy and h5py read them, in a child process: scipy crashes on some damaged files.
"""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from needlefit.datasets.fields import MAX_TEXT_CHARS, FieldReader
from needlefit.datasets.formats import FileFormat
from needlefit.datasets.points import Points
from needlefit.errors import DataError
from needlefit.project.input_files import read_bytes
from needlefit.project.reader_process import BYTES_PER_SECOND, Arrays, read_in_process, stated_memory_bytes

SIGNATURE = b"\x89HDF\r\n\x1a\n"  # signature of HDF5, which MATLAB uses from version 7.3 on
# possible places (bytes) of the signature behind MATLAB's own header
SIGNATURE_OFFSETS = (0, 512, 1024, 2048)
NUMPY_SIGNATURES = (b"PK", b"\x93NUMPY")  # signatures of archives and arrays of numpy (.npz, .npy)
MAX_SHOWN_VARIABLES = 20  # largest number of variables that a message lists
MAX_EXPANSION = 8  # largest memory that the content of a file may take, as a multiple of the file's size
EXPECTED_ARRAYS = "N x 3 or N x 2 arrays of numbers, or fields x, y and z, entry first"
ARRAYS_FIX = (
    "save the points of each needle as one N x 3 or N x 2 array; "
    "of a table, save table2struct(T, 'ToScalar', true)"
)


def read_curves(path: Path) -> tuple[dict[str, Points], list[str]]:
    """Return every curve that `FieldReader` finds among the variables, by name, and what is not used.

    Reads MATLAB versions 4 to 7 (scipy), 7.3 and other HDF5 (h5py), and arrays and archives of numpy.

    DataError if the file is missing, is none of these, or holds no curve.
    """
    data = read_bytes(path)
    memory = stated_memory_bytes() or MAX_EXPANSION * len(data)
    reader, seconds = f"{__name__}:read_variables", len(data) / BYTES_PER_SECOND
    (variables, beside, unused), arrays = read_in_process(
        reader, path, {"path": str(path)}, 2 * memory, seconds
    )
    if not arrays:
        raise DataError(
            "holds no curve; its variables are "
            f"{', '.join(map(str, variables[:MAX_SHOWN_VARIABLES])) or '(none)'}",
            expected=EXPECTED_ARRAYS,
            fix=ARRAYS_FIX,
            where=path,
        )
    curves = {name: Points(path, array, **beside[name]) for name, array in arrays.items()}
    return curves, unused


def read_variables(arrays: Arrays, path: str) -> tuple[list[str], dict[str, dict[str, Any]], list[str]]:
    """Add an array for every curve in a file, in the child process.

    Return the names of all variables, what stands beside each curve, and what is not used.
    """
    from scipy.io import loadmat

    data = read_bytes(Path(path))
    if any(data.startswith(SIGNATURE, offset) for offset in SIGNATURE_OFFSETS):
        import h5py

        with h5py.File(BytesIO(data), "r") as file:
            named = [key for key in file if not key.startswith("#")]
            variables = {key: _read_hdf_value(file, _get_local_member(file, key)) for key in named}
    elif data.startswith(NUMPY_SIGNATURES):
        try:
            loaded = np.load(BytesIO(data), allow_pickle=False)
            members = {Path(path).stem: loaded} if isinstance(loaded, np.ndarray) else dict(loaded)
            variables = {key: value if value.ndim else value.item() for key, value in members.items()}
        except ValueError:
            fix = "save an array of each needle: numpy.savez(file, n1=points1, n2=points2)"
            problem = "holds an array of Python objects, or a damaged one"
            raise DataError(problem, expected=EXPECTED_ARRAYS, fix=fix, where=path) from None
    else:
        opened: Any = BytesIO(data)  # which it takes, though its stubs do not state it
        variables = loadmat(opened, simplify_cells=True)
        variables = {key: value for key, value in variables.items() if not key.startswith("__")}
    reader, beside = FieldReader("variable"), dict[str, dict[str, Any]]()
    for curve in reader.find_curves("", variables):
        arrays[curve.name] = np.asarray(curve.values, np.float64)
        beside[curve.name] = {key: getattr(curve, key) for key in ("stated", "unit", "columns")}
    return list(variables), beside, reader.unused


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
    if item.attrs.get("MATLAB_empty", 0):  # the file then holds the size alone
        return ""
    if "MATLAB_object_decode" in item.attrs:  # a table or another object, of which this is an address
        return np.void(b"")
    if item.dtype == object:
        return [_read_hdf_value(file, file[reference]) for reference in np.ravel(item[()])]
    if item.attrs.get("MATLAB_class") == b"char":
        return "".join(map(chr, np.ravel(item[()])[:MAX_TEXT_CHARS]))
    return np.asarray(item[()]).T


MAT = FileFormat("mat", (".mat", ".npz", ".npy", ".h5", ".hdf5"), read_curves)
