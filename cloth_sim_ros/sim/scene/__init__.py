# SPDX-License-Identifier: Apache-2.0
"""The scene as its user describes it: objects, materials, handles, forces and settings, checked."""
