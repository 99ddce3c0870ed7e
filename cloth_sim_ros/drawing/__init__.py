# SPDX-License-Identifier: Apache-2.0
"""Shapes and views for pictures, films and the viewer."""
