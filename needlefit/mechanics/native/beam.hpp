// The beam: equations of an element, and their elimination node by node from base to tip.
//
// An element's stiffness is written for the nodes b = (u_b, u'_b) and d = a - T b, where T = [1 -h; 0 1] carries node a
// along with b as if the element were rigid. Bending then enters the block of d alone, so the elimination of d never
// subtracts bending stiffnesses (12 EI / h^3) to find the small stiffness of a long span: errors stay at rounding,
// however fine the mesh. Loads are those on the nodes themselves.
//
// K_T u = t is solved for the whole u, not for its change: the beam's own residual then needs no evaluation.
#pragma once

#include "grid.hpp"
#include "reaction.hpp"

namespace needlefit {

// Deflection and slope of a node.
template <class Vector>
struct Node {
    Vector u{}, slope{};
};

// The equations of the element from node a to node b: stiffness for (d, b), loads f on (a, b). In space the stiffness is
// that of both planes.
template <class Vector>
struct Element {
    using Real = Scalar<Vector>;
    Real k00{}, k01{}, k02{}, k03{}, k11{}, k12{}, k13{}, k22{}, k23{}, k33{};  // symmetric
    Vector f[4]{};

    // The bending stiffness int EI N_i'' N_j'' dx of a cubic element.
    INLINE void add_bending(const Real& rigidity, const Real& length) {
        Real scaled = rigidity / length;
        k11 += 4.0 * scaled, k01 += 6.0 * (scaled / length), k00 += 12.0 * (scaled / (length * length));
    }

    // What the tissue adds at a point `behind` mm after node b (below 0): `pull` = w d(k e g)/de, `load` = what stands on
    // the right-hand side.
    template <class Shape>
    INLINE void add_point(const Hermite<Shape>& shape, const Shape& behind, const Real& pull, const Vector& load) {
        const Shape *n = shape.n, moved[4] = {n[0], n[1], Shape() + 1.0, behind};
        Real p0 = pull * moved[0], p1 = pull * moved[1], p3 = pull * moved[3];
        k00 += p0 * moved[0], k01 += p0 * moved[1], k02 += p0, k03 += p0 * moved[3];
        k11 += p1 * moved[1], k12 += p1, k13 += p1 * moved[3];
        k22 += pull, k23 += p3, k33 += p3 * moved[3];
        for (int j = 0; j < 4; j++) f[j] += load * n[j];
    }
};

// What friction adds to an element's stiffness, which is not symmetric.
template <class Real>
struct Rubbing {
    Real k[4][4]{};

    template <class Shape>
    INLINE void add_point(const Hermite<Shape>& shape, const Shape& behind, const Real& by_slope) {
        Shape one = Shape() + 1.0, n[4] = {shape.n[0], shape.n[1], one, behind}, m[4] = {shape.m[0], shape.m[1], Shape(), one};
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) k[i][j] += by_slope * n[i] * m[j];
    }
};

enum Kind : int { FREE, PINNED, CLAMPED };  // a node: its deflection is prescribed, or its slope too

// What the elimination of a node leaves: a = z - G b with z = S^-1 r, and the load M r that it hands on to node b.
template <class Vector>
struct Factor {
    Scalar<Vector> g[2][2];
    Vector z[2];
    Scalar<Vector> inverse[2][2], onward[2][2];
};

// What is handed on to the next node: its stiffness and its load.
template <class Vector>
struct Carried {
    Scalar<Vector> s[2][2]{};
    Vector r[2]{};
};

