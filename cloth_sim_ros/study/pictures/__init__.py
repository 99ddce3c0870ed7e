# SPDX-License-Identifier: Apache-2.0
"""Pictures that teach the method, drawn from what the product itself computes."""
