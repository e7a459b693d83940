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
    Law<Real> law;

    void prepare() {  // the polynomial, from law, mu and thickness
        limit = find_series_range(law) * thickness;
        fit_series(series, law, mu, thickness, limit);
        // Half the second derivative of k e over its first, as far as the polynomial goes; doubled, for the lever of
        // a needle that reaches beyond its stiffest layer.
        Real bend{}, tangent{}, step = all_lanes<Real>(1.0);
        for (int j = 0; j < SERIES_TERMS; j++) {
            tangent += (j + 1.0) * series[j] * step;
            if (j > 0) bend += 0.5 * j * (j + 1) * absolute(series[j]) * step / limit;
            step *= limit;
        }
        // The least tangent is at an end of the interval. One that is not positive makes the curvature infinite, and
        // every step is then iterated to the tolerance.
        Real least = select<Real>(tangent > 0.0, tangent, Real{});
        curvature = 2.0 * bend / select<Real>(series[0] < least, series[0], least);
    }

    // Become in one lane as another layer is there.
    void take_lane(int lane, const Layer& other) {
        auto take = [&](Real& to, const Real& from) { set_lane(to, lane, get_lane(from, lane)); };
        for (int j = 0; j < SERIES_TERMS; j++) take(series[j], other.series[j]);
        take(limit, other.limit), take(curvature, other.curvature), take(mu, other.mu);
        take(thickness, other.thickness), take(friction, other.friction);
        law.numbers[lane] = other.law.numbers[lane], law.terms = other.law.terms;
    }
};

// What the passes learn on the way: lanes in which tissue is crushed (|e| beyond the thickness or the law's table),
// and lanes in which the exact law was evaluated.
template <class Real>
struct Seen {
    Mask<Real> crushed{}, exact{};
    Real skew{};  // of a needle in space: a bound of the share by which tangents differ from those that are used
};

constexpr double MAX_FACTORED_COMPRESSION = 0.5;  // where tissue is crushed, it resists as at this d, linearly

// k and d(k e)/de from the law itself, for lanes beyond its polynomial.
template <class Real>
__attribute__((noinline)) Modulus<Real> evaluate_exactly(const Layer<Real>& layer, const Real& size, Seen<Real>& seen) {
    Mask<Real> beyond = size > layer.limit;
    const Law<Real>& law = layer.law;
    Real d = size / layer.thickness, end = law.terms > 0 ? all_lanes<Real>(1.0) : law.gather(0);
    Mask<Real> over = law.terms > 0 ? d >= end : d > end;
    Real most = select<Real>(end < MAX_FACTORED_COMPRESSION, end, all_lanes<Real>(MAX_FACTORED_COMPRESSION));
    d = select<Real>(over, most, d);
    Modulus<Real> found = evaluate_law(law, d);
    seen.crushed = seen.crushed | (beyond & over);
    seen.exact = seen.exact | beyond;
    Real risen = select<Real>(over, found.value, found.value + d * found.slope);
    return {layer.mu * found.value, layer.mu * risen};
}

// What lies beyond the polynomial, from the exact law.
template <class Real>
INLINE Modulus<Real> finish_modulus(const Layer<Real>& layer, const Real& size, Modulus<Real> found, Seen<Real>& seen) {
    Mask<Real> beyond = size > layer.limit;
    if (__builtin_expect(any(beyond), 0)) {
        Modulus<Real> exact = evaluate_exactly(layer, size, seen);
        found.value = select<Real>(beyond, exact.value, found.value);
        found.slope = select<Real>(beyond, exact.slope, found.slope);
    }
    return found;
}

// k at |e| = size, and d(k e)/de.
template <class Real>
INLINE Modulus<Real> evaluate_modulus(const Layer<Real>& layer, const Real& size, Seen<Real>& seen) {
    const Real* c = layer.series;
    Real slope = c[5], k = c[5] * size + c[4];
    for (int j = 3; j >= 0; j--) slope = slope * size + k, k = k * size + c[j];  // Horner's scheme, for both
    return finish_modulus(layer, size, {k, k + size * slope}, seen);
}

// The same where the square of |e| is known before its root: even and odd powers apart, of which neither waits for it.
template <class Real>
INLINE Modulus<Real> evaluate_modulus(const Layer<Real>& layer, const Real& size, const Real& square, Seen<Real>& seen) {
    const Real* c = layer.series;
    Real odd = c[5] * square, even = c[4] * square;
    Real odd_slope = 4.0 * odd + 2.0 * c[3], even_slope = 4.0 * even + 2.0 * c[2];
    odd = (odd + c[3]) * square + c[1], even = (even + c[2]) * square + c[0];
    Real k = even + size * odd;
    return finish_modulus(layer, size, {k, k + (square * even_slope + size * (square * odd_slope + odd))}, seen);
}

