# SPDX-License-Identifier: Apache-2.0
"""What one particle, panel or contact does in a substep: functions of a number and of Here."""
