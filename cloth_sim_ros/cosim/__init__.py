# SPDX-License-Identifier: Apache-2.0
"""Cloth and ropes together with another simulator, which moves what holds them and feels their forces."""
