# SPDX-License-Identifier: Apache-2.0
"""Study of speed against error: float64 references, closed forms, cases, sweeps and figures, without rclpy."""
