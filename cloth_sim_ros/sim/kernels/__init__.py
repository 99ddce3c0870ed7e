# SPDX-License-Identifier: Apache-2.0
"""Features that Warp lacks: intrinsics, cooperative groups, compiler options and native code."""
