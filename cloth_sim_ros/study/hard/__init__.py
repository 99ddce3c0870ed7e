# SPDX-License-Identifier: Apache-2.0
"""Hard cases: what must stay finite, add no energy, recover, and say what it could not meet, whatever the settings."""
