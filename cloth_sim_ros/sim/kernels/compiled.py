# SPDX-License-Identifier: Apache-2.0
"""How Warp compiles this package's kernels."""

import functools
from collections.abc import Callable
from typing import Any

import warp as wp

# Without fused multiply-adds a frame on a CPU takes a tenth longer. On a GPU it is at most a twentieth, and with them
# one line of code may round differently in the kernels of one world and of many. All kernels have the same options:
# for others, a process that compiles would read Warp's headers once more, which takes 1.7 s of a core.
OPTIONS = {
    "enable_backward": False,
    "fuse_fp": False,
    "cpu_compiler_flags": f"{wp.config.cpu_compiler_flags} -ffp-contract=fast",
}


def compiled(function: Callable | None = None, **options: Any) -> wp.Kernel | Callable:
    """A Warp kernel of a function, as `wp.kernel` makes it with these options and OPTIONS."""
    if function is None:
        return functools.partial(compiled, **options)
    if options.get("module") == "unique":
        return wp.kernel(function, module_options=OPTIONS, **options)
    wp.set_module_options(OPTIONS, options.get("module") or wp.get_module(function.__module__))
    return wp.kernel(function, **options)
