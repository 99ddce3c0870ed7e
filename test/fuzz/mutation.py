# SPDX-License-Identifier: Apache-2.0
"""Damage to files and texts, from a seed, and a guard against what hangs."""

from __future__ import annotations

import random
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager

PATIENCE = 60  # [s] after which reading one file counts as hanging
ODD = (
    *("nan", ".nan", "-.inf", "1e300", "-1", "0", "1e-30", "99999999999999999999", "0x10", "[]", "{}", "[[1]]", "null"),
    *(
        "~",
        "true",
        "''",
        "'a b'",
        "&a",
        "*a",
        "!!python/object:os.system x",
        "- 1",
        "\u00e9\U0001f9f5",
        "\0",
        "a" * 300,
    ),
)


def damaged(rng: random.Random, data: bytes) -> bytes:
    """A few bytes are flipped, lost, doubled, zeroed, inserted, or the end is cut."""
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at, length = rng.randrange(len(data) + 1), rng.choice((1, 4, 64, 1024))
        part, how = data[at : at + length], rng.randrange(6)
        if how == 0 and at < len(data):
            data[at] ^= 1 << rng.randrange(8)
        elif how == 1:
            del data[at : at + length]
        elif how == 2:
            data[at:at] = part
        elif how == 3:
            data[at : at + length] = bytes(len(part))
        elif how == 4:
            data[at:at] = rng.randbytes(min(length, 64))
        elif how == 5 and rng.random() < 0.3:
            del data[at:]
    return bytes(data)


def reworded(rng: random.Random, text: str) -> str:
    """A few words or numbers of a text are others, odd ones, or change places."""
    words = re.split(r"([\s,:\[\]{}\"<>=/]+)", text)
    for _ in range(rng.choice((1, 1, 2, 5))):
        a, b = rng.randrange(len(words)), rng.randrange(len(words))
        how = rng.randrange(4)
        if how == 0:
            words[a] = rng.choice(ODD)
        elif how == 1:
            words[a], words[b] = words[b], words[a]
        elif how == 2:
            words[a] = words[b]
        else:
            del words[a]
        words = words or [""]
    return "".join(words)


@contextmanager
def guarded(what: object) -> Iterator[None]:
    """Fails where the block hangs."""

    def fail(*_: object) -> None:
        raise AssertionError(f"it hangs at {what}")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def sentence(error: Exception) -> bool:
    """Whether this is one sentence of a bearable length."""
    text = str(error)
    return 0 < len(text) < 2000 and "\n" not in text and "\0" not in text
