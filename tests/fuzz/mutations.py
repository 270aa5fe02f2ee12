"""Spoils bytes and texts; each way of it is a function of a random generator and the bytes alone."""

import random
import re
from collections.abc import Callable

Mutate = Callable[[random.Random, bytes, list[bytes]], bytes]
"""Random generator, bytes, and all seeds of the kind, from which parts may be taken."""

_NUMBERS = (
    0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 45, (1 << 63) - 1,
    (1 << 64) - 1,
)  # fmt: skip
_TOKENS = (
    "~", "", "''", "[]", "{}", "true", "no", "-", "?", ":", "#", "|", ">", "*", "&a", "*a", "<<", "%", "@", "`",
    "!", "!!", "2001-13-45", "2001-01-01T99:99:99Z", "0o9", "0b2", "0x", "1_", "190:20:30", ".nan", ".inf",
    "-.inf", "1e999", "-0.0", "1e308", "-1e308", "1e-320", "9" * 30, "9" * 5000, "0x" + "f" * 3000,
    "1:" * 900 + "1", "nan", "NaN", "inf", '!!int ""', "!!int x", '!!float ""', "!!bool x", "!!timestamp x",
    "!!binary x", "!!set {a, b}", "!!omap [a]", "!!str 1", "!!python/object/apply:os.system [x]", "!!null 3",
    "!!pairs [a]", "&a [*a]", "{? [a] : b}", "{? {} : b}", '"\\0"', '"\\ud800"', '"\\U0010ffff"', '"\\Uffffffff"',
    '"\\x41"', "\x00", "\ufeff", "\u2028", "\x85", "é", "\U0001f525", "../../etc/passwd", "/dev/zero",
    "/dev/stdin", "/proc/self/mem", "file:///etc/passwd", "http://127.0.0.1:1/x", ".", "[" * 900, "{a: " * 200,
    "- " * 500, "a" * 70000, "--- a\n--- b", "...", "EPSG:0", "EPSG:4326", "EPSG:99999", "\t",
    "a: &a [x, x, x, x, x, x, x, x, x]\nb: &b [*a, *a, *a, *a, *a, *a, *a, *a]\n"
    "c: &c [*b, *b, *b, *b, *b, *b, *b, *b]\nd: &d [*c, *c, *c, *c, *c, *c, *c]\ne: [*d, *d, *d, *d, *d, *d]\n",
)  # fmt: skip
MOST_TEXT = 32 << 20
"""Characters that one line is repeated to, twice what the largest reader takes: a text may be one line."""
_CUTS = re.compile(r"(?<=[:,\[\]{}\n -])")


def spoil_bytes(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    """One to six spoilings."""
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        data = rng.choice(_BYTE_WAYS)(rng, data, seeds)
    return data


def spoil_text(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    """As `spoil_bytes`, and words in place of values: those that parsers are known to stumble over."""
    if rng.random() < 0.25:
        return spoil_bytes(rng, data, seeds)
    text = data.decode("utf-8", "replace")
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        text = rng.choice((_replaced_value, _replaced_value, _token_at, _moved_part, _nested, repeated_line))(rng, text)
    return text.encode("utf-8", "surrogatepass")


def _replaced_value(rng: random.Random, text: str) -> str:
    found = list(re.finditer(r"(?<=: )[^\n,\[\]{}]+|(?<=[,\[])[^\n,\[\]{}]+|(?<=- )[^\n,\[\]{}]+", text))
    if not found:
        return _token_at(rng, text)
    match = rng.choice(found)
    return text[: match.start()] + rng.choice(_TOKENS) + text[match.end() :]


def _token_at(rng: random.Random, text: str) -> str:
    at = rng.choice([m.start() for m in _CUTS.finditer(text)] or [0])
    return text[:at] + rng.choice(_TOKENS) + text[at + rng.choice((0, 0, 1, 5)) :]


def _moved_part(rng: random.Random, text: str) -> str:
    lines = text.splitlines(keepends=True)
    if len(lines) < 2:
        return text
    line = lines.pop(rng.randrange(len(lines)))
    if rng.random() < 0.7:
        lines.insert(rng.randrange(len(lines) + 1), " " * rng.randrange(0, 5) + line)
    return "".join(lines)


def repeated_line(rng: random.Random, text: str) -> str:
    lines = text.splitlines(keepends=True) or [""]
    at = rng.randrange(len(lines))
    times = min(rng.choice((2, 3, 50)), max(1, MOST_TEXT // max(1, len(lines[at]))))
    return "".join([*lines[:at], *[lines[at]] * times, *lines[at + 1 :]])


def _nested(rng: random.Random, text: str) -> str:
    begin, end = rng.choice((("[", "]"), ("{a: ", "}"), ("- ", ""), ("(", ")")))
    depth = rng.choice((3, 39, 60, 900, 5000))
    at = rng.choice([m.start() for m in _CUTS.finditer(text)] or [0])
    return text[:at] + begin * depth + end * depth + text[at:]


def _flip(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    changed = bytearray(data)
    for _ in range(min(len(changed), rng.choice((1, 1, 2, 8, 64)))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _overwrite(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    """A length, perhaps."""
    width = rng.choice((1, 2, 4, 8))
    number = rng.choice((*_NUMBERS, rng.getrandbits(8 * width))) & ((1 << 8 * width) - 1)
    at = rng.randrange(max(1, len(data) - width + 1))
    if rng.random() < 0.5:
        at = min(at, rng.randrange(1, 512))  # heads are where lengths stand
    return data[:at] + number.to_bytes(width, rng.choice(("little", "big"))) + data[at + width :]


def _cut(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _without(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    begin = rng.randrange(len(data) + 1)
    return data[:begin] + data[begin + rng.choice((1, 4, 100, 5000)) :]


def _repeated(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    begin = rng.randrange(len(data) + 1)
    part = data[begin : begin + rng.choice((1, 8, 64, 4000))]
    return data[:begin] + part * rng.choice((2, 3, 100)) + data[begin:]


def _filled(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    begin = rng.randrange(len(data) + 1)
    size = rng.choice((4, 64, 1000))
    return data[:begin] + bytes([rng.choice((0, 0xFF, rng.randrange(256)))]) * size + data[begin + size :]


def _spliced(rng: random.Random, data: bytes, seeds: list[bytes]) -> bytes:
    other = rng.choice(seeds)
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


_BYTE_WAYS: tuple[Mutate, ...] = (
    _flip, _flip, _overwrite, _overwrite, _overwrite, _cut, _without, _repeated, _filled, _spliced,
)  # fmt: skip
