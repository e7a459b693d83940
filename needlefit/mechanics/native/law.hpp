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

// A law in numbers. Powers (terms > 0): coefficients c_p, then exponents q_p. A table (terms = 0): the greatest d
// that it covers, that up to which a polynomial serves, and its coefficients, piece by piece.
struct Law {
    const double* numbers;
    int terms;
};

// k over mu, and its derivative with respect to d.
struct Modulus {
    double value, slope;
};

INLINE Modulus evaluate_table(const double* table, double d) {
    double place = d / TABLE_PIECE;
    int piece = place < TABLE_PIECES - 1 ? int(place) : TABLE_PIECES - 1;
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

// k = sum c lambda^q with lambda = 1 - d, or the table.
INLINE Modulus evaluate_law(const Law& law, double d) {
    if (law.terms == 0) return evaluate_table(law.numbers, d);
    const double *c = law.numbers, *q = c + law.terms;
    double logarithm = logarithm_of_1_minus(d), k = 0.0, slope = 0.0;
    for (int p = 0; p < law.terms; p++) {
        double part = c[p] * exponential(q[p] * logarithm);
        k += part;
        slope -= part * q[p] / (1.0 - d);
    }
    return {k, slope};
}

// The derivative of k over mu with respect to a shape parameter, by which c and q, or the table, change as `by`.
INLINE double evaluate_by_shape(const Law& law, const double* by, double d) {
    if (law.terms == 0) return evaluate_table(by, d).value;
    const double *c = law.numbers, *q = c + law.terms;
    double logarithm = logarithm_of_1_minus(d), found = 0.0;
    for (int p = 0; p < law.terms; p++)
        found += (by[p] + c[p] * by[law.terms + p] * logarithm) * exponential(q[p] * logarithm);
    return found;
}

// Fill `series` with the polynomial in |e| through `value` at Chebyshev's points `at`; `value` is overwritten.
inline void interpolate(double* series, const double* at, double* value) {
    for (int j = 1; j < SERIES_TERMS; j++)  // Newton's divided differences
        for (int i = SERIES_TERMS - 1; i >= j; i--) value[i] = (value[i] - value[i - 1]) / (at[i] - at[i - j]);
    for (int i = 0; i < SERIES_TERMS; i++) series[i] = 0.0;
    for (int j = SERIES_TERMS - 1; j >= 0; j--) {  // to powers of |e|
        for (int i = SERIES_TERMS - 1; i > 0; i--) series[i] = series[i - 1] - at[j] * series[i];
        series[0] = value[j] - at[j] * series[0];
    }
}

// The polynomial of mu k in |e| on 0 <= |e| <= limit, through its values at Chebyshev's points.
inline void fit_series(double* series, const Law& law, double mu, double thickness, double limit) {
    double at[SERIES_TERMS], value[SERIES_TERMS];
    for (int j = 0; j < SERIES_TERMS; j++) {
        at[j] = 0.5 * limit * (1.0 - CHEBYSHEV[j]);
        value[j] = mu * evaluate_law(law, at[j] / thickness).value;
    }
    interpolate(series, at, value);
}

// The polynomial of mu dk/dp, p a shape parameter. It vanishes at e = 0, as k does not depend on p there: so it is
// |e| times a polynomial, of which `series` has the coefficients.
inline void fit_slope_series(
    double* series, const Law& law, const double* by, double mu, double thickness, double limit
) {
    double at[SERIES_TERMS], value[SERIES_TERMS];
    for (int j = 0; j < SERIES_TERMS; j++) {
        at[j] = 0.5 * limit * (1.0 - CHEBYSHEV[j]);
        value[j] = mu * evaluate_by_shape(law, by, at[j] / thickness) / at[j];
    }
    interpolate(series, at, value);
}

// The d up to which a polynomial fitted on 0 ... d is within SERIES_TOLERANCE of k. Of a table Python has measured it.
inline double find_series_range(const Law& law) {
    if (law.terms == 0) return law.numbers[1];
    constexpr double interval = 4.0;  // Chebyshev's points serve four times as far as Taylor's series
    double left_out = 0.0, value = 0.0, steepest = 0.0;
    for (int p = 0; p < law.terms; p++) {
        double term = law.numbers[p], q = law.numbers[law.terms + p];
        value += term;
        for (int j = 0; j < SERIES_TERMS; j++) term *= (j - q) / (j + 1);
        left_out += absolute(term);
        steepest = greater_of(steepest, SERIES_TERMS - q);
    }
    if (left_out == 0.0) return MAX_SERIES_COMPRESSION;  // the series ends: the polynomial is exact
    double at_rest = exponential(logarithm(SERIES_TOLERANCE * value / (2.0 * left_out)) / SERIES_TERMS);
    double reach = at_rest;
    for (int repeat = 0; repeat < 8; repeat++) {  // the term left out grows along the interval
        double end = interval * reach < MAX_SERIES_COMPRESSION ? interval * reach : MAX_SERIES_COMPRESSION;
        reach = at_rest * exponential(logarithm_of_1_minus(end) * steepest / SERIES_TERMS);
    }
    return interval * reach < MAX_SERIES_COMPRESSION ? interval * reach : MAX_SERIES_COMPRESSION;
}

// The same for a table that has no range yet, found by trial: what Python stores as its second number.
inline double measure_table_range(const double* table) {
    Law law{table, 0};
    double series[SERIES_TERMS], end = MAX_SERIES_COMPRESSION;
    for (int repeat = 0; repeat < 32; repeat++) {
        fit_series(series, law, 1.0, 1.0, end);
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
