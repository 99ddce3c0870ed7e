# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM, which end a program."""

from __future__ import annotations

import signal
from typing import Any

NUMBERS = (signal.SIGINT, signal.SIGTERM)


class Stop:
    """Tells if SIGINT or SIGTERM has come since it was made, in the main thread.

    It holds no lock: a handler that waits for one, as that of an Event does, may wait for itself.
    """

    def __init__(self) -> None:
        self._came = False
        for number in NUMBERS:
            signal.signal(number, self._hear)

    def _hear(self, *_: Any) -> None:
        self._came = True

    def is_set(self) -> bool:
        """Return True if a signal has come."""
        return self._came
