// Exponential, logarithm, sine and cosine: the kernel calls no mathematical library, whose last digits would depend on
// the platform. Errors are below 1 ulp, of ln(1 - d) below 2.5 ulp for 0 <= d < 1, of sine and cosine below 1.5 ulp up
// to 100 rad and 2.5 ulp up to 1e5 rad (tests/test_native.py).
#pragma once

#include "real.hpp"

namespace needlefit {

constexpr double LN2_HIGH = 0x1.62e42fefa38p-1;  // its last bits are 0, so that small multiples are exact
constexpr double LN2_LOW = 0x1.ef35793c7673p-45;
constexpr double ROUNDER = 0x1.8p52;  // added and subtracted, it rounds to the nearest integer

// A small integer as the low bits of ROUNDER + k, and back.
template <class Real>
INLINE Integers<Real> read_integer(const Real& rounded) {
    return __builtin_bit_cast(Integers<Real>, rounded) - __builtin_bit_cast(Index, ROUNDER);
}
template <class Real>
INLINE Real write_integer(const Integers<Real>& k) {
    return __builtin_bit_cast(Real, k + __builtin_bit_cast(Index, ROUNDER)) - ROUNDER;
}
// 2^k, for -1022 <= k <= 1023.
template <class Real>
INLINE Real power_of_two(const Integers<Real>& k) {
    return __builtin_bit_cast(Real, (k + 1023) << 52);
}

// e^x: 2^k e^r with |r| <= ln 2 / 2, and Taylor's series of e^r to the last digit.
template <class Real>
INLINE Real exponential(const Real& given) {
    constexpr double HIGHEST = 709.79, LOWEST = -745.2;  // beyond, the result is infinite or 0
    Real x = select<Real>(given < HIGHEST, given, all_lanes<Real>(HIGHEST));
    x = select<Real>(x > LOWEST, x, all_lanes<Real>(LOWEST));
    Real rounded = x * 1.4426950408889634 + ROUNDER, k = rounded - ROUNDER;
    Real high = x - k * LN2_HIGH, low = k * LN2_LOW, r = high - low, lost = (high - r) - low;
    Real sum{};
    for (int n = 13; n > 2; n--) sum = (sum + 1.0) * r * (1.0 / n);
    // e^r = 1 + r + r^2/2 (1 + r/3 (1 + ...)), the smallest parts first
    Real value = 1.0 + (r + (0.5 * r * r * (1.0 + sum) + lost));
    Integers<Real> whole = read_integer(rounded), half = whole >> 1;  // in two steps, for the ends of the range
    value = value * power_of_two<Real>(half) * power_of_two<Real>(whole - half);
    value = select<Real>(given >= HIGHEST, all_lanes<Real>(__builtin_inf()), value);
    value = select<Real>(given < LOWEST, Real{}, value);
    return select<Real>(given != given, given, value);
}

// ln(1 + f), plus k ln 2, for 0.7 < 1 + f < 1.42: 2 artanh(s) with s = f / (2 + f), by its series.
template <class Real>
INLINE Real sum_logarithm(const Real& f, const Real& k) {
    Real s = f / (2.0 + f), z = s * s, sum{}, square = 0.5 * f * f;
    for (int n = 21; n > 2; n -= 2) sum = z * (2.0 / n + sum);
    // ln(1 + f) = f - (f^2/2 - s (f^2/2 + sum))
    return k * LN2_HIGH - ((square - (s * (square + sum) + k * LN2_LOW)) - f);
}

// ln x, for normal x > 0.
template <class Real>
INLINE Real logarithm(const Real& x) {
    Integers<Real> bits = __builtin_bit_cast(Integers<Real>, x), k = (bits >> 52) - 1023;
    Real m = __builtin_bit_cast(Real, (bits & 0xfffffffffffffLL) | 0x3ff0000000000000LL);
    Mask<Real> large = m > 1.4142135623730951;
    Real found = sum_logarithm<Real>(
        select<Real>(large, 0.5 * m, m) - 1.0, write_integer<Real>(k) + select<Real>(large, all_lanes<Real>(1.0), Real{})
    );
    found = select<Real>(x > 0x1.fffffffffffffp1023, x, found);
    Real none = select<Real>(x == 0.0, all_lanes<Real>(-__builtin_inf()), all_lanes<Real>(__builtin_nan("")));
    return select<Real>(x > 0.0, found, none);
}

// ln(1 - d), for d < 1; without the loss of digits that 1 - d has for a small d.
template <class Real>
INLINE Real logarithm_of_1_minus(const Real& d) {
    Mask<Real> small = (d < 0.25) & (d > -0.25);
    Real found = sum_logarithm<Real>(-d, Real{});
    if (any(!small)) found = select<Real>(small, found, logarithm<Real>(1.0 - d));
    return found;
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
