// The law of one layer: its modulus k(d) over mu at a compression d = |e| / t, exactly and as a polynomial.
//
// A law comes as numbers: either the powers of the stretch that it is the sum of, or a table of Chebyshev
// coefficients on equal pieces of 0 <= d <= 0.8. The derivative with respect to each shape parameter comes in the
// same form. The polynomial is what the lanes evaluate; beyond its range they ask for the exact law, one by one.
#pragma once

#include "functions.hpp"

namespace needlefit {

constexpr int SERIES_TERMS = 6;
constexpr int MAX_SHAPES = 16;  // shape parameters of a law
constexpr double SERIES_TOLERANCE = 1e-10;      // relative error of k that the polynomial may have
constexpr double MAX_SERIES_COMPRESSION = 0.2;  // a polynomial spans no more of the thickness
constexpr int TABLE_PIECES = 16, TABLE_TERMS = 20, TABLE_NUMBERS = 2 + TABLE_PIECES * TABLE_TERMS;
constexpr double TABLE_COMPRESSION = 0.8, TABLE_PIECE = TABLE_COMPRESSION / TABLE_PIECES;

// The cosines of Chebyshev's points for SERIES_TERMS points, and of the places halfway between them.
constexpr double CHEBYSHEV[SERIES_TERMS] = {0.9659258262890683,  0.7071067811865476,  0.2588190451025207,
                                            -0.2588190451025207, -0.7071067811865476, -0.9659258262890683};
constexpr double BETWEEN[SERIES_TERMS + 1] = {1.0, 0.8660254037844387, 0.5, 0.0, -0.5, -0.8660254037844387, -1.0};

// A law in numbers, of each lane. Powers (terms > 0): coefficients c_p, then exponents q_p. A table (terms = 0): the
// greatest d that it covers, that up to which a polynomial serves, and its coefficients, piece by piece.
template <class Real>
struct Law {
    static constexpr int W = Traits<Real>::lanes;
    const double* numbers[W];
    int terms;

