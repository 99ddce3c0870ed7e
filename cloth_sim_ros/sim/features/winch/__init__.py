# SPDX-License-Identifier: Apache-2.0
"""Ropes on a winch."""
