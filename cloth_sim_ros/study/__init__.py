# SPDX-License-Identifier: Apache-2.0
"""Speed against error: references in float64, closed forms, cases, sweeps and figures. Never imports rclpy."""
