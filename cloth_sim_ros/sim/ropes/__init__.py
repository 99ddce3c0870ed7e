# SPDX-License-Identifier: Apache-2.0
"""Ropes solved as a whole, in stretch, bending and twist: by one thread from both ends, or by a block."""
