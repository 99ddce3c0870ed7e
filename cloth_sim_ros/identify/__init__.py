# SPDX-License-Identifier: Apache-2.0
"""Identification of materials from a recording (docs/how-to/identify.md).

Each world simulates one candidate. The candidates that move most like the recording win. recording: observations;
observe: residuals of all worlds, on the device; candidates: residuals of values, a batch of worlds at a time; fit: the
values that fit best, with intervals; report: sentences, a plot and YAML.
"""
