# SPDX-License-Identifier: Apache-2.0
"""Hard cases: simulations that must stay finite, add no energy, recover, and report residuals, at any settings."""
