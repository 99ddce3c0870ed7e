# SPDX-License-Identifier: Apache-2.0
"""Direct solves of whole ropes in stretch, bending and twist: by one thread from both ends, or by a block."""
