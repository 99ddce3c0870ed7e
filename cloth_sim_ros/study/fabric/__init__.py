# SPDX-License-Identifier: Apache-2.0
"""The tests that textile laboratories make, on presets and fabrics of one's own."""
