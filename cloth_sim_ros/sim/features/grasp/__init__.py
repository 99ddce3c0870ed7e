# SPDX-License-Identifier: Apache-2.0
"""Handles that hold particles and feel their pull."""
