// The beam: equations of an element, and their elimination node by node from base to tip.
//
// K_T u = t is solved for the whole u, not for its change: the beam's own residual then needs no evaluation.
#pragma once

#include "grid.hpp"
#include "reaction.hpp"

namespace needlefit {

// Deflection and slope of a node.
template <class Real>
struct Node {
    Real u{}, slope{};
};

// The equations of the element from node a to node b, for (u_a, u'_a, u_b, u'_b).
template <class Real>
struct Element {
    Real k00{}, k01{}, k02{}, k03{}, k11{}, k12{}, k13{}, k22{}, k23{}, k33{};  // symmetric
    Real f[4]{};

    // The bending stiffness int EI N_i'' N_j'' dx of a cubic element.
    INLINE void add_bending(const Real& rigidity, const Real& length) {
        Real scaled = rigidity / (length * length * length);
        Real a = 12.0 * scaled, b = 6.0 * scaled * length;
        Real c = 4.0 * scaled * length * length, d = 2.0 * scaled * length * length;
        k00 += a, k01 += b, k02 -= a, k03 += b, k11 += c, k12 -= b, k13 += d, k22 += a, k23 -= b, k33 += c;
    }

    // What the tissue adds at a point: `pull` = w d(k e g)/de, `load` = what stands on the right-hand side.
    template <class Shape>
    INLINE void add_point(const Hermite<Shape>& shape, const Real& pull, const Real& load) {
        const Shape* n = shape.n;
        Real p0 = pull * n[0], p1 = pull * n[1], p2 = pull * n[2], p3 = pull * n[3];
        k00 += p0 * n[0], k01 += p0 * n[1], k02 += p0 * n[2], k03 += p0 * n[3];
        k11 += p1 * n[1], k12 += p1 * n[2], k13 += p1 * n[3];
        k22 += p2 * n[2], k23 += p2 * n[3], k33 += p3 * n[3];
        add_load(shape, load);
    }
    template <class Shape>
    INLINE void add_load(const Hermite<Shape>& shape, const Real& load) {
        for (int j = 0; j < 4; j++) f[j] += load * shape.n[j];
    }
};

// What friction adds to an element's equations, which is not symmetric.
template <class Real>
struct Rubbing {
    Real k[4][4]{};

    template <class Shape>
    INLINE void add_point(const Hermite<Shape>& shape, const Real& by_slope) {
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) k[i][j] += by_slope * shape.n[i] * shape.m[j];
    }
};

enum Kind : int { FREE, PINNED, CLAMPED };  // a node: its deflection is prescribed, or its slope too

// What the elimination of a node leaves: G = S^-1 K_ab, z = S^-1 r, S^-1 and K_ba.
template <class Real>
struct Factor {
    Real g[2][2], z[2], inverse[2][2], back[2][2];
};

// What is handed on to the next node: its S and r.
template <class Real>
struct Carried {
    Real s[2][2]{}, r[2]{};
};

// Eliminate the first node of an element; what is prescribed there replaces its equation.
template <class Real>
INLINE void eliminate(
    Carried<Real>& carried, const Element<Real>& k, const Rubbing<Real>* rubbing, Kind kind, const Node<Real>& value,
    Factor<Real>& factor
) {
    Real s00 = carried.s[0][0] + k.k00, s01 = carried.s[0][1] + k.k01;
    Real s10 = carried.s[1][0] + k.k01, s11 = carried.s[1][1] + k.k11;
    Real a02 = k.k02, a03 = k.k03, a12 = k.k12, a13 = k.k13;  // K_ab
    Real b20 = k.k02, b21 = k.k12, b30 = k.k03, b31 = k.k13;  // K_ba
    Real n22 = k.k22, n23 = k.k23, n32 = k.k23, n33 = k.k33;
    if (rubbing) {
        const auto& x = rubbing->k;
        s00 += x[0][0], s01 += x[0][1], s10 += x[1][0], s11 += x[1][1];
        a02 += x[0][2], a03 += x[0][3], a12 += x[1][2], a13 += x[1][3];
        b20 += x[2][0], b21 += x[2][1], b30 += x[3][0], b31 += x[3][1];
        n22 += x[2][2], n23 += x[2][3], n32 += x[3][2], n33 += x[3][3];
    }
    Real r0 = carried.r[0] + k.f[0], r1 = carried.r[1] + k.f[1];
    if (kind != FREE) {
        s00 = all_lanes<Real>(1.0), s01 = a02 = a03 = Real{}, r0 = value.u;
        if (kind == CLAMPED) s11 = all_lanes<Real>(1.0), s10 = a12 = a13 = Real{}, r1 = value.slope;
    }
    // No pivoting: without friction S is positive definite as long as the tangent modulus is positive.
    Real inverse = 1.0 / (s00 * s11 - s01 * s10);
    Real i00 = s11 * inverse, i01 = -s01 * inverse, i10 = -s10 * inverse, i11 = s00 * inverse;
    Real g00 = i00 * a02 + i01 * a12, g01 = i00 * a03 + i01 * a13;
    Real g10 = i10 * a02 + i11 * a12, g11 = i10 * a03 + i11 * a13;
    Real z0 = i00 * r0 + i01 * r1, z1 = i10 * r0 + i11 * r1;
    factor = {{{g00, g01}, {g10, g11}}, {z0, z1}, {{i00, i01}, {i10, i11}}, {{b20, b21}, {b30, b31}}};
    carried.s[0][0] = n22 - b20 * g00 - b21 * g10, carried.s[0][1] = n23 - b20 * g01 - b21 * g11;
    carried.s[1][0] = n32 - b30 * g00 - b31 * g10, carried.s[1][1] = n33 - b30 * g01 - b31 * g11;
    carried.r[0] = k.f[2] - b20 * z0 - b21 * z1, carried.r[1] = k.f[3] - b30 * z0 - b31 * z1;
}

// A node from the one after it.
template <class Real>
INLINE Node<Real> substitute(const Factor<Real>& factor, const Node<Real>& next) {
    return {
        factor.z[0] - factor.g[0][0] * next.u - factor.g[0][1] * next.slope,
        factor.z[1] - factor.g[1][0] * next.u - factor.g[1][1] * next.slope
    };
}

}  // namespace needlefit
