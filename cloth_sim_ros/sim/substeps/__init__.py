# SPDX-License-Identifier: Apache-2.0
"""The choice of substeps, iterations and order for each object."""
