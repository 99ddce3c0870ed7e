# SPDX-License-Identifier: Apache-2.0
"""Springs solved line by line: each line as a whole, and the lines of a family side by side."""
