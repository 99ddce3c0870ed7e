# SPDX-License-Identifier: Apache-2.0
"""Topics that come in: checked, in the frame of the scene, and handed over."""
