# SPDX-License-Identifier: Apache-2.0
"""Forces of the air on triangles and segments."""
