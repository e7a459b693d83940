// The tissue's reaction at a point of the shaft (docs/model.md, section 3): per length
//
//     k(|e|) e g,    e = u - c,    g = 1 - gamma sin^2(atan u')
//
// with its derivatives by e, by u' and by the parameters. All solvers, loads and derivatives call what stands here.
#pragma once

#include "law.hpp"

namespace needlefit {

// One layer in all lanes.
template <class Real>
struct Layer {
    Real series[SERIES_TERMS];  // of k in |e|, N / mm^2 / mm^j
    Real limit;                 // the |e| up to which that holds, mm
    Real curvature;             // a Newton step leaves at most about this times its increment squared, 1 / mm
    Real mu;                    // MPa
    Real thickness;             // mm
    Real friction;              // gamma
    Law law[Traits<Real>::lanes];

    void set(int lane, const Law& exact, double mu_value, double thickness_value, double gamma) {
        double reach = find_series_range(exact) * thickness_value, terms[SERIES_TERMS];
        fit_series(terms, exact, mu_value, thickness_value, reach);
        // Half the second derivative of k e over its first, as far as the polynomial goes; doubled, for the lever of
        // a needle that reaches beyond its stiffest layer.
        double bend = 0.0, tangent = 0.0, step = 1.0;
        for (int j = 0; j < SERIES_TERMS; j++) {
            tangent += (j + 1) * terms[j] * step;
            if (j > 0) bend += 0.5 * j * (j + 1) * absolute(terms[j]) * step / reach;
            step *= reach;
            set_lane(series[j], lane, terms[j]);
        }
        // The least tangent is at an end of the interval. One that is not positive makes the curvature infinite, and
        // every step is then iterated to the tolerance.
        double least = tangent > 0.0 ? tangent : 0.0;
        set_lane(curvature, lane, 2.0 * bend / (terms[0] < least ? terms[0] : least));
        set_lane(limit, lane, reach), set_lane(mu, lane, mu_value);
        set_lane(thickness, lane, thickness_value), set_lane(friction, lane, gamma);
        law[lane] = exact;
    }
};

// The reaction at a quadrature point: e, and with the point's weight d(k e g)/de and k e g.
template <class Real>
struct Reaction {
    Real e, pull, force;
};

// What the passes learn on the way: lanes in which tissue is crushed (|e| beyond the thickness or the law's table),
// and lanes in which the exact law was evaluated.
template <class Real>
struct Seen {
    Mask<Real> crushed{}, exact{};
};

constexpr double MAX_FACTORED_COMPRESSION = 0.5;  // where tissue is crushed, it resists as at this d, linearly

// k and d(k e)/de of the lanes beyond their polynomial.
template <class Real>
__attribute__((noinline)) void evaluate_exactly(
    const Layer<Real>& layer, const Real& size, Real& k, Real& tangent, Seen<Real>& seen
) {
    Mask<Real> beyond = size > layer.limit, crushed{};
    for (int lane = 0; lane < Traits<Real>::lanes; lane++) {
        if (!get_lane(beyond, lane)) continue;
        const Law& law = layer.law[lane];
        double d = get_lane(size, lane) / get_lane(layer.thickness, lane), mu = get_lane(layer.mu, lane);
        double end = law.terms > 0 ? 1.0 : law.numbers[0];
        bool over = law.terms > 0 ? d >= end : d > end;
        if (over) d = end < MAX_FACTORED_COMPRESSION ? end : MAX_FACTORED_COMPRESSION;
        Modulus found = evaluate_law(law, d);
        set_lane(k, lane, mu * found.value);
        set_lane(tangent, lane, mu * (over ? found.value : found.value + d * found.slope));
        if constexpr (Traits<Real>::lanes == 1)
            crushed = over;
        else
            crushed[lane] = over ? -1 : 0;
    }
    seen.crushed = seen.crushed | crushed;
    seen.exact = seen.exact | beyond;
}

// k at |e| = size, and d(k e)/de.
template <class Real>
INLINE void evaluate_modulus(const Layer<Real>& layer, const Real& size, Real& k, Real& tangent, Seen<Real>& seen) {
    const Real* c = layer.series;
    Real slope = c[5];
    k = c[5] * size + c[4];
    for (int j = 3; j >= 0; j--) slope = slope * size + k, k = k * size + c[j];  // Horner's scheme, for both
    tangent = k + size * slope;
    if (__builtin_expect(any(size > layer.limit), 0)) evaluate_exactly(layer, size, k, tangent, seen);
}

// k at |e| = size alone.
template <class Real>
INLINE Real evaluate_modulus(const Layer<Real>& layer, const Real& size, Seen<Real>& seen) {
    const Real* c = layer.series;
    Real k = c[5];
    for (int j = 4; j >= 0; j--) k = k * size + c[j];
    Real tangent;
    if (__builtin_expect(any(size > layer.limit), 0)) evaluate_exactly(layer, size, k, tangent, seen);
    return k;
}

// dk/dp at |e| = size for a shape parameter p: from the polynomial, beyond its range from the exact law.
template <class Real>
INLINE Real evaluate_by_shape(const Layer<Real>& layer, const Real* series, const double* const* by, const Real& size) {
    Real found = series[SERIES_TERMS - 1];
    for (int j = SERIES_TERMS - 2; j >= 0; j--) found = found * size + series[j];
    found = found * size;
    Mask<Real> beyond = size > layer.limit;
    if (__builtin_expect(any(beyond), 0))
        for (int lane = 0; lane < Traits<Real>::lanes; lane++)
            if (get_lane(beyond, lane)) {
                double d = get_lane(size, lane) / get_lane(layer.thickness, lane);
                set_lane(found, lane, get_lane(layer.mu, lane) * evaluate_by_shape(layer.law[lane], by[lane], d));
            }
    return found;
}

// g and dg/du'.
template <class Real>
INLINE void evaluate_friction(const Real& gamma, const Real& slope, Real& g, Real& g_slope) {
    Real square = slope * slope;
    g = 1.0 - gamma * square / (1.0 + square);
    g_slope = -2.0 * gamma * slope / ((1.0 + square) * (1.0 + square));
}

}  // namespace needlefit
