# SPDX-License-Identifier: Apache-2.0
"""A web page that shows a running node, and five pages that teach the method; see docs/how-to/viewer.md.

drawing, look: the picture. curves: charts. window: the server and the open page. live/ is the page of the running node,
over ROS; pages/ are those that teach, and need no ROS.
"""
