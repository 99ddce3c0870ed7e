# SPDX-License-Identifier: Apache-2.0
"""Sheets that tear and are cut."""
