# SPDX-License-Identifier: Apache-2.0
"""How the program of a substep runs: a body in blocks, a launch a part, a frame as a trial."""
