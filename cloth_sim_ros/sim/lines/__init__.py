# SPDX-License-Identifier: Apache-2.0
"""Springs solved line by line: a line as a whole, the lines of a family side by side."""
