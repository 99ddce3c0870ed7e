# SPDX-License-Identifier: Apache-2.0
"""What acted on a world, and in which order; outputs/journal.py sends it."""

from __future__ import annotations

from typing import Any

VERSION = 2
ACTS = ("advance", "attach", "cut", "move", "put", "reset", "set_live", "set_pay_out", "set_wind", "take_away")


class Journal:
    """What acts on a World, in order, while it `runs`. Owned by the thread that simulates."""

    def __init__(self):
        self.runs = False
        self.is_cut = False  # what acts from now on does not lead on from what was noted before
        self._acts: list[list] = []

    def note(self, act: str, *arguments: Any) -> None:
        """Something of ACTS is done now."""
        if self.runs:
            self._acts.append([act, *arguments])

    def cut(self) -> None:
        """The simulation is another one now, or goes on from another state."""
        self.is_cut = True

    def take(self) -> list[list]:
        """What was noted since the last time."""
        acts, self._acts = self._acts, []
        return acts
