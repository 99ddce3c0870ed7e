# SPDX-License-Identifier: Apache-2.0
"""The services of simulation_interfaces, where that package is installed; nothing else imports it."""
