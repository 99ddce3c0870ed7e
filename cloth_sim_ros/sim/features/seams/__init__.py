# SPDX-License-Identifier: Apache-2.0
"""Seams between two objects, or of one with itself."""
