# SPDX-License-Identifier: Apache-2.0
"""A demonstration of the node: see __main__.py."""
