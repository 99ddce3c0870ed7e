# SPDX-License-Identifier: Apache-2.0
"""The little that Warp cannot say: intrinsics, cooperative groups, compiler options and native code."""
