# SPDX-License-Identifier: Apache-2.0
"""Trials of the hard cases; each function makes a Trial from a kind of body, options and random numbers."""
