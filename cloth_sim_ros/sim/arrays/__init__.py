# SPDX-License-Identifier: Apache-2.0
"""Arrays on the device that every body has, the structs of live numbers, and what writes them."""
