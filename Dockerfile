# SPDX-License-Identifier: Apache-2.0
# The node in ROS 2 Jazzy:
#   docker build --tag cloth_sim_ros .
#   docker run --rm --gpus all --net host --ipc host cloth_sim_ros
# --gpus needs the NVIDIA Container Toolkit; without it the node computes on the CPU. --net and --ipc let nodes outside
# of the container hear it.
FROM ros:jazzy

# Warp brings its own CUDA; of the machine it needs the driver alone.
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility
SHELL ["/bin/bash", "-o", "pipefail", "-c"]

WORKDIR /workspace
COPY . src/cloth_sim_ros
# An environment that sees ROS, as pip may not install into the system's (PEP 668). The messages of ROS are compiled
# against NumPy 1.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends make python3-venv \
    && rosdep update \
    && rosdep install --from-paths src --ignore-src --rosdistro jazzy --default-yes \
    && rm -rf /var/lib/apt/lists/* \
    && python3 -m venv --system-site-packages .venv \
    && .venv/bin/pip install --no-cache-dir 'numpy<2' './src/cloth_sim_ros[viewer,record]'

ENV PATH=/workspace/.venv/bin:$PATH
# The entry point of ros:jazzy sources ROS.
CMD ["cloth_sim_demo", "curtain"]
