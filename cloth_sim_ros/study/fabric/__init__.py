# SPDX-License-Identifier: Apache-2.0
"""Tests of textile laboratories, on presets and on the user's own fabrics."""
