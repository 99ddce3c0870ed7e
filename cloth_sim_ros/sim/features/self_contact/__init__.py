# SPDX-License-Identifier: Apache-2.0
"""Contact of objects with themselves and with one another."""
