# SPDX-License-Identifier: Apache-2.0
"""Journal of the acts on a world, in order; outputs/journal.py sends it."""

from __future__ import annotations

from typing import Any

VERSION = 2
ACTS = ("advance", "attach", "cut", "move", "put", "reset", "set_live", "set_pay_out", "set_wind", "take_away")


class Journal:
    """Acts on a World, in order, noted while it `runs`. Owned by the thread that simulates."""

    def __init__(self):
        self.runs = False
        self.is_cut = False  # what acts from now on does not lead on from what was noted before
        self._acts: list[list] = []

    def note(self, act: str, *arguments: Any) -> None:
        """Note an act of ACTS."""
        if self.runs:
            self._acts.append([act, *arguments])

    def cut(self) -> None:
        """Note that the simulation is another one now, or goes on from another state."""
        self.is_cut = True

    def take(self) -> list[list]:
        """Return the acts since the last call."""
        acts, self._acts = self._acts, []
        return acts
