# SPDX-License-Identifier: Apache-2.0
"""Pages that teach. To add one, write a Page and list it here."""

from cloth_sim_ros.viewer.pages.colouring import Colouring
from cloth_sim_ros.viewer.pages.integrators import Integrators
from cloth_sim_ros.viewer.pages.iterations import Iterations
from cloth_sim_ros.viewer.pages.spring_network import SpringNetwork
from cloth_sim_ros.viewer.pages.whole_cloth import WholeCloth

PAGES = (SpringNetwork, Integrators, Iterations, Colouring, WholeCloth)
