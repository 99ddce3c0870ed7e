# SPDX-License-Identifier: Apache-2.0
"""Due times of frames, and the thread that simulates."""
