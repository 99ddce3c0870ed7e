# SPDX-License-Identifier: Apache-2.0
"""How many substeps and iterations an object is given, and of which order."""
