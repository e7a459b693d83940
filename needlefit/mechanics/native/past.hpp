// The past: the elements behind the tip, condensed to one super-element between node 0 and an interface node.
//
// Behind the tip little changes from one cell to the next. The tangents of these elements, and the elimination of
// their nodes, are therefore kept from the time when each was last linearised; only their right-hand side is
// computed anew (a chord step). The elimination of a node does not depend on what lies before node 0 or beyond the
// interface, so base, guides and the cells near the tip may change freely.
#pragma once

#include "coupled.hpp"

namespace needlefit {

// One node of the past, eliminated: u = z - G u_next - H u_0.
template <class Vector>
struct PastNode {
    Scalar<Vector> g00, g01, g10, g11, h00, h01, h10, h11, i00, i01, i11;
    Vector z0, z1;
    Vector reference;  // its deflection when the element that ends there was linearised
};

// `kept` where a lane is not chosen.
template <class T, class Real>
INLINE void replace_chosen(T& kept, const T& found, const Mask<Real>& chosen) {
    constexpr int count = sizeof(T) / sizeof(Real);
    Real* into = reinterpret_cast<Real*>(&kept);
    const Real* from = reinterpret_cast<const Real*>(&found);
    for (int i = 0; i < count; i++) into[i] = select<Real>(chosen, from[i], into[i]);
}

// Append an element of length h to the super-element, of length `span` so far, and eliminate its first node, the
// interface so far. The super-element is written as an element is, for (d, b): node 0 relative to the interface, and the
// interface. For the new interface, d changes by T d_i, where T belongs to `span` and d_i is the old one's own.
template <class Vector>
INLINE void append(Element<Vector>& super, const Element<Vector>& k, double span, double h, PastNode<Vector>& node) {
    using Real = Scalar<Vector>;
    // W couples node 0 to d_i, V couples d_i to the old interface; s = V - W^T T is the stiffness of d_i.
    Real w00 = super.k02 - super.k00, w01 = super.k03 - (super.k01 - span * super.k00);
    Real w10 = super.k12 - super.k01, w11 = super.k13 - (super.k11 - span * super.k01);
    Real v00 = super.k22 - super.k02, v01 = super.k23 - super.k03;
    Real v10 = super.k23 - (super.k12 - span * super.k02), v11 = super.k33 - (super.k13 - span * super.k03);
    Real s00 = k.k00 + (v00 - w00), s01 = k.k01 + (v01 - (w10 - span * w00)), s11 = k.k11 + (v11 - (w11 - span * w01));
    Real inverse = 1.0 / (s00 * s11 - s01 * s01);
    Real i00 = s11 * inverse, i01 = -s01 * inverse, i11 = s00 * inverse;
    Real a00 = k.k02 + v00, a01 = k.k03 + (v01 - h * v00), a10 = k.k12 + v10, a11 = k.k13 + (v11 - h * v10);
    Real g00 = i00 * a00 + i01 * a10, g01 = i00 * a01 + i01 * a11;
    Real g10 = i01 * a00 + i11 * a10, g11 = i01 * a01 + i11 * a11;
    Real h00 = i00 * w00 + i01 * w01, h01 = i00 * w10 + i01 * w11;
    Real h10 = i01 * w00 + i11 * w01, h11 = i01 * w10 + i11 * w11;
    node.i00 = i00, node.i01 = i01, node.i11 = i11;
    node.h00 = h00, node.h01 = h01, node.h10 = h10, node.h11 = h11;
    Real e00 = k.k02 - k.k00, e01 = k.k03 - (k.k01 - h * k.k00), e10 = k.k12 - k.k01, e11 = k.k13 - (k.k11 - h * k.k01);
    node.g00 = i00 * e00 + i01 * e10, node.g01 = i00 * e01 + i01 * e11;  // as in `eliminate`, for the nodes themselves
    node.g10 = i01 * e00 + i11 * e10, node.g11 = i01 * e01 + i11 * e11;
    Vector r0 = super.f[2] + k.f[0], r1 = super.f[3] + k.f[1];
    node.z0 = i00 * r0 + i01 * r1, node.z1 = i01 * r0 + i11 * r1;
    super.f[0] -= h00 * r0 + h10 * r1, super.f[1] -= h01 * r0 + h11 * r1;
    super.f[2] = k.f[2] - (node.g00 * r0 + node.g10 * r1), super.f[3] = k.f[3] - (node.g01 * r0 + node.g11 * r1);
    Real c01 = super.k03 - h * super.k02, c11 = super.k13 - h * super.k12, n01 = super.k23 - h * super.k22;
    super.k33 = k.k33 + ((super.k33 - h * super.k23) - h * n01) - (a01 * g01 + a11 * g11);
    super.k23 = k.k23 + n01 - (a00 * g01 + a10 * g11), super.k22 += k.k22 - (a00 * g00 + a10 * g10);
    super.k00 -= w00 * h00 + w01 * h10, super.k01 -= w00 * h01 + w01 * h11, super.k11 -= w10 * h01 + w11 * h11;
    super.k02 -= w00 * g00 + w01 * g10, super.k03 = c01 - (w00 * g01 + w01 * g11);
    super.k12 -= w10 * g00 + w11 * g10, super.k13 = c11 - (w10 * g01 + w11 * g11);
}

// The same of the right-hand side alone: `total` of the super-element so far, `f` of the element.
template <class Vector>
INLINE void append_load(
    Vector* total, const Vector* f, PastNode<Vector>& node, const Chosen<Scalar<Vector>>& chosen
) {
    Vector r0 = total[2] + f[0], r1 = total[3] + f[1];
    node.z0 = chosen(node.i00 * r0 + node.i01 * r1, node.z0);
    node.z1 = chosen(node.i01 * r0 + node.i11 * r1, node.z1);
    total[0] -= node.h00 * r0 + node.h10 * r1, total[1] -= node.h01 * r0 + node.h11 * r1;
    total[2] = f[2] - node.g00 * r0 - node.g10 * r1, total[3] = f[3] - node.g01 * r0 - node.g11 * r1;
}

template <class Vector>
INLINE Node<Vector> substitute(const PastNode<Vector>& node, const Node<Vector>& next, const Node<Vector>& first) {
    return {
        // grouped so that only one product and two sums wait for the next node
        (node.z0 - (node.h00 * first.u + node.h01 * first.slope)) - (node.g00 * next.u + node.g01 * next.slope),
        (node.z1 - (node.h10 * first.u + node.h11 * first.slope)) - (node.g10 * next.u + node.g11 * next.slope)
    };
}

}  // namespace needlefit
