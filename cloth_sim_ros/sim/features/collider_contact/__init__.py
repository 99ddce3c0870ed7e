# SPDX-License-Identifier: Apache-2.0
"""Contact of particles and facets with colliders, with friction."""
