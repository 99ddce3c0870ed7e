# SPDX-License-Identifier: Apache-2.0
"""Features of a scene. Each is a file or a folder with its stages; a scene without one compiles nothing of it."""
