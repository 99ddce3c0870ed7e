# SPDX-License-Identifier: Apache-2.0
"""Values and files that come from outside, checked."""
