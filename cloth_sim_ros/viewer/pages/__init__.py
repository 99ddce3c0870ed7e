# SPDX-License-Identifier: Apache-2.0
"""Pages that teach. To add one, write a Page and list it here."""

PAGES = ()
