# SPDX-License-Identifier: Apache-2.0
"""One file per concept, each a few Warp functions on values; none reads an array, none imports another."""
