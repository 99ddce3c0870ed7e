# SPDX-License-Identifier: Apache-2.0
"""Eight lanes of a CPU's vector registers: their number, and the C++ that fills and empties them."""

from pathlib import Path

LANES = 8
ROWS = (Path(__file__).parent / "simd.h").read_text()
