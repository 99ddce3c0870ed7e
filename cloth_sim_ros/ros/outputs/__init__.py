# SPDX-License-Identifier: Apache-2.0
"""Outputs of the node."""
