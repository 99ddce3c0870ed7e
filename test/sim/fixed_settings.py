# SPDX-License-Identifier: Apache-2.0
"""Settings of tests that are about a method, not about what is chosen."""

from cloth_sim_ros.sim import Settings


def fixed(**settings) -> Settings:
    """Second-order XPBD at 20 x 1 where `settings` say nothing else, as `auto` has it: they share kernels."""
    if settings.get("method", "xpbd") == "xpbd":
        settings = {"method": "xpbd", "order": 2, "iterations": 1, **settings}
    return Settings(**{"substeps": 20, **settings})
