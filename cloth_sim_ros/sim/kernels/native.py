# SPDX-License-Identifier: Apache-2.0
"""The C++ of Warp's native functions, which lies in .h files beside the modules that declare them.

A file holds the body of its function. Code shorter than a dozen lines stays with its declaration.
"""

from pathlib import Path

LANES = 8  # numbers in a vector register of a CPU, as in simd.h


def source(module: str, *files: str, **constants: int) -> str:
    """The text of .h files beside a module, one behind the other; each of the constants is known in them.

    module: its `__file__`. files: names without the suffix.
    """
    known = "".join(f"constexpr int {name} = {value};\n" for name, value in constants.items())
    return "\n" + known + "".join(Path(module).with_name(f"{file}.h").read_text() for file in files)


def on_cpu(code: str, otherwise: str = "") -> str:
    """Code that a CPU runs, while a GPU runs `otherwise`."""
    return f"\n#if !defined(__CUDA_ARCH__)\n{code}\n#else\n{otherwise}\n#endif\n"


ROWS = source(__file__, "simd")  # fills and empties vectors of eight lanes
