"""Damage to the bytes of a file: parts of it are replaced, anywhere and where its format has structure.

The same generator gives the same bytes.
"""

import gzip
import re
import struct
import zlib

MAX_BYTES = 2**20
"""Length of a mutant that grows."""

PARTS = tuple(
    map(
        re.compile,
        (
            rb"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?",  # a number in text, or in a header
            rb"[^\n]*\n",  # a line
            rb"[^\s,:;=\[\]{}]+",  # a cell of a table, a key or a value
            rb"[\[{][^\[\]{}]*[\]}]",  # an innermost list or table of JSON
        ),
    )
)
EXTREME_NUMBERS = (
    *b"0 -1 1 -0.0 65535 65536 2147483647 -2147483648 4294967296 9223372036854775807".split(),
    *b"9223372036854775808 -9223372036854775809 1e308 -1e308 1e309 1e-320 nan NaN inf -inf".split(),
    *b'Infinity 0x10 1_000 1,5 1e9 1e5 100000000 true "1" [] {} 1979-05-27T07:32:00Z 1e+ --1 .'.split(),
    *("٣²".encode(), b"9" * 400, b"9" * 5000, b"0." + b"0" * 400 + b"1"),
)
TOKENS = (
    *(b"\x1b[2J\x1b[31m", b"\x1b]0;title\x07", b"\x00", b"\r", b"\xff\xfe", b"\xef\xbb\xbf", b"\xc0\x80"),
    *(b"\xed\xa0\x80", "\u202e".encode(), "é".encode(), "\U0001f4a9".encode(), b"=cmd|' /C calc'!A0"),
    *rb"\ud800 \u0000 ../../etc/passwd /dev/zero /dev/stdin a/b %s%n {0} null __proto__ schema nan".split(),
    *(b'"""', b"\n\n", *map(str.encode, "\"'#,;\t|=[]{}-*~")),
    *(b"A" * 300, b"A" * 70_000, b"\n" * 3000, b"," * 5000, b" " * 20_000),
)
OPENINGS = (b"[", b"{", b'{"a":', b"(", b"a = [", b"[[a]]\n", b"a.", b"<a>", b'"', b"((")
ENCODINGS = ("utf-16", "utf-32", "utf-8-sig")


def mutate(data, others, random, packed=False):
    """Return `data` with one to five parts replaced, also by parts of `others`, which are valid inputs.

    Half of the mutants of `packed` data, which are gzip, are damaged inside and packed again.
    """
    if packed and random.random() < 0.5:
        try:
            return gzip.compress(mutate(gzip.decompress(data), (), random), 1, mtime=0)
        except (OSError, EOFError, zlib.error):
            pass
    for _ in range(min(5, int(random.geometric(0.5)))):
        begin, end = choose_part(data, random)
        filling = choose_filling(data, data[begin:end], others, random)
        data = (data[:begin] + filling + data[end:])[:MAX_BYTES]
    if random.random() < 0.03:
        data = data.decode("utf-8", "replace").encode(_one(ENCODINGS, random), "replace")[:MAX_BYTES]
    return data


def choose_part(data, random):
    """Return where a part begins and ends: found by a pattern, aligned as a binary number, or anywhere."""
    found = [match.span() for match in _one(PARTS, random).finditer(data[:200_000])]
    if found and random.random() < 0.6:
        return found[int(random.integers(len(found)))]
    at = int(random.integers(max(1, min(len(data), 512 if random.random() < 0.5 else len(data)))))
    if random.random() < 0.5:
        width = 2 ** int(random.integers(4))
        return at // width * width, at // width * width + width
    lengths = (0, random.geometric(0.1), random.integers(1, 5000), len(data))
    return at, at + int(_one(lengths, random))


def choose_filling(data, part, others, random):
    """Return what takes the place of a part: damaged bits of it, an extreme, or something from elsewhere."""
    source = _one(others, random) if len(others) and random.random() < 0.2 else data
    begin, end = choose_part(source, random)
    size = max(1, len(part))
    bits = (int.from_bytes(part, "little") ^ (1 << int(random.integers(8 * size)))).to_bytes(size, "little")
    top = 2 ** (8 * min(8, size))
    extremes = (0, 1, top - 1, top // 2, top // 2 - 1, top // 4, 3, 255)
    binary = (_one(extremes, random) % top).to_bytes(min(8, size), _one(("little", "big"), random))
    real = struct.pack("<d", _one((0.0, -1.0, 1e308, float("nan"), float("inf"), 1e-320), random))
    return _one(
        (
            *(b"", bits, bits, binary, binary, real, random.bytes(size)),
            *(_one(EXTREME_NUMBERS, random), _one(EXTREME_NUMBERS, random), _one(TOKENS, random)),
            _one((b"-", b"1", b"0."), random) + part,
            _one(OPENINGS, random) * int(_one((3, 70, 1000, 20_000), random)),
            source[begin:end],
            part * int(_one((2, 10, 500, 2000), random)) if len(part) < 2000 else b"",
        ),
        random,
    )


def _one(values, random):
    return values[int(random.integers(len(values)))]
