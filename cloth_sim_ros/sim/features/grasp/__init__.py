# SPDX-License-Identifier: Apache-2.0
"""Handles hold particles and feel their pull."""
