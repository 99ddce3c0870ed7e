# SPDX-License-Identifier: Apache-2.0
"""Materials found from a recording: worlds are candidates, and those that move as it did win (docs/how-to/identify.md).

recording: what was seen; observe: how far worlds are from it, on the device; candidates: values -> residuals, a batch
of worlds at a time; fit: the values that fit best, and what is known of them; report: words, a plot and YAML.
"""