    INLINE Real gather(Index i) const { return gather(numbers, i); }
    static INLINE Real gather(const double* const* numbers, Index i) {
        Real found{};
        for (int lane = 0; lane < W; lane++) set_lane(found, lane, numbers[lane][i]);
        return found;
    }
};

// k over mu, and its derivative with respect to d.
template <class Real>
struct Modulus {
    Real value, slope;
};

inline Modulus<double> evaluate_table(const double* table, double d) {
    double place = d / TABLE_PIECE;
    int piece = place < TABLE_PIECES - 1 ? int(place > 0.0 ? place : 0.0) : TABLE_PIECES - 1;
    const double* c = table + 2 + piece * TABLE_TERMS;
    double z = 2.0 * (place - piece) - 1.0;
    double value = 0.0, value_before = 0.0, slope = 0.0, slope_before = 0.0;
    for (int j = TABLE_TERMS - 1; j > 0; j--) {  // Clenshaw's recurrence, and its derivative
        double next_slope = 2.0 * (value + z * slope) - slope_before;
        double next_value = 2.0 * z * value - value_before + c[j];
        slope_before = slope, slope = next_slope;
        value_before = value, value = next_value;
    }
    return {z * value - value_before + c[0], (value + z * slope - slope_before) * (2.0 / TABLE_PIECE)};
}
template <class Real>
inline Modulus<Real> evaluate_tables(const double* const* tables, const Real& d) {
    Modulus<Real> found{};
    for (int lane = 0; lane < Traits<Real>::lanes; lane++) {
        Modulus<double> one = evaluate_table(tables[lane], get_lane(d, lane));
        set_lane(found.value, lane, one.value), set_lane(found.slope, lane, one.slope);
    }
    return found;
}

// k = sum c lambda^q with lambda = 1 - d, or the table.
template <class Real>
inline Modulus<Real> evaluate_law(const Law<Real>& law, const Real& d) {
    if (law.terms == 0) return evaluate_tables(law.numbers, d);
    Real logarithm = logarithm_of_1_minus(d), stretch = 1.0 - d;
    Modulus<Real> found{};
    for (int p = 0; p < law.terms; p++) {
        Real q = law.gather(law.terms + p), part = law.gather(p) * exponential<Real>(q * logarithm);
        found.value += part, found.slope -= part * q / stretch;
    }
    return found;
}

// The derivative of k over mu with respect to a shape parameter, by which c and q, or the table, change as `by`.
template <class Real>
inline Real evaluate_by_shape(const Law<Real>& law, const double* const* by, const Real& d) {
    if (law.terms == 0) return evaluate_tables(by, d).value;
    Real logarithm = logarithm_of_1_minus(d), found{};
    for (int p = 0; p < law.terms; p++) {
        Real c = law.gather(p), q = law.gather(law.terms + p);
        Real c_by = Law<Real>::gather(by, p), q_by = Law<Real>::gather(by, law.terms + p);
        found += (c_by + c * q_by * logarithm) * exponential<Real>(q * logarithm);
    }
    return found;
}

// Fill `series` with the polynomial in |e| through `value` at Chebyshev's points `at`; `value` is overwritten.
template <class Real>
inline void interpolate(Real* series, const Real* at, Real* value) {
    for (int j = 1; j < SERIES_TERMS; j++)  // Newton's divided differences
        for (int i = SERIES_TERMS - 1; i >= j; i--) value[i] = (value[i] - value[i - 1]) / (at[i] - at[i - j]);
    for (int i = 0; i < SERIES_TERMS; i++) series[i] = Real{};
    for (int j = SERIES_TERMS - 1; j >= 0; j--) {  // to powers of |e|
        for (int i = SERIES_TERMS - 1; i > 0; i--) series[i] = series[i - 1] - at[j] * series[i];
        series[0] = value[j] - at[j] * series[0];
    }
}

// The polynomial of mu k in |e| on 0 <= |e| <= limit, through its values at Chebyshev's points.
template <class Real>
inline void fit_series(Real* series, const Law<Real>& law, const Real& mu, const Real& thickness, const Real& limit) {
    Real at[SERIES_TERMS], value[SERIES_TERMS];
    for (int j = 0; j < SERIES_TERMS; j++) {
        at[j] = 0.5 * limit * (1.0 - CHEBYSHEV[j]);
        value[j] = mu * evaluate_law<Real>(law, at[j] / thickness).value;
    }
    interpolate(series, at, value);
}

// The polynomial of mu dk/dp, p a shape parameter. It vanishes at e = 0, as k does not depend on p there: so it is
// |e| times a polynomial, of which `series` has the coefficients.
template <class Real>
inline void fit_slope_series(
    Real* series, const Law<Real>& law, const double* const* by, const Real& mu, const Real& thickness, const Real& limit
) {
    Real at[SERIES_TERMS], value[SERIES_TERMS];
    for (int j = 0; j < SERIES_TERMS; j++) {
        at[j] = 0.5 * limit * (1.0 - CHEBYSHEV[j]);
        value[j] = mu * evaluate_by_shape<Real>(law, by, at[j] / thickness) / at[j];
    }
    interpolate(series, at, value);
}

// The d up to which a polynomial fitted on 0 ... d is within SERIES_TOLERANCE of k. Of a table Python has measured it.
template <class Real>
inline Real find_series_range(const Law<Real>& law) {
    if (law.terms == 0) return law.gather(1);
    constexpr double interval = 4.0;  // Chebyshev's points serve four times as far as Taylor's series
    Real left_out{}, value{}, steepest{}, longest = all_lanes<Real>(MAX_SERIES_COMPRESSION);
    for (int p = 0; p < law.terms; p++) {
        Real term = law.gather(p), q = law.gather(law.terms + p);
        value += term;
        for (int j = 0; j < SERIES_TERMS; j++) term *= (j - q) / (j + 1.0);
        left_out += absolute(term);
        steepest = greater_of<Real>(steepest, SERIES_TERMS - q);
    }
    auto end = [&](const Real& reach) { return select<Real>(interval * reach < longest, interval * reach, longest); };
    Real at_rest = exponential<Real>(logarithm<Real>(SERIES_TOLERANCE * value / (2.0 * left_out)) / double(SERIES_TERMS));
    Real reach = at_rest;
    for (int repeat = 0; repeat < 4; repeat++)  // the term left out grows along the interval
        reach = at_rest * exponential<Real>(logarithm_of_1_minus<Real>(end(reach)) * steepest / double(SERIES_TERMS));
    return select<Real>(left_out == 0.0, longest, end(reach));  // a series that ends is exact
}

// The same for a table that has no range yet, found by trial: what Python stores as its second number.
inline double measure_table_range(const double* table) {
    Law<double> law{{table}, 0};
    double series[SERIES_TERMS], end = table[0] < MAX_SERIES_COMPRESSION ? table[0] : MAX_SERIES_COMPRESSION;
    for (int repeat = 0; repeat < 32; repeat++) {
        fit_series<double>(series, law, 1.0, 1.0, end);
        double error = 0.0;
        for (int j = 0; j <= SERIES_TERMS; j++) {
            double d = 0.5 * end * (1.0 - BETWEEN[j]), found = 0.0;
            for (int m = SERIES_TERMS - 1; m >= 0; m--) found = found * d + series[m];
            double k = evaluate_table(table, d).value;
            error = greater_of(error, absolute(found - k) / k);
        }
        if (error <= SERIES_TOLERANCE) break;
        end *= 0.98 * exponential(logarithm(SERIES_TOLERANCE / error) / SERIES_TERMS);
    }
    return end;
}

}  // namespace needlefit
