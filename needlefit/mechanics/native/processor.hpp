// Which of the libraries for x86-64 this processor and its operating system can run.
#pragma once

namespace needlefit {

#if defined(__x86_64__) || defined(_M_X64)
struct Registers {
    unsigned a, b, c, d;
};
inline Registers ask_processor(unsigned leaf) {
    Registers found;
    __asm__ volatile("cpuid" : "=a"(found.a), "=b"(found.b), "=c"(found.c), "=d"(found.d) : "a"(leaf), "c"(0));
    return found;
}

// The level of the x86-64 instruction set: 2, 3 (AVX2) or 4 (AVX-512).
inline int find_processor_level() {
    constexpr unsigned FMA = 1u << 12, MOVBE = 1u << 22, OSXSAVE = 1u << 27, AVX = 1u << 28, F16C = 1u << 29;  // leaf 1, c
    constexpr unsigned V3 = 1u << 3 | 1u << 5 | 1u << 8;  // leaf 7, b: BMI1, AVX2, BMI2
    constexpr unsigned V4 = 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31;  // AVX-512 F, DQ, CD, BW, VL
    constexpr unsigned LEAF_1 = FMA | MOVBE | OSXSAVE | AVX | F16C;
    if (ask_processor(0).a < 7 || (ask_processor(1).c & LEAF_1) != LEAF_1) return 2;
    unsigned low, high;  // the registers that the operating system saves
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    unsigned more = ask_processor(7).b;
    bool lzcnt = ask_processor(0x80000000u).a >= 0x80000001u && (ask_processor(0x80000001u).c & 1u << 5);
    if ((low & 0x06) != 0x06 || (more & V3) != V3 || !lzcnt) return 2;
    return (low & 0xe6) == 0xe6 && (more & V4) == V4 ? 4 : 3;
}
#else
inline int find_processor_level() { return 0; }
#endif

}  // namespace needlefit
