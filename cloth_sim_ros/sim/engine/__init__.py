# SPDX-License-Identifier: Apache-2.0
"""Bodies in batches, their frames, and rebuilding them."""
