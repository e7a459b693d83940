"""The C++ kernel (`mechanics/native/`): its library, and its structures as Python fills them.

The kernel has no memory of its own. Every array that it reads or writes is made here or by the caller, and
kept alive by the structure that points to it. A wrong array is a TypeError: types and lengths are compared
with the sizes here, and what the numbers mean is checked by `native/checks.hpp`.
"""

import ctypes
import hashlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from ctypes import byref, c_double, c_int64, c_void_p
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from needlefit.arrays import Floats, Ints, pad_axis
from needlefit.errors import NeedlefitError

FOLDER = Path(__file__).parent / "native"
ABI_VERSION = 4  #: version of the kernel's interface: `nf_abi_version` of `native/abi.cpp`
#: environment variable: a library to use instead of the package's own, such as one with sanitizers
LIBRARY_VARIABLE = "NEEDLEFIT_LIBRARY"

_FIX = "install needlefit again; of a checkout: pip install -e ."

SAME_DEPTH_MM = 1e-9  #: difference (mm) below which two depths are the same
LINEAR_CUT = -1.0  #: value in place of a `switch` where the cut is linear between its constraint points
#: table of a law: number of its pieces of equal length, number of Chebyshev terms of each, |e| / t at its end
TABLE_PIECES, TABLE_TERMS, TABLE_COMPRESSION = 16, 20, 0.8
#: polynomial fitted to a law: number of its terms, its relative error, |e| / t at the end of the longest one
SERIES_TERMS, SERIES_TOLERANCE, MAX_SERIES_COMPRESSION = 6, 1e-10, 0.2
MAX_SHAPES = 16  #: largest number of shape parameters of a law

CONVERGED, NON_FINITE = 0, 3  #: numbers of two results of a simulation: `Status` of `native/needle.hpp`
PERMANENT, STARTS_RAY, EXTRAPOLATES, PAST = 1, 2, 4, 8  #: parts of a stop's `flags`
STOP = np.dtype(
    [("tip", "f8"), ("cell", "i8"), ("ray", "i8"), ("bevel", "i8"), ("inputs", "i8"), ("flags", "i8")]
)  #: a stop of the tip; `flags` is a sum of the parts above

_SIZES = [
    "planes", "sets", "layers", "shapes", "terms", "numbers", "stop_count", "bevels", "inputs", "rays",
    "guides", "columns", "max_iterations",
]  # fmt: skip
_NUMBERS = ["length", "first_cell", "spacing", "element", "part", "tangent", "tolerance", "deepest"]
_ARRAYS: dict[str, tuple[Any, tuple[str | int, ...]]] = {
    "boundaries": (float, ("sets", "layers - 1")),
    "stops": (STOP, ("any",)),
    "rigidity": (float, ("sets",)),
    "mu": (float, ("sets", "layers")),
    "thickness": (float, ("sets", "layers")),
    "friction": (float, ("sets", "layers")),
    "law": (float, ("sets", "layers", "numbers")),
    "law_by": (float, ("sets", "layers", "shapes", "numbers")),
    "turn": (float, ("bevels", "sets", "planes")),
    "base": (float, ("inputs", "sets", "planes", 3)),
    "before_first": (np.int64, ("inputs + 1",)),
    "within_first": (np.int64, ("inputs + 1",)),
    "before": (float, ("any", "guide_size")),
    "within": (float, ("any", "guide_size")),
    "held_tip": (float, ("inputs", "planes", 2)),
    "guide_x": (float, ("sets",)),
    "turn_by": (float, ("bevels", "sets", "planes")),
    "column_of": (np.int64, (13,)),
    "guide_columns": (np.int64, ("any", "guide_size")),
}  #: type and shape of each array
_DERIVATIVES = {"law_by", "turn_by", "column_of", "guide_columns"}

