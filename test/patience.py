# SPDX-License-Identifier: Apache-2.0
"""How long tests wait for other processes: longer while the machine has more to do than cores."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator


def patience(seconds: float) -> float:
    """`seconds` of an idle machine [s], as long as they take while others want its cores too."""
    return seconds * max(1.0, 1.5 * os.getloadavg()[0] / (os.cpu_count() or 1))


def tries(seconds: float, pause: float = 0.0) -> Iterator[float]:
    """Yields the seconds waited so far, until `patience(seconds)` is over; the load counts as it is by then."""
    begin = time.monotonic()
    while (waited := time.monotonic() - begin) < patience(seconds):
        yield waited
        time.sleep(pause)
