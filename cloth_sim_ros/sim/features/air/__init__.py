# SPDX-License-Identifier: Apache-2.0
"""The air on triangles and segments."""
