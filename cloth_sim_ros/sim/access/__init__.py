# SPDX-License-Identifier: Apache-2.0
"""Reading and writing a simulation while it runs."""
