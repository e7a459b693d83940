"""Damage to the bytes of a file: at random places, and where the format has its structure.

Every function takes the bytes and a generator, and returns other bytes: the same generator, the same bytes.
"""

import gzip
import json
import re
import struct
import zlib
from collections.abc import Callable, Sequence
from copy import deepcopy

import numpy as np

MAX_BYTES = 2**20
"""Length of a mutant that grows."""

Mutation = Callable[[bytes, np.random.Generator], bytes]

NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")

EXTREME_NUMBERS = (
    *(b"0", b"-1", b"1", b"-0.0", b"65535", b"65536", b"2147483647", b"-2147483648", b"4294967296"),
    *(b"9223372036854775807", b"9223372036854775808", b"-9223372036854775809", b"1e308", b"-1e308", b"1e309"),
    *(b"1e-320", b"nan", b"NaN", b"inf", b"-inf", b"Infinity", b"0x10", b"1_000", b"1,5", b"1e9", b"1e5"),
    *(b"100000000", b"9" * 400, b"9" * 5000, b"0." + b"0" * 400 + b"1", b"true", b'"1"', b"[]", b"{}"),
    *(b"1979-05-27T07:32:00Z", "٣".encode(), "²".encode(), b"1e+", b"--1", b"."),
)
TOKENS = (
    *(b"\x1b[2J\x1b[31m", b"\x1b]0;title\x07", b"\x00", b"\r", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc0\x80"),
    *(b"\xed\xa0\x80", b"\\ud800", b"\\u0000", "\u202e".encode(), "é".encode(), "\U0001f4a9".encode()),
    *(b"../../etc/passwd", b"/dev/zero", b"/dev/stdin", b"=cmd|' /C calc'!A0", b"a/b", b"%s%n", b"{0}"),
    *(b"null", b"__proto__", b"schema", b"nan", b'"""', b"\n\n", *map(str.encode, "\"'#,;\t|=[]{}-*~")),
    *(b"A" * 300, b"A" * 70_000, b"\n" * 3000, b"," * 5000, b" " * 20_000),
)
OPENINGS = (b"[", b"{", b'{"a":', b"(", b"a = [", b"[[a]]\n", b"a.", b"<a>", b'"', b"((")

_WIDTHS = {1: "B", 2: "H", 4: "I", 8: "Q"}


def mutate(data: bytes, others: Sequence[bytes], random: np.random.Generator, packed: bool = False) -> bytes:
    """Return `data` with one to five pieces of damage, or with parts of `others`, which are valid inputs.

    Half of the mutants of `packed` data, which are gzip, are damaged inside and packed again.
    """
    if packed and random.random() < 0.5:
        try:
            inside = gzip.decompress(data)
        except (OSError, EOFError, zlib.error):
            inside = None
        if inside is not None:
            return gzip.compress(mutate(inside, (), random), 1, mtime=0)
    if random.random() < 0.25 and (tree := _json_of(data)) is not None:
        return json.dumps(change_tree(tree, random)).encode()[:MAX_BYTES]
    mutations = TEXT_MUTATIONS if _is_text(data) else BYTE_MUTATIONS
    for _ in range(min(5, int(random.geometric(0.5)))):
        if len(others) > 1 and random.random() < 0.08:
            data = splice(data, _one(others, random), random)
        else:
            data = _one(mutations, random)(data, random)
    return data[:MAX_BYTES]


# ---- anywhere


def flip(data: bytes, random: np.random.Generator) -> bytes:
    changed = bytearray(data or b"\0")
    for _ in range(int(random.integers(1, 9))):
        changed[int(random.integers(len(changed)))] ^= 1 << int(random.integers(8))
    return bytes(changed)


def overwrite(data: bytes, random: np.random.Generator) -> bytes:
    """Set some bytes, often near the beginning, where headers stand."""
    changed = bytearray(data or b"\0")
    at, length = _place(len(changed), random), int(random.integers(1, 9))
    fill = random.choice([0, 0x7F, 0x80, 0xFF, int(random.integers(256))])
    changed[at : at + length] = bytes([int(fill)]) * len(changed[at : at + length])
    return bytes(changed)


def truncate(data: bytes, random: np.random.Generator) -> bytes:
    return data[: int(random.integers(len(data) + 1))]


def delete(data: bytes, random: np.random.Generator) -> bytes:
    at, length = _place(len(data), random), _length(random)
    return data[:at] + data[at + length :]


def insert(data: bytes, random: np.random.Generator) -> bytes:
    at = _place(len(data), random)
    return data[:at] + random.bytes(_length(random)) + data[at:]


def duplicate(data: bytes, random: np.random.Generator) -> bytes:
    at, length = _place(len(data), random), _length(random)
    times = int(random.choice([1, 1, 2, 10, 500]))
    return data[: at + length] + data[at : at + length] * times + data[at + length :]


def exchange(data: bytes, random: np.random.Generator) -> bytes:
    here, there, length = _place(len(data), random), _place(len(data), random), _length(random)
    part = data[here : here + length]
    return data[:there] + part + data[there + len(part) :]


def splice(data: bytes, other: bytes, random: np.random.Generator) -> bytes:
    """Begin as one file and end as another."""
    return data[: int(random.integers(len(data) + 1))] + other[int(random.integers(len(other) + 1)) :]


def binary_number(data: bytes, random: np.random.Generator) -> bytes:
    """Set an aligned number of 1 to 8 bytes to an extreme: dimensions, sizes, offsets, counts."""
    width = int(random.choice(list(_WIDTHS)))
    at = _place(len(data), random) // width * width
    top = 2 ** (8 * width)
    extremes = (0, 1, top - 1, top // 2, top // 2 - 1, top // 4, 3, 255, random.integers(min(top, 2**62)))
    order = "<" if random.random() < 0.7 else ">"
    value = struct.pack(order + _WIDTHS[width], int(_one(extremes, random)) % top)
    if width == 8 and random.random() < 0.5:
        value = struct.pack("<d", _one((0.0, -1.0, 1e308, float("nan"), float("inf"), 1e-320), random))
    return data[:at] + value + data[at + width :]


# ---- in text, and in the numbers and texts of a binary file's header


def number(data: bytes, random: np.random.Generator) -> bytes:
    found = list(NUMBER.finditer(data[:200_000]))
    if not found:
        return flip(data, random)
    match = found[int(random.integers(len(found)) * random.random() ** 0.5)]
    value = _one(EXTREME_NUMBERS, random)
    if random.random() < 0.3:
        value = _one((b"-", b"1", b"9", b"0", b"0."), random) + match[0]
    return data[: match.start()] + value + data[match.end() :]


def token(data: bytes, random: np.random.Generator) -> bytes:
    """Put in, or in the place of something, what a parser or a terminal may stumble on."""
    at = _place(len(data), random)
    gone = _length(random) if random.random() < 0.4 else 0
    return data[:at] + _one(TOKENS, random) + data[at + gone :]


def nest(data: bytes, random: np.random.Generator) -> bytes:
    at = _place(len(data), random)
    return data[:at] + _one(OPENINGS, random) * int(random.choice([3, 70, 1000, 20_000])) + data[at:]


def line(data: bytes, random: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    at, to = (int(random.integers(len(lines))) for _ in range(2))
    kind = int(random.integers(5))
    if kind == 0:
        del lines[at]
    elif kind == 1:
        times = int(random.choice([1, 1, 3, 2000]))  # of a long line fewer, or the mutant itself takes GB
        lines[at:at] = [lines[at]] * min(times, 1 + MAX_BYTES // (len(lines[at]) + 1))
    elif kind == 2:
        lines[at], lines[to] = lines[to], lines[at]
    elif kind == 3:
        lines[at : at + 2] = [b"".join(lines[at : at + 2])]
    else:
        lines[at] = b""
    return b"\n".join(lines)


def cell(data: bytes, random: np.random.Generator) -> bytes:
    """Change one cell between commas, or one value behind an equals sign or colon."""
    lines = data.split(b"\n")
    at = int(random.integers(len(lines)))
    sign = next((one for one in (b" = ", b",", b": ", b"=", b" ") if one in lines[at]), b",")
    cells = lines[at].split(sign)
    where = int(random.integers(len(cells)))
    what = (*EXTREME_NUMBERS, *TOKENS, b"", b"x", b'"x"', b"[1, 2]", b"true", _one(cells, random))
    cells[where] = _one(what, random)
    if random.random() < 0.15:
        del cells[where]
    lines[at] = sign.join(cells)
    return b"\n".join(lines)


def encoding(data: bytes, random: np.random.Generator) -> bytes:
    """Encode text otherwise, or end its lines otherwise."""
    text = data.decode("utf-8", "replace")
    form = _one(("utf-16", "utf-32", "utf-8-sig", "cr", "crlf", "vt"), random)
    ends = {"cr": "\r", "crlf": "\r\n", "vt": "\x0b"}
    return text.replace("\n", ends[form]).encode() if form in ends else text.encode(form, "replace")


BYTE_MUTATIONS: Sequence[Mutation] = (
    *(flip, flip, overwrite, overwrite, truncate, delete, insert, duplicate, exchange),
    *(binary_number, binary_number, binary_number, number, number, token, cell),
)
TEXT_MUTATIONS: Sequence[Mutation] = (
    *(flip, truncate, delete, insert, duplicate, exchange, overwrite),
    *(number, number, number, token, token, nest, line, line, cell, cell, cell, cell, encoding),
)


# ---- in a tree of JSON values


def change_tree(tree: object, random: np.random.Generator) -> object:
    """Return JSON values of which one to three are replaced, removed, repeated or wrapped."""
    for _ in range(int(random.integers(1, 4))):
        places = list(_places(tree))
        if not places:
            return deepcopy(_one(_VALUES, random))
        holder, key = places[int(random.integers(len(places)))]
        kind = int(random.integers(6))
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, list):
            holder.insert(key, deepcopy(holder[key]))
        elif kind == 2 and isinstance(holder, dict):
            holder[_one(("", "x", "schema", "\x1b[31m"), random)] = holder.pop(key)
        elif kind == 3:
            other, there = places[int(random.integers(len(places)))]
            holder[key] = deepcopy(other[there]) if there in _keys(other) else None
        else:
            holder[key] = deepcopy(_one(_VALUES, random))  # a shared list would change with the tree
    return tree


_VALUES = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, -(2**63), 10**400, 1e308, -1e308, 1e-320, 0.5),
    *(float("nan"), float("inf"), "", "x", "\x1b[31m", "\ud800", "1", "A" * 5000, [], {}, [[]], [1, 2, 3]),
    *([None], {"a": 1}, [[1.0, 2.0], [3.0]], "/dev/zero", "float64", "object", "O8", "Infinity"),
)


def _places(tree: object) -> list[tuple]:
    found, waiting = [], [tree]
    while waiting and len(found) < 20_000:
        holder = waiting.pop()
        for key in _keys(holder):
            found.append((holder, key))
            waiting.append(holder[key])
    return found


def _keys(holder: object) -> list:
    if isinstance(holder, dict):
        return list(holder)
    return list(range(len(holder))) if isinstance(holder, list) else []


def _json_of(data: bytes) -> object:
    if data.lstrip()[:1] not in (b"{", b"["):
        return None
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None


# ---- choices


def _is_text(data: bytes) -> bool:
    head = data[:2048]
    return head.count(0) == 0 and sum(byte > 126 for byte in head) <= len(head) // 10


def _one(values: Sequence, random: np.random.Generator):
    return values[int(random.integers(len(values)))]


def _place(length: int, random: np.random.Generator) -> int:
    """Return a place, half of the time in the first 512 bytes."""
    if length == 0:
        return 0
    return int(random.integers(min(length, 512) if random.random() < 0.5 else length))


def _length(random: np.random.Generator) -> int:
    return int(min(random.geometric(0.1) if random.random() < 0.9 else random.integers(1, 5000), 5000))
