# SPDX-License-Identifier: Apache-2.0
"""Executors run the program of a substep: one block a body, one launch a part, or a frame as a trial."""
