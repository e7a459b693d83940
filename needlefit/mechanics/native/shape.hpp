// The points of a bent needle (docs/model.md, section 5): u' is the rotation of its section, so they are the integrals
// of cos u' and sin u' from the base.
#pragma once

#include "functions.hpp"
#include "grid.hpp"
#include "real.hpp"

namespace needlefit {

// cos u' and sin u' of a cubic are no polynomials: three Gauss points on the short elements in the tissue, and five on
// the free spans before it. Points and weights on 0 ... 1.
constexpr double MAX_SHORT_ELEMENT_MM = 2.0;
struct GaussRule {
    int count;
    double at[5], weight[5];
};
constexpr GaussRule SHORT_RULE{3, {0.1127016653792583, 0.5, 0.8872983346207417}, {5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0}};
constexpr GaussRule LONG_RULE{
    5,
    {0.04691007703066800, 0.2307653449471585, 0.5, 0.7692346550528415, 0.9530899229693320},
    {0.1184634425280945, 0.2393143352496832, 64.0 / 225.0, 0.2393143352496832, 0.1184634425280945}
};
INLINE const GaussRule& choose_rule(double length) {
    return length <= MAX_SHORT_ELEMENT_MM ? SHORT_RULE : LONG_RULE;
}

// The element of `count` nodes x that contains a beam coordinate; outside, the nearest one.
INLINE Index find_element(const double* x, Index count, double s) {
    Index e = count_below(x, count, s) - 1;
    return e < 0 ? 0 : e > count - 2 ? count - 2 : e;
}

// Deflection, slope and place of a node, and how the slope goes on over the element behind it: u' = slope + t (bend + t
// curl) with t from 0 to 1.
template <class Vector>
struct ShapeNode {
    Vector u, slope;
    Scalar<Vector> ahead;
    Vector aside, bend, curl;
};

// The direction of the needle where its section is rotated so: cos th along x and, across it, `rotation` sin th / th with
// th its length, which is the sine in the plane.
template <class Vector>
INLINE void find_direction(const Vector& rotation, Scalar<Vector>& along, Vector& across) {
    using Real = Scalar<Vector>;
    if constexpr (Traits<Vector>::planes == 2) {
        Real angle = length_of(rotation), sine;
        sine_cosine<Real>(angle, sine, along);
        Real one = all_lanes<Real>(1.0);
        across = rotation * select<Real>(angle > 0.0, sine / select<Real>(angle > 0.0, angle, one), one);
    } else {
        sine_cosine<Real>(rotation, across, along);
    }
}

// How that direction, times `weight`, changes with the rotation.
template <class Real>
INLINE void differentiate_direction(const Real& rotation, double weight, Real& along, Real& across) {
    Real sine, cosine;
    sine_cosine<Real>(rotation, sine, cosine);
    along = -weight * sine, across = weight * cosine;
}
template <class Real>
INLINE void differentiate_direction(
    const Pair<Real>& rotation, double weight, Pair<Real>& along, SymmetricMatrix<Real>& across
) {
    Real angle = length_of(rotation), one = all_lanes<Real>(1.0), sine, cosine;
    sine_cosine<Real>(angle, sine, cosine);
    Mask<Real> bent = angle > 0.0;
    Real safe = select<Real>(bent, angle, one), ratio = select<Real>(bent, sine / safe, one);
    Pair<Real> axis = rotation / safe;
    Real more = weight * (cosine - ratio), same = weight * ratio;
    along = -(same * rotation);
    across = {same + more * (axis.y * axis.y), more * (axis.y * axis.z), same + more * (axis.z * axis.z)};
}

// Add the integrals of the direction over the first `upto` mm of an element.
template <class Vector>
INLINE void integrate_direction(
    const ShapeNode<Vector>& node, double length, double upto, Scalar<Vector>& ahead, Vector& aside
) {
    const GaussRule& rule = choose_rule(length);
    Scalar<Vector> along{};
    Vector across{};
    for (int i = 0; i < rule.count; i++) {
        double t = rule.at[i] * (upto / length);
        Scalar<Vector> cosine;
        Vector sine;
        find_direction(node.slope + t * (node.bend + t * node.curl), cosine, sine);
        along += rule.weight[i] * cosine, across += rule.weight[i] * sine;
    }
    ahead = node.ahead + along * upto, aside = node.aside + across * upto;
}

// Values (P, needles of all calls, count) of each lane's needle from the one at `values` on; the last needle stands in for
// lanes to spare. `all` is the number of values in each plane.
template <class Vector>
INLINE Vector gather_lanes(const double* values, Index needles, Index count, Index all, Index i) {
    Vector found{};
    for (int plane = 0; plane < Traits<Vector>::planes; plane++)
        for (int lane = 0; lane < Traits<Vector>::lanes; lane++)
            set_lane(part(found, plane), lane, values[plane * all + (lane < needles ? lane : needles - 1) * count + i]);
    return found;
}

// The points (K, 1 + P) of each lane's needle, whose nodes x are alike, at beam coordinates s. `u` and `slope` are those
// of `all` needles, (P, all, N), from the first lane's on; `room` is for N nodes.
template <class Vector>
void compute_positions(
    Index needles, Index all, Index count, Index wanted, const double* x, const double* u, const double* slope,
    const double* s, ShapeNode<Vector>* room, double* out
) {
    using Real = Scalar<Vector>;
    constexpr int P = Traits<Vector>::planes;
    auto gather = [&](const double* values, Index i) {
        return gather_lanes<Vector>(values, needles, count, all * count, i);
    };
    for (Index i = 0; i < count; i++) room[i].u = gather(u, i), room[i].slope = gather(slope, i);
    room[0].ahead = all_lanes<Real>(x[0]), room[0].aside = room[0].u;
    for (Index e = 0; e < count - 1; e++) {
        ShapeNode<Vector>&a = room[e], &b = room[e + 1];
        double length = x[e + 1] - x[e];
        Vector rise = (b.u - a.u) / length;
        a.bend = 6.0 * rise - 4.0 * a.slope - 2.0 * b.slope, a.curl = 3.0 * (a.slope + b.slope) - 6.0 * rise;
        integrate_direction(a, length, length, b.ahead, b.aside);
    }
    for (Index k = 0; k < wanted; k++) {
        Index e = find_element(x, count, s[k]);
        Real ahead;
        Vector aside;
        integrate_direction(room[e], x[e + 1] - x[e], s[k] - x[e], ahead, aside);
        for (int lane = 0; lane < Traits<Real>::lanes && lane < needles; lane++) {
            double* point = out + (1 + P) * (lane * wanted + k);
            point[0] = get_lane(ahead, lane);
            for (int plane = 0; plane < P; plane++) point[1 + plane] = get_lane(part(aside, plane), lane);
        }
    }
}

// Add to `into` (1 + P, columns) the derivatives of the integrals over the first `upto` mm of element e, from those of its
// ends, `by` (2, columns) each. Where nodes move along the needle, what the ends of an element gain its neighbours lose.
template <class Vector>
INLINE void add_position_derivatives(
    Scalar<Vector>* into, Index e, double upto, Index columns, const double* x, const double* x_by,
    const ShapeNode<Vector>* nodes, const Vector* by
) {
    using Real = Scalar<Vector>;
    double length = x[e + 1] - x[e];
    const GaussRule& rule = choose_rule(length);
    const ShapeNode<Vector>&a = nodes[e], &b = nodes[e + 1];
    const double *xa = x_by + e * columns, *xb = xa + columns;
    const Vector *ua = by + 2 * e * columns, *sa = ua + columns, *ub = sa + columns, *sb = ub + columns;
    for (int i = 0; i < rule.count; i++) {
        double at = rule.at[i] * upto;
        Hermite<double> shape(at, length);
        const double* m = shape.m;
        Vector ahead;
        Matrix<Vector> aside;
        Vector rotation = m[0] * a.u + m[1] * a.slope + m[2] * b.u + m[3] * b.slope;
        differentiate_direction(rotation, rule.weight[i] * upto, ahead, aside);
        for (Index p = 0; p < columns; p++) {
            Vector turn = m[0] * ua[p] + m[1] * sa[p] + m[2] * ub[p] + m[3] * sb[p];
            if (xa[p] != 0.0 || xb[p] != 0.0) {
                Hermite<double> by_x = Hermite<double>::change(at, length, -xa[p], xb[p] - xa[p]);
                turn += by_x.m[0] * a.u + by_x.m[1] * a.slope + by_x.m[2] * b.u + by_x.m[3] * b.slope;
            }
            Vector across = aside * turn;
            into[p] += dot(ahead, turn);
            for (int plane = 0; plane < Traits<Vector>::planes; plane++)
                into[(1 + plane) * columns + p] += part(across, plane);
        }
    }
}

// The derivatives (K, 1 + P, columns) of the points of each lane's needle, whose nodes x and `x_by` (N, columns) are
// alike, from those of its nodes, (P, all, N, columns). `room` has (1 + 5 P) N + ((1 + 3 P) N + 1 + P) columns numbers.
template <class Vector>
void compute_position_derivatives(
    Index needles, Index all, Index count, Index wanted, Index columns, const double* x, const double* u,
    const double* slope, const double* s, const double* x_by, const double* u_by, const double* slope_by, char* room,
    double* out
) {
    using Real = Scalar<Vector>;
    constexpr Index P = Traits<Vector>::planes, size = 1 + P;
    auto gather = [&](const double* values, Index of_needle, Index i) {
        return gather_lanes<Vector>(values, needles, of_needle, all * of_needle, i);
    };
    ShapeNode<Vector>* nodes = reinterpret_cast<ShapeNode<Vector>*>(room);
    Vector* by = reinterpret_cast<Vector*>(nodes + count);
    Real *reached = reinterpret_cast<Real*>(by + 2 * count * columns), *found = reached + size * count * columns;
    for (Index i = 0; i < count; i++) {
        nodes[i].u = gather(u, count, i), nodes[i].slope = gather(slope, count, i);
        for (Index p = 0; p < columns; p++) {
            by[2 * i * columns + p] = gather(u_by, count * columns, i * columns + p);
            by[(2 * i + 1) * columns + p] = gather(slope_by, count * columns, i * columns + p);
        }
    }
    auto integrate = [&](Real* into, Index e, double upto) {
        const Real* from = reached + size * e * columns;
        for (Index p = 0; p < size * columns; p++) into[p] = from[p];
        add_position_derivatives(into, e, upto, columns, x, x_by, nodes, by);
    };
    for (Index p = 0; p < columns; p++) {
        reached[p] = Real{};
        for (int plane = 0; plane < P; plane++) reached[(1 + plane) * columns + p] = part(by[p], plane);
    }
    for (Index e = 0; e < count - 1; e++) integrate(reached + size * (e + 1) * columns, e, x[e + 1] - x[e]);
    for (Index k = 0; k < wanted; k++) {
        Index e = find_element(x, count, s[k]);
        integrate(found, e, s[k] - x[e]);
        for (int lane = 0; lane < Traits<Real>::lanes && lane < needles; lane++)
            for (Index p = 0; p < size * columns; p++)
                out[size * columns * (lane * wanted + k) + p] = get_lane(found[p], lane);
    }
}

}  // namespace needlefit