FAULTS = (
    "",
    "a size is not positive, or too large",
    "a size of mesh or layers is wrong",
    "a stop lies outside of the inputs",
    "an input has too many guides",
    "a derivative lies outside of the Jacobian",
    "the arrays for shapes are too small",
    "points or nodes do not increase, or lie too deep",
)  #: faults by the numbers that the kernel returns: `Fault` of `native/checks.hpp`
BAD_POINTS = 7  #: number of the last of these faults


_RETURN_NUMBERS = (
    "lanes", "check", "plan", "nodes", "memory", "simulate", "session_advance", "session_rays", "equilibrium",
    "quadrature", "balance",
)  # fmt: skip


def check_fault(fault: int) -> None:
    """Raise TypeError for a fault that the kernel has found."""
    if fault:
        raise TypeError(FAULTS[fault])


#: place of the laws' shape parameters in `column_of`: `ColumnKind` of `native/derivatives.hpp`
SHAPE_COLUMN = 1
_SET_ARRAYS = {name for name, (_, shape) in _ARRAYS.items() if "sets" in shape}
# names of the further axes of the arrays above
_SET_SIZES = ("layers", "shapes", "numbers", "bevels", "inputs", "planes")


class KernelProblem(ctypes.Structure):
    """An insertion and its parameter sets: `struct Problem` of `native/needle.hpp` describes each field."""

    _fields_ = [
        *((name, c_int64) for name in _SIZES),
        *((name, c_double) for name in _NUMBERS),
        *((name, c_void_p) for name in _ARRAYS),
    ]
    arrays: dict[str, np.ndarray]
    room: int  # for the nodes of any shape
    nodes: int = 0  # of the shape at the last stop, once it is known
    max_points: int  # constraint points of a shape
    max_quadrature: int  # quadrature points of a shape

    @classmethod
    def make(cls, numbers: Mapping[str, float], arrays: Mapping[str, np.ndarray]) -> "KernelProblem":
        """Return the structure of these numbers and arrays, which it keeps alive.

        Raises TypeError if an array is missing, has not the type, shape or layout that the kernel reads, or
        refers to a place outside of another one.
        """
        problem = cls(**numbers)
        if problem.shapes > MAX_SHAPES:
            raise TypeError(f"a law has {problem.shapes} shape parameters; the kernel takes {MAX_SHAPES}")
        sizes: dict[str, int] = {name: getattr(problem, name) for name in _SIZES}
        if max(sizes.values()) > 1 << 48 or min(sizes.values()) < 0:  # beyond, a C integer has wrapped around
            raise TypeError(f"the sizes of a problem are {sizes}")
        needed = _ARRAYS.keys() - {"guide_x"} - (set() if problem.columns else _DERIVATIVES)
        column_of = arrays.get("column_of")
        if (
            problem.columns
            and column_of is not None
            and np.any(column_of[SHAPE_COLUMN : SHAPE_COLUMN + 1] < 0)
        ):
            needed -= {"law_by"}
        if missing := needed - arrays.keys():
            raise TypeError(f"a problem without {sorted(missing)}")
        problem.arrays = dict(arrays)
        others = {"any": -1, "layers - 1": problem.layers - 1, "inputs + 1": problem.inputs + 1}
        sizes |= others | {"guide_size": 1 + 2 * problem.planes}
        problem._point_to(_find_addresses(arrays, sizes))
        guides = len(arrays["before"]) + len(arrays["within"])
        if (
            len(arrays["stops"]) < problem.stop_count
            or any(arrays[f"{name}_first"][-1] != len(arrays[name]) for name in ("before", "within"))
            or (problem.columns and len(arrays["guide_columns"]) != guides)
        ):
            raise TypeError("stops or guides are not as many as stated")
        limits = (c_int64 * 3)()
        check_fault(load_library().nf_check(byref(problem), limits))
        problem.room, problem.max_points, problem.max_quadrature = limits
        return problem

    def with_sets(self, sets: int, arrays: Mapping[str, np.ndarray]) -> "KernelProblem":
        """Return the insertion with other parameter sets.

        Raises TypeError if the arrays are not all that differ between sets, or have other sizes.
        """
        if arrays.keys() != self.arrays.keys() & _SET_ARRAYS:
            raise TypeError(f"arrays of {', '.join(arrays)} are not all that differ between sets")
        sizes = {name: getattr(self, name) for name in _SET_SIZES}
        addresses = _find_addresses(arrays, sizes | {"sets": sets, "layers - 1": self.layers - 1})
        problem = KernelProblem.from_buffer_copy(self)
        problem.__dict__.update(self.__dict__)
        problem.sets, problem.arrays = sets, self.arrays | dict(arrays)
        problem._point_to(addresses)
        return problem

    def _point_to(self, addresses: Mapping[str, c_void_p]) -> None:
        for name, address in addresses.items():
            setattr(self, name, address)


