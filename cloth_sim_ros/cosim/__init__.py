# SPDX-License-Identifier: Apache-2.0
"""Cloth and ropes coupled with another simulator, which moves their supports and feels their forces."""
