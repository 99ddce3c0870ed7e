// SPDX-License-Identifier: Apache-2.0
// Reads 16 bytes at once.
#if defined(__CUDA_ARCH__)
int x, y, z, w;
asm volatile("{\n"
    ".reg .b64 low, high;\n"
    ".reg .b128 all;\n"
    "ld.relaxed.gpu.global.b128 all, [%4];\n"
    "mov.b128 {low, high}, all;\n"
    "mov.b64 {%0, %1}, low;\n"
    "mov.b64 {%2, %3}, high;\n"
    "}" : "=r"(x), "=r"(y), "=r"(z), "=r"(w) : "l"(__cvta_generic_to_global((const float4*)address + i)) : "memory");
return wp::vec4(__int_as_float(x), __int_as_float(y), __int_as_float(z), __int_as_float(w));
#else
return wp::vec4();
#endif
