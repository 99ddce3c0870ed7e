# SPDX-License-Identifier: Apache-2.0
"""Incoming topics: messages are checked, transformed into the frame of the scene, and passed on."""
