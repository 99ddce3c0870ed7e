# SPDX-License-Identifier: Apache-2.0
"""Ropes that resist twist."""
