# SPDX-License-Identifier: Apache-2.0
"""The trials of the hard cases, by what is hard; each makes a Trial from a kind of body, options and random numbers."""
