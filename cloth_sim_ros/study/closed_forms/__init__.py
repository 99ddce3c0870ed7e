# SPDX-License-Identifier: Apache-2.0
"""Closed forms that a cloth or a rope must reproduce, and their discrete counterparts, in float64.

One file per subject: ropes, oscillator, bending, contact, sheets. A discrete counterpart is the exact answer of the
same particles and springs, so that a test of the solver does not measure the mesh.
"""
