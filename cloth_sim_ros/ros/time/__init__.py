# SPDX-License-Identifier: Apache-2.0
"""When a frame is due, and the thread that simulates."""
