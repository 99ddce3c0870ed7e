# SPDX-License-Identifier: Apache-2.0
"""Which stages a substep has, and which method, substeps and iterations an object is given."""