// Eliminate the first node of an element of length h; what is prescribed there replaces its equation.
//
// With the blocks dd, db, bd, bb of the element and the stiffness s carried to node a:
//
//     (dd + s) G = db - dd T,    M (dd + s) = T^T dd - bd,    s_b = bb - bd T - (bd + T^T s) G
//
// in which no difference is small beside its terms, whether s is much softer or much stiffer than the element.
template <class Vector>
INLINE void eliminate(
    Carried<Vector>& carried, const Element<Vector>& k, const Rubbing<Scalar<Vector>>* rubbing,
    const Scalar<Vector>& h, Kind kind, const Node<Vector>& value, Factor<Vector>& factor
) {
    using Real = Scalar<Vector>;
    Real dd[2][2] = {{k.k00, k.k01}, {k.k01, k.k11}}, db[2][2] = {{k.k02, k.k03}, {k.k12, k.k13}};
    Real bd[2][2] = {{k.k02, k.k12}, {k.k03, k.k13}}, bb[2][2] = {{k.k22, k.k23}, {k.k23, k.k33}};
    if (rubbing)
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 2; j++) {
                dd[i][j] += rubbing->k[i][j], db[i][j] += rubbing->k[i][j + 2];
                bd[i][j] += rubbing->k[i + 2][j], bb[i][j] += rubbing->k[i + 2][j + 2];
            }
    Real d[2][2], e[2][2], f[2][2];
    Vector r[2];
    auto& s = carried.s;
    for (int i = 0; i < 2; i++) {
        r[i] = carried.r[i] + k.f[i];
        bb[i][1] += h * bd[i][0], bb[i][0] -= bd[i][0], bb[i][1] -= bd[i][1];
        e[i][0] = db[i][0] - dd[i][0], e[i][1] = db[i][1] - (dd[i][1] - h * dd[i][0]);
        f[0][i] = dd[0][i] - bd[0][i], f[1][i] = (dd[1][i] - h * dd[0][i]) - bd[1][i];
    }
    for (int i = 0; i < 2; i++) {
        bool held = i == 0 ? kind != FREE : kind == CLAMPED;
        for (int j = 0; j < 2; j++) {
            // Node a does not take part in the motions of b where it is held.
            Real lost = held ? dd[i][j] : -s[i][j], gone = held ? e[i][j] : Real{};
            bd[i][j] -= lost, bb[i][j] -= gone;
            if (i == 0) bd[1][j] += h * lost, bb[1][j] += h * gone;
            d[i][j] = held ? Real{} : dd[i][j] + s[i][j];
            if (held) e[i][j] = Real{};
        }
        if (held) d[i][i] = all_lanes<Real>(1.0), r[i] = i == 0 ? value.u : value.slope;
    }
    // No pivoting: without friction d is positive definite as long as the tangent modulus is positive.
    Real inverse = 1.0 / (d[0][0] * d[1][1] - d[0][1] * d[1][0]);
    Real i00 = d[1][1] * inverse, i01 = -d[0][1] * inverse, i10 = -d[1][0] * inverse, i11 = d[0][0] * inverse;
    if (kind != FREE) i00 = all_lanes<Real>(1.0);  // to the last bit
    factor.inverse[0][0] = i00, factor.inverse[0][1] = i01, factor.inverse[1][0] = i10, factor.inverse[1][1] = i11;
    factor.z[0] = i00 * r[0] + i01 * r[1], factor.z[1] = i10 * r[0] + i11 * r[1];
    for (int i = 0; i < 2; i++) {
        factor.g[0][i] = i00 * e[0][i] + i01 * e[1][i], factor.g[1][i] = i10 * e[0][i] + i11 * e[1][i];
        factor.onward[i][0] = f[i][0] * i00 + f[i][1] * i10, factor.onward[i][1] = f[i][0] * i01 + f[i][1] * i11;
    }
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2; j++) s[i][j] = bb[i][j] - (bd[i][0] * factor.g[0][j] + bd[i][1] * factor.g[1][j]);
        carried.r[i] = k.f[2 + i] + (factor.onward[i][0] * r[0] + factor.onward[i][1] * r[1]);
    }
}

// A node from the one after it.
template <class Vector>
INLINE Node<Vector> substitute(const Factor<Vector>& factor, const Node<Vector>& next) {
    return {
        factor.z[0] - factor.g[0][0] * next.u - factor.g[0][1] * next.slope,
        factor.z[1] - factor.g[1][0] * next.u - factor.g[1][1] * next.slope
    };
}

}  // namespace needlefit
