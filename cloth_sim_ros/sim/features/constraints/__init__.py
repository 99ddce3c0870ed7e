# SPDX-License-Identifier: Apache-2.0
"""Constraints between any two particles of a body."""
