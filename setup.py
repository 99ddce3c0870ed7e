# SPDX-License-Identifier: Apache-2.0
"""Installs cloth_sim_ros with colcon (ament_python) or with pip."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "cloth_sim_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={f"{NAME}.ros": ["fastdds.xml"], f"{NAME}.sim": ["*/*.h", "*/*/*.h"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", glob("config/*")),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools", "numpy", "scipy", "warp-lang==1.19.*"],
    extras_require={
        "ros": ["ros-jazzy-rclpy", "ros-jazzy-common-interfaces", "ros-jazzy-rmw-fastrtps-cpp"],
        "mesh": ["trimesh", "shapely>=2.1"],
        "urdf": ["yourdfpy"],
        "record": ["rosbags"],
        "export": ["rosbags", "pygltflib", "trimesh", "matplotlib", "imageio-ffmpeg", "tqdm"],
        "viewer": ["viser>=1.1"],
        "study": ["matplotlib", "pyyaml", "trimesh"],
        "identify": ["matplotlib", "pyyaml"],
        "cluster": ["ray>=2.40", "matplotlib", "pyyaml"],
        "learn": ["gymnasium>=1.1", "matplotlib", "trimesh"],
        "mujoco": ["mujoco>=3.2,<4"],
        "docs": ["sphinx", "myst-parser", "furo"],
        "cosserat": ["cosseratbench==0.3.*", "mujoco>=3.2,<4", "pyelastica"],
        "peers": ["newton==1.8.0", "mujoco", "mujoco-warp", "pypbd"],
        "test": [
            "pytest",
            "pytest-xdist",
            "pytest-rerunfailures",
            "ruff",
            "trimesh",
            "shapely>=2.1",
            "yourdfpy",
            "matplotlib",
            "pypbd",
            "rosbags",
            "pygltflib",
            "imageio-ffmpeg",
            "gymnasium>=1.1",
            "ray>=2.40",
            "build",
            "twine",
            "sphinx",
            "myst-parser",
            "furo",
            "catkin_pkg",
            "colcon-common-extensions",
            "pyyaml",
        ],
    },
    python_requires=">=3.10",
    zip_safe=False,
    maintainer="cloth_sim_ros maintainers",
    maintainer_email="cloth_sim_ros@users.noreply.github.com",
    description="Cloth and ropes, simulated live in ROS 2 with XPBD on NVIDIA Warp.",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "cloth_sim_node = cloth_sim_ros.programs:node",
            "cloth_sim_viewer = cloth_sim_ros.programs:viewer",
            "cloth_sim_record = cloth_sim_ros.programs:record",
            "cloth_sim_replay = cloth_sim_ros.programs:replay",
            "cloth_sim_export = cloth_sim_ros.programs:export",
            "cloth_sim_driver = cloth_sim_ros.programs:driver",
            "cloth_sim_demo = cloth_sim_ros.programs:demo",
        ],
        "cosseratbench.solvers": ["cloth_sim = cloth_sim_ros.study.cosserat:Solver"],
    },
)
