# SPDX-License-Identifier: Apache-2.0
"""The user's description of a scene: objects, materials, handles, forces and settings, checked."""
