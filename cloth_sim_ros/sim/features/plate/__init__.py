# SPDX-License-Identifier: Apache-2.0
"""Bending of sheets as plates."""
