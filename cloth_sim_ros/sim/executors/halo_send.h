// SPDX-License-Identifier: Apache-2.0
// Writes 16 bytes at once, which all blocks of a launch see.
#if defined(__CUDA_ARCH__)
asm volatile("{\n"
    ".reg .b64 low, high;\n"
    ".reg .b128 all;\n"
    "mov.b64 low, {%1, %2};\n"
    "mov.b64 high, {%3, %4};\n"
    "mov.b128 all, {low, high};\n"
    "st.relaxed.gpu.global.b128 [%0], all;\n"
    "}" : : "l"(__cvta_generic_to_global((const float4*)address + i)), "r"(__float_as_int(v[0])),
    "r"(__float_as_int(v[1])), "r"(__float_as_int(v[2])), "r"(number) : "memory");
#endif
