// The past: the elements behind the tip, condensed to one super-element between node 0 and an interface node.
//
// Behind the tip little changes from one cell to the next. The tangents of these elements, and the elimination of
// their nodes, are therefore kept from the time when each was last linearised; only their right-hand side is
// computed anew (a chord step). The elimination of a node does not depend on what lies before node 0 or beyond the
// interface, so base, guides and the cells near the tip may change freely.
#pragma once

#include "beam.hpp"

namespace needlefit {

// One node of the past, eliminated: u = z - G u_next - H u_0.
template <class Real>
struct PastNode {
    Real g00, g01, g10, g11, h00, h01, h10, h11, i00, i01, i11, z0, z1;
    Real reference;  // its deflection when its elements were linearised
};

// `kept` where a lane is not chosen.
template <class T, class Real>
INLINE void replace_chosen(T& kept, const T& found, const Mask<Real>& chosen) {
    constexpr int count = sizeof(T) / sizeof(Real);
    Real* into = reinterpret_cast<Real*>(&kept);
    const Real* from = reinterpret_cast<const Real*>(&found);
    for (int i = 0; i < count; i++) into[i] = select<Real>(chosen, from[i], into[i]);
}

// Append an element to the super-element, and eliminate its first node, the interface so far.
template <class Real>
INLINE void append(Element<Real>& super, const Element<Real>& k, PastNode<Real>& node) {
    Real s00 = super.k22 + k.k00, s01 = super.k23 + k.k01, s11 = super.k33 + k.k11;
    Real inverse = 1.0 / (s00 * s11 - s01 * s01);
    Real i00 = s11 * inverse, i01 = -s01 * inverse, i11 = s00 * inverse;
    Real c00 = super.k02, c01 = super.k03, c10 = super.k12, c11 = super.k13;  // node 0 to the interface
    Real g00 = i00 * k.k02 + i01 * k.k12, g01 = i00 * k.k03 + i01 * k.k13;
    Real g10 = i01 * k.k02 + i11 * k.k12, g11 = i01 * k.k03 + i11 * k.k13;
    Real h00 = i00 * c00 + i01 * c01, h01 = i00 * c10 + i01 * c11;
    Real h10 = i01 * c00 + i11 * c01, h11 = i01 * c10 + i11 * c11;
    Real r0 = super.f[2] + k.f[0], r1 = super.f[3] + k.f[1];
    node.g00 = g00, node.g01 = g01, node.g10 = g10, node.g11 = g11;
    node.h00 = h00, node.h01 = h01, node.h10 = h10, node.h11 = h11;
    node.i00 = i00, node.i01 = i01, node.i11 = i11;
    node.z0 = i00 * r0 + i01 * r1, node.z1 = i01 * r0 + i11 * r1;
    super.k00 -= c00 * h00 + c01 * h10, super.k01 -= c00 * h01 + c01 * h11, super.k11 -= c10 * h01 + c11 * h11;
    super.k02 = -(c00 * g00 + c01 * g10), super.k03 = -(c00 * g01 + c01 * g11);
    super.k12 = -(c10 * g00 + c11 * g10), super.k13 = -(c10 * g01 + c11 * g11);
    super.k22 = k.k22 - k.k02 * g00 - k.k12 * g10, super.k23 = k.k23 - k.k02 * g01 - k.k12 * g11;
    super.k33 = k.k33 - k.k03 * g01 - k.k13 * g11;
    super.f[0] -= h00 * r0 + h10 * r1, super.f[1] -= h01 * r0 + h11 * r1;
    super.f[2] = k.f[2] - g00 * r0 - g10 * r1, super.f[3] = k.f[3] - g01 * r0 - g11 * r1;
}

// The same of the right-hand side alone: `total` of the super-element so far, `f` of the element.
template <class Real>
INLINE void append_load(Real* total, const Real* f, PastNode<Real>& node, const Mask<Real>& chosen) {
    Real r0 = total[2] + f[0], r1 = total[3] + f[1];
    node.z0 = select<Real>(chosen, node.i00 * r0 + node.i01 * r1, node.z0);
    node.z1 = select<Real>(chosen, node.i01 * r0 + node.i11 * r1, node.z1);
    total[0] -= node.h00 * r0 + node.h10 * r1, total[1] -= node.h01 * r0 + node.h11 * r1;
    total[2] = f[2] - node.g00 * r0 - node.g10 * r1, total[3] = f[3] - node.g01 * r0 - node.g11 * r1;
}

template <class Real>
INLINE Node<Real> substitute(const PastNode<Real>& node, const Node<Real>& next, const Node<Real>& first) {
    return {
        node.z0 - node.g00 * next.u - node.g01 * next.slope - node.h00 * first.u - node.h01 * first.slope,
        node.z1 - node.g10 * next.u - node.g11 * next.slope - node.h10 * first.u - node.h11 * first.slope
    };
}

}  // namespace needlefit
