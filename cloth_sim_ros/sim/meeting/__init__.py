# SPDX-License-Identifier: Apache-2.0
"""Contact of objects with themselves and with one another: search.py finds what may meet, apart.py keeps it apart."""
