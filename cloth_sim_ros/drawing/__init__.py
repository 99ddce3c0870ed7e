# SPDX-License-Identifier: Apache-2.0
"""Shapes and views that pictures, films and the viewer draw."""
