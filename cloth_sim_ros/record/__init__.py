# SPDX-License-Identifier: Apache-2.0
"""Recordings of a running node in bags, and their replay to the same bits: see docs/how-to/recording.md."""
