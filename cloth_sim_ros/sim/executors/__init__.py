# SPDX-License-Identifier: Apache-2.0
"""How the program of a substep runs: a body in a block, a launch a stage, vector rows, subdomains with halos."""
