# SPDX-License-Identifier: Apache-2.0
"""Clients of a Simulation: grippers, read-back, worlds that differ at random."""