def _find_addresses(arrays: Mapping[str, np.ndarray], sizes: Mapping[str, int]) -> dict[str, c_void_p]:
    """Return where each array lies, once it is found to be one that the kernel can read."""
    for name, array in arrays.items():
        dtype, shape = _ARRAYS[name]
        check_array(name, array, dtype, tuple([sizes[n] if isinstance(n, str) else n for n in shape]))
    return {name: _at(array) for name, array in arrays.items()}


def check_array(name: str, array: np.ndarray, dtype: Any, shape: tuple[int, ...]) -> None:  # noqa: ANN401
    """Raise TypeError unless an array is one that the kernel can read; -1 in `shape`: any length."""
    fits = isinstance(array, np.ndarray) and array.dtype == dtype and array.flags.c_contiguous
    fits = fits and (array.shape == shape or _is_of_shape(array, shape))
    if not fits:
        actual = (array.dtype, array.shape) if isinstance(array, np.ndarray) else type(array)
        raise TypeError(f"{name} is {actual}; the kernel reads a contiguous {np.dtype(dtype)} array {shape}")


def _is_of_shape(array: np.ndarray, shape: tuple[int, ...]) -> bool:
    if len(array.shape) != len(shape):
        return False
    return all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))


def take_arrays(**given: tuple[Floats, tuple[int, ...]]) -> list[Floats]:
    """Return arrays of these sizes as the kernel reads them; TypeError as `check_array`."""
    kept = {name: np.ascontiguousarray(array, dtype=np.float64) for name, (array, _) in given.items()}
    for name, (_, shape) in given.items():
        check_array(name, kept[name], float, shape)
    return list(kept.values())


class Shapes(ctypes.Structure):
    """Where the kernel writes shapes and derivatives: `struct Shapes` of `native/abi.cpp`."""

    _WRITTEN = (
        "x", "u", "slope", "constraints", "track", "status", "passes", "nodes",
        "u_by", "slope_by", "constraints_by", "track_by",
    )  # fmt: skip
    _fields_ = [("room", c_int64), ("points", c_int64), *((name, c_void_p) for name in _WRITTEN)]
    arrays: dict[str, np.ndarray]
    nodes_of_sets: Floats  # (1 + 2 planes, sets, room) x, u along each direction and slope along each
    sets: int
    columns: int
    planes: int

    @classmethod
    def make(
        cls, sets: int, room: int, points: int, columns: int = 0, planes: int = 1, tracked: bool = True
    ) -> "Shapes":
        """Return room for so many shapes, and columns of derivatives: of the tip's track if `tracked`."""
        nodes = np.empty((1 + 2 * planes, sets, room))
        arrays = {
            "x": nodes[0],
            "u": nodes[1 : 1 + planes],
            "slope": nodes[1 + planes :],
            "constraints": np.empty((sets, points, 1 + planes)),
            "track": np.empty((sets, points, 2 * planes)),
            "status": np.zeros(sets, np.int64),
            "passes": np.zeros(sets, np.int64),
            "nodes": np.zeros(1, np.int64),
        }
        if columns:
            for name in ("u_by", "slope_by"):
                arrays[name] = np.empty((planes, sets, room, columns))
            for name in ("constraints_by", "track_by")[: 1 + tracked]:
                arrays[name] = np.empty((planes, sets, points, columns))
        made = cls(room, points, **{name: _at(array) for name, array in arrays.items()})
        made.arrays, made.nodes_of_sets = arrays, nodes
        made.sets, made.columns, made.planes = sets, columns, planes
        return made


