// Exponential, logarithm, sine and cosine: the kernel calls no mathematical library, whose last digits would depend on
// the platform. Errors are below 1 ulp, of sine and cosine
// below 1.5 ulp up to 100 rad and 2.5 ulp up to 1e5 rad (tests/test_native.py).
#pragma once

#include "real.hpp"

namespace needlefit {

constexpr double LN2_HIGH = 0x1.62e42fefa38p-1;  // its last bits are 0, so that small multiples are exact
constexpr double LN2_LOW = 0x1.ef35793c7673p-45;
constexpr double ROUNDER = 0x1.8p52;  // added and subtracted, it rounds to the nearest integer

// 2^k, for -1022 <= k <= 1023.
INLINE double power_of_two(Index k) { return __builtin_bit_cast(double, (k + 1023) << 52); }

// e^x: 2^k e^r with |r| <= ln 2 / 2, and Taylor's series of e^r to the last digit.
inline double exponential(double x) {
    if (!(x < 709.79)) return x != x ? x : __builtin_inf();
    if (x < -745.2) return 0.0;
    double k = (x * 1.4426950408889634 + ROUNDER) - ROUNDER;
    double high = x - k * LN2_HIGH, low = k * LN2_LOW, r = high - low, lost = (high - r) - low;
    double sum = 0.0;
    for (double n = 13.0; n > 2.5; n -= 1.0) sum = (sum + 1.0) * r * (1.0 / n);
    // e^r = 1 + r + r^2/2 (1 + r/3 (1 + ...)), the smallest parts first
    double value = 1.0 + (r + (0.5 * r * r * (1.0 + sum) + lost));
    Index half = Index(k) / 2;  // in two steps, for numbers near the ends of the range
    return value * power_of_two(half) * power_of_two(Index(k) - half);
}

// ln(1 + f), plus k ln 2, for 0.7 < 1 + f < 1.42: 2 artanh(s) with s = f / (2 + f), by its series.
inline double sum_logarithm(double f, double k) {
    double s = f / (2.0 + f), z = s * s, sum = 0.0, square = 0.5 * f * f;
    for (double n = 21.0; n > 2.0; n -= 2.0) sum = z * (2.0 / n + sum);
    // ln(1 + f) = f - (f^2/2 - s (f^2/2 + sum))
    return k * LN2_HIGH - ((square - (s * (square + sum) + k * LN2_LOW)) - f);
}

// ln x, for normal x > 0.
inline double logarithm(double x) {
    if (!(x > 0.0)) return x == 0.0 ? -__builtin_inf() : __builtin_nan("");
    if (x > 0x1.fffffffffffffp1023) return x;
    unsigned long long bits = __builtin_bit_cast(unsigned long long, x);
    Index k = Index(bits >> 52) - 1023;
    double m = __builtin_bit_cast(double, (bits & 0xfffffffffffffULL) | 0x3ff0000000000000ULL);
    if (m > 1.4142135623730951) m *= 0.5, k++;
    return sum_logarithm(m - 1.0, double(k));
}

// ln(1 - d), for d < 1; without the loss of digits that 1 - d has for a small d.
inline double logarithm_of_1_minus(double d) {
    return d < 0.25 && d > -0.25 ? sum_logarithm(-d, 0.0) : logarithm(1.0 - d);
}

// Sine and cosine of an angle up to 1e5 rad: by their series on |r| <= pi / 4, and the quadrant.
template <class Real>
INLINE void sine_cosine(const Real& x, Real& sine, Real& cosine) {
    constexpr double PART_1 = 0x1.921fb544p+0, PART_2 = 0x1.0b4611a6p-34, PART_3 = 0x1.3198a2e037073p-69;  // of pi / 2
    Real n = (x * 0.6366197723675814 + ROUNDER) - ROUNDER;
    Real r = ((x - n * PART_1) - n * PART_2) - n * PART_3;
    Real q = r * r;
    Real s = q * (-1.0 / 272.0);
    s = (1.0 + s) * q * (-1.0 / 210.0), s = (1.0 + s) * q * (-1.0 / 156.0), s = (1.0 + s) * q * (-1.0 / 110.0);
    s = (1.0 + s) * q * (-1.0 / 72.0), s = (1.0 + s) * q * (-1.0 / 42.0), s = (1.0 + s) * q * (-1.0 / 20.0);
    s = r + r * ((1.0 + s) * q * (-1.0 / 6.0));
    Real c = q * (-1.0 / 240.0);
    c = (1.0 + c) * q * (-1.0 / 182.0), c = (1.0 + c) * q * (-1.0 / 132.0), c = (1.0 + c) * q * (-1.0 / 90.0);
    c = (1.0 + c) * q * (-1.0 / 56.0), c = (1.0 + c) * q * (-1.0 / 30.0), c = (1.0 + c) * q * (-1.0 / 12.0);
    Real half = 0.5 * q, high = 1.0 - half;
    c = high + (((1.0 - high) - half) - half * c);
    if (!any(n != 0.0)) {
        sine = s, cosine = c;
        return;
    }
    Real quadrant = n - 4.0 * ((0.25 * n + ROUNDER) - ROUNDER);  // -2 ... 2
    Mask<Real> turned = (quadrant == 1.0) | (quadrant == -1.0), opposite = (quadrant == 2.0) | (quadrant == -2.0);
    sine = select<Real>(turned, c, s);
    cosine = select<Real>(turned, s, c);
    sine = select<Real>(opposite | (quadrant == -1.0), -sine, sine);
    cosine = select<Real>(opposite | (quadrant == 1.0), -cosine, cosine);
}

}  // namespace needlefit
