// The points of a bent needle (docs/model.md, section 5): u' is the rotation of its section, so they are the integrals
// of cos u' and sin u' from the base.
#pragma once

#include "functions.hpp"
#include "grid.hpp"

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
template <class Real>
struct ShapeNode {
    Real u, slope, ahead, aside, bend, curl;
};

// Add the integrals of cos u' and sin u' over the first `upto` mm of an element.
template <class Real>
INLINE void integrate_direction(const ShapeNode<Real>& node, double length, double upto, Real& ahead, Real& aside) {
    const GaussRule& rule = choose_rule(length);
    Real along{}, across{};
    for (int i = 0; i < rule.count; i++) {
        double t = rule.at[i] * (upto / length);
        Real sine, cosine;
        sine_cosine<Real>(node.slope + t * (node.bend + t * node.curl), sine, cosine);
        along += rule.weight[i] * cosine, across += rule.weight[i] * sine;
    }
    ahead = node.ahead + along * upto, aside = node.aside + across * upto;
}

// The points (K, 2) of each lane's needle, whose nodes x are alike, at beam coordinates s. `u` and `slope` are (W, N),
// the last needle standing in for lanes to spare; `room` is for N nodes.
template <class Real>
void compute_positions(
    Index needles, Index count, Index wanted, const double* x, const double* u, const double* slope, const double* s,
    ShapeNode<Real>* room, double* out
) {
    auto gather = [&](const double* values, Index i) {
        Real found{};
        for (int lane = 0; lane < Traits<Real>::lanes; lane++)
            set_lane(found, lane, values[(lane < needles ? lane : needles - 1) * count + i]);
        return found;
    };
    for (Index i = 0; i < count; i++) room[i].u = gather(u, i), room[i].slope = gather(slope, i);
    room[0].ahead = all_lanes<Real>(x[0]), room[0].aside = room[0].u;
    for (Index e = 0; e < count - 1; e++) {
        ShapeNode<Real>&a = room[e], &b = room[e + 1];
        double length = x[e + 1] - x[e];
        Real rise = (b.u - a.u) / length;
        a.bend = 6.0 * rise - 4.0 * a.slope - 2.0 * b.slope, a.curl = 3.0 * (a.slope + b.slope) - 6.0 * rise;
        integrate_direction(a, length, length, b.ahead, b.aside);
    }
    for (Index k = 0; k < wanted; k++) {
        Index e = find_element(x, count, s[k]);
        Real ahead, aside;
        integrate_direction(room[e], x[e + 1] - x[e], s[k] - x[e], ahead, aside);
        for (int lane = 0; lane < Traits<Real>::lanes && lane < needles; lane++) {
            out[2 * (lane * wanted + k)] = get_lane(ahead, lane);
            out[2 * (lane * wanted + k) + 1] = get_lane(aside, lane);
        }
    }
}

// Add to `into` (2, P) the derivatives of the integrals over the first `upto` mm of element e, from those of its ends,
// `by` (2, P) each. Where nodes move along the needle, what the ends of an element gain its neighbours lose.
template <class Real>
INLINE void add_position_derivatives(
    Real* into, Index e, double upto, Index columns, const double* x, const double* x_by, const ShapeNode<Real>* nodes,
    const Real* by
) {
    double length = x[e + 1] - x[e];
    const GaussRule& rule = choose_rule(length);
    const ShapeNode<Real>&a = nodes[e], &b = nodes[e + 1];
    const double *xa = x_by + e * columns, *xb = xa + columns;
    const Real *ua = by + 2 * e * columns, *sa = ua + columns, *ub = sa + columns, *sb = ub + columns;
    for (int i = 0; i < rule.count; i++) {
        double at = rule.at[i] * upto;
        Hermite<double> shape(at, length);
        const double* m = shape.m;
        Real sine, cosine;
        sine_cosine<Real>(m[0] * a.u + m[1] * a.slope + m[2] * b.u + m[3] * b.slope, sine, cosine);
        Real ahead = -rule.weight[i] * upto * sine, aside = rule.weight[i] * upto * cosine;
        for (Index p = 0; p < columns; p++) {
            Real turn = m[0] * ua[p] + m[1] * sa[p] + m[2] * ub[p] + m[3] * sb[p];
            if (xa[p] != 0.0 || xb[p] != 0.0) {
                Hermite<double> by_x = Hermite<double>::change(at, length, -xa[p], xb[p] - xa[p]);
                turn += by_x.m[0] * a.u + by_x.m[1] * a.slope + by_x.m[2] * b.u + by_x.m[3] * b.slope;
            }
            into[p] += ahead * turn, into[columns + p] += aside * turn;
        }
    }
}

// The derivatives (K, 2, P) of the points of each lane's needle, whose nodes x and `x_by` (N, P) are alike, from those
// of its nodes, (W, N, P); `room` has 6 N + (4 N + 2) P numbers.
template <class Real>
void compute_position_derivatives(
    Index needles, Index count, Index wanted, Index columns, const double* x, const double* u, const double* slope,
    const double* s, const double* x_by, const double* u_by, const double* slope_by, char* room, double* out
) {
    auto gather = [&](const double* values, Index size, Index i) {
        Real found{};
        for (int lane = 0; lane < Traits<Real>::lanes; lane++)
            set_lane(found, lane, values[(lane < needles ? lane : needles - 1) * size + i]);
        return found;
    };
    ShapeNode<Real>* nodes = reinterpret_cast<ShapeNode<Real>*>(room);
    Real *by = reinterpret_cast<Real*>(nodes + count), *reached = by + 2 * count * columns;
    Real* found = reached + 2 * count * columns;
    for (Index i = 0; i < count; i++) {
        nodes[i].u = gather(u, count, i), nodes[i].slope = gather(slope, count, i);
        for (Index p = 0; p < columns; p++) {
            by[2 * i * columns + p] = gather(u_by, count * columns, i * columns + p);
            by[(2 * i + 1) * columns + p] = gather(slope_by, count * columns, i * columns + p);
        }
    }
    auto integrate = [&](Real* into, Index e, double upto) {
        const Real* from = reached + 2 * e * columns;
        for (Index p = 0; p < 2 * columns; p++) into[p] = from[p];
        add_position_derivatives(into, e, upto, columns, x, x_by, nodes, by);
    };
    for (Index p = 0; p < columns; p++) reached[p] = Real{}, reached[columns + p] = by[p];
    for (Index e = 0; e < count - 1; e++) integrate(reached + 2 * (e + 1) * columns, e, x[e + 1] - x[e]);
    for (Index k = 0; k < wanted; k++) {
        Index e = find_element(x, count, s[k]);
        integrate(found, e, s[k] - x[e]);
        for (int lane = 0; lane < Traits<Real>::lanes && lane < needles; lane++)
            for (Index p = 0; p < 2 * columns; p++)
                out[2 * columns * (lane * wanted + k) + p] = get_lane(found[p], lane);
    }
}

}  // namespace needlefit