// dk/dp at |e| = size for a shape parameter p: from the polynomial, beyond its range from the exact law.
template <class Real>
INLINE Real evaluate_by_shape(const Layer<Real>& layer, const Real* series, const double* const* by, const Real& size) {
    Real found = series[SERIES_TERMS - 1];
    for (int j = SERIES_TERMS - 2; j >= 0; j--) found = found * size + series[j];
    found = found * size;
    Mask<Real> beyond = size > layer.limit;
    if (__builtin_expect(any(beyond), 0)) {
        Real exact = layer.mu * evaluate_by_shape<Real>(layer.law, by, size / layer.thickness);
        found = select<Real>(beyond, exact, found);
    }
    return found;
}

// ---- the force ------------------------------------------------------------------------------------------------------

// sin^2(atan u').
template <class Vector>
INLINE Scalar<Vector> rise(const Vector& slope) {
    return dot(slope, slope) / (1.0 + dot(slope, slope));
}

// k e g, N/mm, and its derivatives by e and by u'.
template <class Real>
struct Force {
    Real value, by_e, by_slope;
};

// The same in space. By e the force has the derivative g d(k e)/de along e, and g k across it. The mean of the two is
// that along any direction, to within a small share: so one matrix serves both planes.
template <class Real>
struct Force<Pair<Real>> {
    Pair<Real> value;
    Real by_e, along, across;
    Pair<Real> direction;  // of e
    Pair<Real> friction;   // dg / du', along both slopes; to be multiplied by k e, which is `plain`
    Pair<Real> plain;
};

// The force at a point of the shaft; without friction `slope` is null.
template <class Real>
INLINE Force<Real> find_force(const Layer<Real>& layer, const Real& e, const Real* slope, Seen<Real>& seen) {
    Modulus<Real> k = evaluate_modulus(layer, absolute(e), seen);
    Force<Real> found{k.value * e, k.slope, Real{}};
    if (slope) {
        Real g = 1.0 - layer.friction * rise(*slope), more = 1.0 + *slope * *slope;
        found.by_slope = found.value * (-2.0 * layer.friction * *slope / (more * more));
        found.value = found.value * g, found.by_e = found.by_e * g;
    }
    return found;
}
template <class Real>
INLINE Force<Pair<Real>> find_force(
    const Layer<Real>& layer, const Pair<Real>& e, const Pair<Real>* slope, Seen<Real>& seen
) {
    Real square = dot(e, e), size = square_root(square);
    Modulus<Real> k = evaluate_modulus(layer, size, square, seen);
    Force<Pair<Real>> found{k.value * e, 0.5 * (k.value + k.slope), k.slope, k.value, e, {}, k.value * e};
    // k' |e| is at most half of |e| times the second derivative of k e.
    seen.skew = greater_of(0.25 * layer.curvature * size, seen.skew);
    found.direction = e / select<Real>(size > 0.0, size, all_lanes<Real>(1.0));
    if (slope) {
        Real g = 1.0 - layer.friction * rise(*slope), more = 1.0 + dot(*slope, *slope);
        found.friction = *slope * (-2.0 * layer.friction / (more * more));
        found.value = found.value * g, found.by_e = found.by_e * g;
        found.along = found.along * g, found.across = found.across * g;
    }
    return found;
}

// The force, and its derivative by whatever changes e and u' so.
template <class Vector>
INLINE Vector differentiate_force(
    const Layer<Scalar<Vector>>& layer, const Vector& e, const Vector& slope, const Vector& e_by, const Vector& slope_by,
    Vector& force
) {
    Seen<Scalar<Vector>> ignored;
    Force<Vector> at = find_force(layer, e, &slope, ignored);
    force = at.value;
    if constexpr (Traits<Vector>::planes == 2) {
        Vector along = at.direction * ((at.along - at.across) * dot(at.direction, e_by));
        return at.across * e_by + along + at.plain * dot(at.friction, slope_by);
    } else {
        return at.by_e * e_by + at.by_slope * slope_by;
    }
}
// Its derivative by mu is the force over mu. By gamma and by a shape parameter, whose polynomial is `series`:
template <class Vector>
INLINE Vector find_force_by_friction(const Layer<Scalar<Vector>>& layer, const Vector& force, const Vector& slope) {
    return -force * rise(slope) / (1.0 - layer.friction * rise(slope));
}
template <class Vector>
INLINE Vector find_force_by_shape(
    const Layer<Scalar<Vector>>& layer, const Scalar<Vector>* series, const double* const* by, const Vector& e,
    const Vector* slope
) {
    Vector found = evaluate_by_shape(layer, series, by, length_of(e)) * e;
    return slope ? found * (1.0 - layer.friction * rise(*slope)) : found;
}

}  // namespace needlefit
