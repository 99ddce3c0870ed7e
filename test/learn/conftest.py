# SPDX-License-Identifier: Apache-2.0
"""What these tests share: they run on every device that there is."""

import pytest
import warp as wp


def pytest_generate_tests(metafunc):
    if "device" in metafunc.fixturenames:
        wp.init()
        metafunc.parametrize("device", ["cpu", *(["cuda:0"] if wp.is_cuda_available() else [])], scope="session")


@pytest.fixture(scope="session", autouse=True)
def quiet():
    """Warp reports every kernel that it compiles; a test's output is for what fails."""
    wp.config.quiet = True