def divide_moves(first_cell: float, spacing: float, moves: Sequence[tuple[float, int, int]]) -> np.ndarray:
    """Return the stops (S,) of type `STOP` of moves from first contact on.

    Constraint points lie at `first_cell` and every `spacing` from there, mm; a move is the depth that it
    leads to, mm, and the numbers of its bevel and of its other inputs.
    """
    given = np.array(list(moves), [("depth", "f8"), ("bevel", "i8"), ("inputs", "i8")])
    room = 8 + 4 * len(given) + int(np.abs(np.diff(given["depth"], prepend=0.0)).sum() / spacing)
    stops, rays = np.empty(room, STOP), np.empty(room, given.dtype)
    count = load_library().nf_plan(
        c_double(first_cell), c_double(spacing), _at(given), c_int64(len(given)), _at(rays), _at(stops),
        c_int64(room),
    )  # fmt: skip
    return stops[:count]


def make_memory(size: int) -> Floats:
    """Return memory of at least `size` bytes that begins at a multiple of 64."""
    memory = np.empty(size // 8 + 9)
    return memory[-((_at(memory).value or 0) // 8) % 8 :]


@cache
def load_library() -> ctypes.CDLL:
    """Return the kernel's library for this processor.

    Raises NeedlefitError if it is missing, damaged, of another version, or older than the sources beside it.
    """
    given = os.environ.get(LIBRARY_VARIABLE)
    try:
        library = ctypes.CDLL(given) if given else _load_own()
        library.nf_abi_version.restype = c_int64
        version = int(library.nf_abi_version())
    except (OSError, AttributeError) as error:
        raise NeedlefitError(
            f"the library of the kernel cannot be loaded: {error}",
            fix=f"unset {LIBRARY_VARIABLE}, or let it name a library of this kernel" if given else _FIX,
        ) from error
    if version != ABI_VERSION:
        raise NeedlefitError("the library of the kernel is of another version", fix=_FIX)
    for name in _RETURN_NUMBERS:
        getattr(library, f"nf_{name}").restype = c_int64
    # Stated, so that a step makes no objects of its numbers.
    library.nf_session_advance.argtypes = [*[c_void_p] * 6, c_double, c_int64, c_int64, c_void_p]
    return library


def identify_other_library() -> str:
    """Return the SHA-256 of a library that is used in place of the package's own; "" of that one."""
    given = os.environ.get(LIBRARY_VARIABLE)
    return hashlib.sha256(Path(given).read_bytes()).hexdigest() if given else ""


def _load_own() -> ctypes.CDLL:
    try:
        index = json.loads((FOLDER / "libraries.json").read_text())
        contents = {name: (FOLDER / name).read_bytes() for name in index["files"]}
        sources_then, target = index["made_from"]["sources"], index["made_from"]["target"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise NeedlefitError(f"the library of the kernel is missing ({error})", fix=_FIX) from error
    damaged = [
        name
        for name, content in contents.items()
        if hashlib.sha256(content).hexdigest() != index["files"][name]
    ]
    if damaged:
        raise NeedlefitError(f"{FOLDER / damaged[0]} is damaged", fix=_FIX)
    # As `digest_sources` in hatch_build.py, which is not installed. A wheel has the sources too, unchanged.
    sources = sorted(path for path in FOLDER.iterdir() if path.suffix in (".hpp", ".cpp"))
    digest = hashlib.sha256(b"".join(path.name.encode() + path.read_bytes() for path in sources)).hexdigest()
    if sources and digest != sources_then:
        raise NeedlefitError("the sources of the kernel are newer than its library", fix=_FIX)
    suffix = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    names = sorted(name for name in contents if name.endswith(suffix))
    if not names:
        raise NeedlefitError(f"the library of the kernel is for {target}", fix=_FIX)
    library = ctypes.CDLL(str(FOLDER / names[0]))  # of several the one that every processor runs
    if len(names) > 1:
        level = library.nf_processor_level()
        library = ctypes.CDLL(str(FOLDER / max(n for n in names if n <= f"kernel-v{level}{suffix}")))
    return library


def count_lanes() -> int:
    """Return how many sets the kernel computes side by side."""
    return int(load_library().nf_lanes())


def simulate(
    problem: KernelProblem, shapes: Shapes, first: int, lanes: int, memory: Floats | None = None
) -> None:
    """Insert the needles of the sets from `first` on, `lanes` (as `count_lanes`, or 1) of them.

    Raises TypeError if there are no such sets or lanes, or `shapes` or `memory` (`measure_memory`) are too
    small.
    """
    library, needed = load_library(), measure_memory(problem, lanes)
    if memory is None:
        memory = make_memory(needed)
    check_array("memory", memory, float, (-1,))
    address = _at(memory)
    fits = memory.nbytes >= needed and (address.value or 0) % 64 == 0 and 0 <= first < problem.sets
    alike = (shapes.sets, shapes.columns, shapes.planes) == (problem.sets, problem.columns, problem.planes)
    if not fits or not alike:
        raise TypeError(
            f"set {first} of {problem.sets}, shapes of {shapes.sets}, {memory.nbytes} bytes to work in"
        )
    check_fault(library.nf_simulate(byref(problem), c_int64(first), c_int64(lanes), address, byref(shapes)))


def measure_memory(problem: KernelProblem, lanes: int) -> int:
    """Return the bytes that `simulate` needs to work in."""
    if lanes not in (1, count_lanes()):
        raise TypeError(f"{lanes} lanes; the kernel has {count_lanes()}, or 1")
    return int(load_library().nf_memory(byref(problem), c_int64(lanes)))


def make_shapes(problem: KernelProblem, points: int, tracked: bool = True) -> Shapes:
    """Return room for the shapes of a problem, with so many constraint points behind the tip and under it."""
    if not 0 <= points <= problem.max_points:
        raise TypeError(f"{points} constraint points; the problem has {problem.max_points}")
    problem.nodes = problem.nodes or count_nodes(problem)
    return Shapes.make(problem.sets, problem.nodes, points, problem.columns, problem.planes, tracked)


def count_nodes(problem: KernelProblem) -> int:
    """Return the number of nodes of the shape at the last stop."""
    x = np.empty(problem.room)
    return int(load_library().nf_nodes(byref(problem), _at(x)))


class CutRay(NamedTuple):
    """A ray that the tip has cut: where it begins, mm, and the numbers of the inputs under which it began."""

    start: float
    bevel_id: int
    controls_id: int


SolvedNodes = tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats]
"""The fields of `shape.Solution`."""


def to_space(x: Floats, u: Floats, slope: Floats, constraints: Floats, track: Floats) -> SolvedNodes:
    """Return what the kernel found in P planes: u, slope (P, ..., N), points (..., 1 + P), track (..., 2 P).

    Along z everything is 0 of needles that the kernel solved for in one plane.
    """
    w, slope_z = (u[1], slope[1]) if len(u) == 2 else (make_flat(x.shape),) * 2
    return x, u[0], slope[0], w, slope_z, pad_axis(constraints, 3), pad_axis(track, 4)


@lru_cache(maxsize=64)
def make_flat(shape: tuple[int, ...]) -> Floats:
    """Return zeros of no size in memory: deflections along z of needles that stay in the plane z = 0."""
    return np.broadcast_to(np.zeros(()), shape)


def stack_planes(along_y: Floats, along_z: Floats) -> Floats:
    """Return values on a leading axis of the planes for which the kernel solves: y alone where z is flat."""
    is_flat = not any(along_z.strides) and not along_z.any()
    return along_y[None] if is_flat else np.stack((along_y, along_z))


class SessionMemory:
    """The state of one needle from step to step; each step reads one copy and writes the other."""

    def __init__(self, problem: KernelProblem) -> None:
        self._library = load_library()
        self._laws = problem.arrays["law"]  # the state points to them
        self._sizes = self._measure(problem)
        self._fixed, self._now, self._scratch = map(make_memory, self._sizes)
        self._library.nf_session_begin(byref(problem), *map(_at, (self._fixed, self._now, self._scratch)))
        self._lay_out(problem)

    def _measure(self, problem: KernelProblem) -> tuple[int, ...]:
        sizes = (c_int64 * 3)()
        self._library.nf_session_memory(byref(problem), sizes)
        return tuple(sizes)

    def _lay_out(self, problem: KernelProblem) -> None:
        """Make once what a step writes to and the arguments of its call."""
        self._next = make_memory(self._sizes[1])
        self._shapes = Shapes.make(1, problem.room, problem.max_points, planes=problem.planes)
        self._done, self._out, a = (c_int64 * 3)(), byref(self._shapes), self._shapes.arrays
        self._nodes, self._cut = self._shapes.nodes_of_sets[:, 0], (a["constraints"][0], a["track"][0])
        self._status, self._passes, self._count = a["status"], a["passes"], a["nodes"]
        self._at = [_at(part) for part in (self._fixed, self._now, self._next, self._scratch)]
        self._fits, self._problem = problem, byref(problem)

    def advance(self, problem: KernelProblem, depth: float, bevel: int, controls: int) -> tuple[int, int]:
        """Move the tip to `depth`, mm, under the inputs of the problem, whose numbers are given.

        Returns the stops of the tip on its way, without any of which there is no new shape, and the
        constraint points behind the tip and under it. The needle stays where it was until `accept`.

        Raises TypeError if the problem has other sizes than that with which the session began, or the depth
        lies outside; RayRoomError if the problem has room for fewer rays than there would be.
        """
        if problem is not self._fits:
            if problem.sets != 1 or self._measure(problem) != self._sizes:
                raise TypeError("the problem has other sizes than the session")
            self._fits, self._problem = problem, byref(problem)
        fixed, now, after, scratch = self._at
        done = self._done
        fault = self._library.nf_session_advance(
            self._problem, fixed, now, after, scratch, self._out,
            depth, bevel, controls, done,
        )  # fmt: skip
        stops, points, rays = done
        if fault:
            if rays > problem.rays:
                raise RayRoomError(rays)
            check_fault(fault)
        return stops, points

    def read(self, points: int) -> tuple[SolvedNodes, int, int]:
        """Return what the last step left: nodes, `points` constraint points; status and passes."""
        nodes, planes = self._nodes[:, : self._count[0]].copy(), self._shapes.planes
        cut, track = (part[:points].copy() for part in self._cut)
        shape = to_space(nodes[0], nodes[1 : 1 + planes], nodes[1 + planes :], cut, track)
        return shape, self._status[0], self._passes[0]

    def accept(self) -> None:
        """Let the needle stand where the last `advance` has brought it."""
        self._now, self._next = self._next, self._now
        self._at[1], self._at[2] = self._at[2], self._at[1]

    def list_rays(self) -> tuple[list[CutRay], bool]:
        """Return the rays from the entry to the tip, and whether inputs have changed since it came here."""
        ray_rows, position = np.empty((self._fits.rays, 3), np.int64), np.empty(8, np.int64)
        count = self._library.nf_session_rays(
            self._problem, self._at[0], self._at[1], self._at[3], _at(ray_rows), _at(position)
        )
        starts = ray_rows[:count, 0].view(np.float64)
        rays = [
            CutRay(float(x), int(b), int(c)) for x, (_, b, c) in zip(starts, ray_rows[:count], strict=True)
        ]
        return rays, bool(position[7])

    def copy(self) -> "SessionMemory":
        """Return an independent copy."""
        other = object.__new__(SessionMemory)
        # these never change
        other._library, other._laws, other._fixed = self._library, self._laws, self._fixed
        other._take(self, self._fits)
        return other

    def grow(self, problem: KernelProblem) -> None:
        """Make room for the rays that `problem` has; it is otherwise as the one before."""
        self._take(self, problem)

    def _take(self, other: "SessionMemory", problem: KernelProblem) -> None:
        """Take the state of `other`, in memory with room for the rays that `problem` has."""
        sizes = other._measure(problem)
        now, scratch = make_memory(sizes[1]), make_memory(sizes[2])
        other._library.nf_session_copy(
            other._problem, byref(problem), other._at[0], other._at[1], other._at[3], _at(now), _at(scratch)
        )
        self._sizes, self._now, self._scratch = sizes, now, scratch
        self._lay_out(problem)


class RayRoomError(Exception):
    """A session needs room for so many rays (its argument)."""


def list_quadrature(
    problem: KernelProblem, nodes: Floats, depths: Floats
) -> tuple[Floats, Floats, Ints, Ints]:
    """Return place, weight, layer and constraint point of the quadrature points, for nodes in the tissue."""
    library, room = load_library(), problem.max_quadrature
    (x, weight), (layer, near) = np.empty((2, room)), np.empty((2, room), np.int64)
    memory = make_memory(measure_memory(problem, 1))
    check_array("nodes", nodes, float, (-1,))
    check_array("depths", depths, float, (-1,))
    count = library.nf_quadrature(
        byref(problem), c_int64(len(nodes)), _at(nodes), c_int64(len(depths) - 1), _at(depths), _at(memory),
        *map(_at, (x, weight, layer, near)),
    )  # fmt: skip
    if count < 0:
        check_fault(BAD_POINTS)
    return x[:count], weight[:count], layer[:count], near[:count]


class _BentNeedle(ctypes.Structure):
    _fields_ = [
        *((name, c_int64) for name in ("nodes", "cells")),
        *((name, c_void_p) for name in ("x", "u", "slope", "points")),
    ]


BentShape = tuple[Floats, Floats, Floats, Floats]
"""x (N,), u and slope (P, N), and constraint points (M + 1, 3) of a needle in P planes."""


def _bend(shape: BentShape, planes: int) -> tuple[_BentNeedle, list[Floats]]:
    x, u, slope, points = shape
    nodes = max(len(x), 2)
    kept = take_arrays(
        x=(x, (nodes,)), u=(u, (planes, nodes)), slope=(slope, (planes, nodes)),
        points=(points[:, : 1 + planes], (max(len(points), 1), 1 + planes)),
    )  # fmt: skip
    return _BentNeedle(len(x), len(points) - 1, *map(_at, kept)), kept


def compute_load(problem: KernelProblem, shape: BentShape, s: Floats) -> Floats:
    """Return the tissue's load (2, K), N/mm, along y and z on a needle at `s` (K,)."""
    needle, kept = _bend(shape, problem.planes)
    load, memory = np.empty((problem.planes, len(s))), make_memory(measure_memory(problem, 1))
    check_array("s", s, float, (-1,))
    load_library().nf_load(byref(problem), byref(needle), c_int64(len(s)), _at(s), _at(memory), _at(load))
    del kept
    return pad_axis(load, 2, axis=0)


def balance_nodes(problem: KernelProblem, shape: BentShape, front: int, load: Floats) -> Floats:
    """Return force and moment (2, N, 2), along y and z, that the load (2, Q) leaves over at each node."""
    needle, kept = _bend(shape, problem.planes)
    load = np.ascontiguousarray(load[: problem.planes])
    memory = make_memory(measure_memory(problem, 1))
    balanced = np.empty((problem.planes, len(kept[0]), 2))
    check_array("load", load, float, (problem.planes, -1))
    fault = load_library().nf_balance(
        byref(problem), byref(needle), c_int64(front), c_int64(load.shape[1]),
        *map(_at, (load, memory, balanced)),
    )  # fmt: skip
    check_fault(fault)
    return pad_axis(balanced, 2, axis=0)


def compute_positions(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the points (B, K, 3) of B needles at the same beam coordinates (K,).

    Nodes are (B, N), and their `u` and `slope` (P, B, N) in P planes.
    """
    planes, count, nodes = size = len(u), len(x), max(x.shape[-1], 2)
    parts = take_arrays(x=(x, size[1:]), u=(u, size), slope=(slope, size), s=(s, (-1,)))
    memory = make_memory(8 * (1 + 5 * planes) * (nodes + 2) * count_lanes())
    positions = np.empty((count, len(s), 1 + planes))
    load_library().nf_positions(
        *map(c_int64, (planes, count, nodes, len(s))), *map(_at, (*parts, memory, positions))
    )
    return pad_axis(positions, 3)


def compute_deflections(x: Floats, u: Floats, slope: Floats, s: Floats) -> Floats:
    """Return the deflections u (K,) of the beam, mm, at beam coordinates: not the y of its points."""
    size = (max(len(x), 2),)
    parts = take_arrays(x=(x, size), u=(u, size), slope=(slope, size), s=(s, (-1,)))
    deflections = np.empty(len(parts[3]))
    load_library().nf_deflections(
        c_int64(len(parts[0])), c_int64(len(deflections)), *map(_at, (*parts, deflections))
    )
    return deflections


def compute_position_derivatives(
    x: Floats, u: Floats, slope: Floats, s: Floats, x_by: Floats, u_by: Floats, slope_by: Floats
) -> Floats:
    """Return the derivatives (B, K, 3, Q) of the points of B needles with nodes (B, N) at coordinates (K,).

    In P planes `u` and `slope` are (P, B, N), and their derivatives `u_by` and `slope_by` (P, B, N, Q);
    `x_by` (N, Q) is of all needles.
    """
    planes, count, nodes = size = len(u), len(x), max(x.shape[-1], 2)
    columns = x_by.shape[-1]
    parts = take_arrays(
        x=(x, size[1:]), u=(u, size), slope=(slope, size), s=(s, (-1,)), x_by=(x_by, (nodes, columns)),
        u_by=(u_by, (*size, columns)), slope_by=(slope_by, (*size, columns)),
    )  # fmt: skip
    derivatives = np.empty((count, len(s), 1 + planes, columns))
    by = (1 + 3 * planes) * nodes + 1 + planes
    memory = make_memory(8 * count_lanes() * ((1 + 5 * planes) * nodes + by * columns))
    load_library().nf_position_derivatives(
        *map(c_int64, (planes, count, nodes, len(s), columns)), *map(_at, (*parts, memory, derivatives))
    )
    return pad_axis(derivatives, 3, axis=2)


def compute_sine_cosine(angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle, rad, to the bit those of the page."""
    angles, values = np.array([angle]), np.empty((2, 1))
    for which, value in zip((3, 4), values, strict=True):
        load_library().nf_function(c_int64(which), c_int64(1), _at(angles), _at(value))
    return float(values[0, 0]), float(values[1, 0])


def measure_table_range(table: Floats) -> float:
    """Return the compression up to which a polynomial serves for a law's table (see `packing`)."""
    check_array("table", table, float, (2 + TABLE_PIECES * TABLE_TERMS,))
    limit = np.empty(1)
    load_library().nf_table_range(_at(table), _at(limit))
    return float(limit[0])


def _at(array: np.ndarray) -> c_void_p:
    """Return where the numbers of an array lie.

    NumPy's C interface states that this address is the first field of an array object
    (`PyArrayObject_fields`). To read it there takes a fifth of the time of `array.ctypes`.
    """
    return c_void_p(c_void_p.from_address(id(array) + object.__basicsize__).value)
