// What differs between processes and processors and would show in the bytes of a result: the state of the arithmetic
// unit, which another library may have changed, and the bits of a NaN.
#pragma once

#include "real.hpp"

namespace needlefit {

// Rounds to the nearest number, keeps subnormal numbers and traps nothing while it exists; then all is as it was.
// Arithmetic must not move past it: results have to be in memory before it goes.
class DefaultArithmetic {
#if defined(__x86_64__) || defined(_M_X64)
    unsigned before;
    static void set(unsigned state) { __asm__ volatile("ldmxcsr %0" : : "m"(state) : "memory"); }

  public:
    DefaultArithmetic() {
        __asm__ volatile("stmxcsr %0" : "=m"(before));
        set(0x1f80);
    }
#elif defined(__aarch64__)
    unsigned long long before;
    static void set(unsigned long long state) { __asm__ volatile("msr fpcr, %0" : : "r"(state) : "memory"); }

  public:
    DefaultArithmetic() {
        __asm__ volatile("mrs %0, fpcr" : "=r"(before));
        set(0);
    }
#else  // WebAssembly has no such state
    static constexpr int before = 0;
    static void set(int) {}

  public:
    DefaultArithmetic() {}
#endif
    ~DefaultArithmetic() { set(before); }
    DefaultArithmetic(const DefaultArithmetic&) = delete;
};

constexpr double NOT_A_NUMBER = __builtin_bit_cast(double, 0x7ff8000000000000ULL);

// The same number; every NaN becomes one, since processors make different ones.
INLINE double canonical(double value) {
    unsigned long long bits = __builtin_bit_cast(unsigned long long, value) & ~(1ULL << 63);
    return bits > 0x7ff0000000000000ULL ? NOT_A_NUMBER : value;
}
inline void make_canonical(double* values, Index count) {
    for (Index i = 0; i < count; i++) values[i] = canonical(values[i]);
}

}  // namespace needlefit
