"""What is done to whole inputs to make hostile ones of them, each by the random numbers that it is given."""

from __future__ import annotations

import math
import random
from typing import Any

WORDS = (
    "1", "-1", "0", "1e400", ".inf", ".nan", "~", "[]", "{}", "[[1]]", "&a", "*a", "<<: *a", "!!set", "!!binary x",
    "- ", ": ", "? ", "x: 1", "{a: 1, a: 2}", "2024-13-45", "\x00", "\t", "\n", "#", "'", '"', "|", ">", "%", "@",
    "١٢", "9" * 400, "1" * 5001, "--- ", "on", "yes", "name", "plant", "extends: x.yaml", "../../etc/passwd",
    "$(touch x)", "\u202e", "\U0001f600", "<script>", "1/0", "9**9**9", "sin()", "max(1/0,x)", "[" * 1100,
    "(" * 1100, "{a: " * 300, "!!python/object/apply:os.system [x]", "NaN", "Infinity", "null", "-0", "1_000",
    "0x1F", "\ufeff", "\r", "\x1b[2J", "nan", "inf", "abc", "__import__('os')", "x.__class__", "lambda: 0",
    "e" * 20_000, "1,5", ";", ",,", "&#x41;", "<!ENTITY a 'b'>", "<a>", "</robot>", "]]>",
)  # fmt: skip
NAMES = ("sin", "cos", "tan", "atan", "tanh", "exp", "log", "sqrt", "abs", "sign", "min", "max", "eval", "open")
LEAVES = ("x", "y", "pi", "1", "0", "-1", "2.5", "1e300", "1e-300", "1e400", "9", "z", "()", "True", "'x'", "9" * 320,
          "٣", "x", "y", "0.1", "3", "100", "101", "1/3")  # fmt: skip
OPERATORS = ("+", "-", "*", "/", "^", "**", "//", "%", " ", "+", "-", "*", "/")


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bits flipped, words put in, parts removed, doubled, swapped or cut off."""
    for _ in range(rng.choice((1, 1, 2, 3, 6))):
        at, how = rng.randrange(len(data) + 1), rng.randrange(7)
        length = rng.choice((0, 1, 4, 12, 60))
        if how == 0 and data:
            k = min(at, len(data) - 1)
            data = data[:k] + bytes([data[k] ^ 1 << rng.randrange(8)]) + data[k + 1 :]
        elif how in (1, 2, 3):
            data = data[:at] + rng.choice(WORDS).encode() + data[at + length :]
        elif how == 4:
            data = data[:at] + data[at : at + length] * rng.choice((2, 2, 3, 50)) + data[at + length :]
        elif how == 5:
            data = data[:at] + data[at + length :] if rng.random() < 0.7 else data[:at]
        else:
            other = rng.randrange(len(data) + 1)
            data = data[:at] + data[other : other + length] + data[at:]
    return data


def expression(rng: random.Random, depth: int = 0) -> str:
    """A random expression, most of them of the right form."""
    how = rng.random()
    if depth > 5 or how < 0.3:
        return rng.choice(LEAVES)
    inner = expression(rng, depth + 1)
    if how < 0.6:
        return f"{inner}{rng.choice(OPERATORS)}{expression(rng, depth + 1)}"
    if how < 0.85:
        more = [expression(rng, depth + 1) for _ in range(rng.choice((0, 0, 0, 1, 2)))]
        return f"{rng.choice(NAMES)}({','.join([inner, *more] if rng.random() < 0.97 else [])})"
    return f"({inner})" if how < 0.95 else f"-{inner}"


def altered(content: Any, rng: random.Random) -> Any:
    """Plain content with a value replaced, removed or moved somewhere in it."""
    if isinstance(content, dict) and content and rng.random() < 0.9:
        key = rng.choice(list(content))
        if rng.random() < 0.1:
            return {k: v for k, v in content.items() if k != key}
        return content | {key: altered(content[key], rng)}
    if isinstance(content, list) and content and rng.random() < 0.85:
        k = rng.randrange(len(content))
        if rng.random() < 0.15:
            return content[:k] + content[k + 1 :] * rng.choice((0, 1, 2))
        return [*content[:k], altered(content[k], rng), *content[k + 1 :]]
    if isinstance(content, int | float) and not isinstance(content, bool) and rng.random() < 0.5:
        whole = int(content) if abs(content) < math.inf else content
        return rng.choice((-content, content * 1e-6, content * 1e9, content + 1, float(content), whole))
    return rng.choice((None, True, [], {}, "", "x", 0, -1, 1e308, 2**70, [[]], {"a": []}, "nan", [1, "a"], 0.5, "1e5"))
