# SPDX-License-Identifier: Apache-2.0
"""Services of simulation_interfaces, if that package is installed; nothing else imports it."""
