// The equations of both planes of a needle in space together: Newton's method where one matrix for both planes does
// not suffice, and derivatives. The same elimination as in `beam.hpp`, with u along y and z and both slopes of a node.
#pragma once

#include "beam.hpp"

namespace needlefit {

constexpr int UNKNOWNS = 4;  // of a node: v, w, v', w'; number 2 * component + plane

// The reaction at a quadrature point: e, and with the point's weight d(k e g)/de and k e g.
template <class Vector, class Pull>
struct Reaction {
    Vector e;
    Pull pull;
    Vector force;
};

// In space with d(k e g)/du', plain times friction, and with what stands on the right-hand side.
template <class Real>
struct CoupledPoint : Reaction<Pair<Real>, SymmetricMatrix<Real>> {
    Pair<Real> plain, friction, load;
};

// The equations of an element for (d, b), and loads on (a, b).
template <class Real, bool General>
struct CoupledElement {
    Real dd[UNKNOWNS][UNKNOWNS]{}, db[UNKNOWNS][UNKNOWNS]{}, bd[UNKNOWNS][UNKNOWNS]{}, bb[UNKNOWNS][UNKNOWNS]{};
    Real f[2][UNKNOWNS]{};

    INLINE void add_bending(const Real& rigidity, const Real& length) {
        Element<Real> one;
        one.add_bending(rigidity, length);
        for (int plane = 0; plane < 2; plane++) {
            dd[plane][plane] += one.k00, dd[plane][2 + plane] += one.k01;
            dd[2 + plane][plane] += one.k01, dd[2 + plane][2 + plane] += one.k11;
        }
    }

    // What the tissue adds at two points `behind` and `then` mm after node b (below 0).
    template <class Shape>
    INLINE void add_pair(
        const Hermite<Shape>& first, const Hermite<Shape>& second, const Shape& behind, const Shape& then,
        const CoupledPoint<Real>& one, const CoupledPoint<Real>& two
    ) {
        add_point(first, behind, one), add_point(second, then, two);
    }
    template <class Shape>
    INLINE void add_point(const Hermite<Shape>& shape, const Shape& behind, const CoupledPoint<Real>& at) {
        Shape one = Shape() + 1.0, n[4] = {shape.n[0], shape.n[1], one, behind};
        Shape m[4] = {shape.m[0], shape.m[1], Shape(), one};
        for (int i = 0; i < 4; i++)
            for (int p = 0; p < 2; p++) {
                for (int j = 0; j < 4; j++)
                    for (int q = 0; q < 2; q++) {
                        auto& block = i < 2 ? (j < 2 ? dd : db) : (j < 2 ? bd : bb);
                        Real rubbing = part(at.plain, p) * part(at.friction, q) * m[j];
                        block[2 * (i % 2) + p][2 * (j % 2) + q] += n[i] * (part(at.pull, p, q) * n[j] + rubbing);
                    }
                f[i / 2][2 * (i % 2) + p] += part(at.load, p) * shape.n[i];
            }
    }
};

// The same without friction and loads: the blocks (i, j), i <= j, for the deflection and slope of d, then of b. Each is
// symmetric in the planes too.
template <class Real>
struct CoupledElement<Real, false> {
    SymmetricMatrix<Real> k[4][4]{};

    INLINE void add_bending(const Real& rigidity, const Real& length) {
        Element<Real> one;
        one.add_bending(rigidity, length);
        auto add = [](SymmetricMatrix<Real>& block, const Real& more) { block.yy += more, block.zz += more; };
        add(k[0][0], one.k00), add(k[0][1], one.k01), add(k[1][1], one.k11);
    }
    // Both points at once, for each sum goes through memory.
    template <class Shape>
    INLINE void add_pair(
        const Hermite<Shape>& first, const Hermite<Shape>& second, const Shape& behind, const Shape& then,
        const CoupledPoint<Real>& one, const CoupledPoint<Real>& two
    ) {
        Shape n[4] = {first.n[0], first.n[1], Shape() + 1.0, behind}, m[4] = {second.n[0], second.n[1], n[2], then};
        for (int i = 0; i < 4; i++)
            for (int j = i; j < 4; j++) k[i][j] = k[i][j] + ((n[i] * n[j]) * one.pull + (m[i] * m[j]) * two.pull);
    }
};

template <class Real>
struct CoupledFactor {
    Real g[UNKNOWNS][UNKNOWNS], z[UNKNOWNS], inverse[UNKNOWNS][UNKNOWNS], onward[UNKNOWNS][UNKNOWNS];
};

template <class Real>
struct CoupledCarried {
    Real s[UNKNOWNS][UNKNOWNS]{}, r[UNKNOWNS]{};
};

// Invert a matrix in place, by Gauss-Jordan elimination. No pivoting, as in `eliminate` of one plane.
template <class Real>
INLINE void invert(Real (&a)[UNKNOWNS][UNKNOWNS]) {
    for (int k = 0; k < UNKNOWNS; k++) {
        Real inverse = 1.0 / a[k][k];
        for (int j = 0; j < UNKNOWNS; j++) a[k][j] = j == k ? inverse : inverse * a[k][j];
        for (int i = 0; i < UNKNOWNS; i++) {
            Real share = a[i][k];
            for (int j = 0; i != k && j < UNKNOWNS; j++) a[i][j] = j == k ? -share * inverse : a[i][j] - share * a[k][j];
        }
    }
}

// The inverse of a symmetric matrix by its 2 x 2 blocks: of deflections, and of what they leave to the slopes.
template <class Real>
INLINE void invert_symmetric(const Real (&a)[UNKNOWNS][UNKNOWNS], Real (&out)[UNKNOWNS][UNKNOWNS]) {
    Real scale = 1.0 / (a[0][0] * a[1][1] - a[0][1] * a[0][1]);
    Real p[3] = {a[1][1] * scale, -a[0][1] * scale, a[0][0] * scale}, pq[2][2], u[2][2];
    for (int j = 0; j < 2; j++) {
        pq[0][j] = p[0] * a[0][2 + j] + p[1] * a[1][2 + j];
        pq[1][j] = p[1] * a[0][2 + j] + p[2] * a[1][2 + j];
    }
    Real r00 = a[2][2] - (a[0][2] * pq[0][0] + a[1][2] * pq[1][0]);
    Real r01 = a[2][3] - (a[0][2] * pq[0][1] + a[1][2] * pq[1][1]);
    Real r11 = a[3][3] - (a[0][3] * pq[0][1] + a[1][3] * pq[1][1]);
    Real rest = 1.0 / (r00 * r11 - r01 * r01);
    Real t00 = r11 * rest, t01 = -r01 * rest, t11 = r00 * rest;
    for (int i = 0; i < 2; i++) {
        u[i][0] = pq[i][0] * t00 + pq[i][1] * t01, u[i][1] = pq[i][0] * t01 + pq[i][1] * t11;
        for (int j = 0; j < 2; j++) out[i][2 + j] = out[2 + j][i] = -u[i][j];
    }
    out[0][0] = p[0] + (u[0][0] * pq[0][0] + u[0][1] * pq[0][1]);
    out[0][1] = out[1][0] = p[1] + (u[0][0] * pq[1][0] + u[0][1] * pq[1][1]);
    out[1][1] = p[2] + (u[1][0] * pq[1][0] + u[1][1] * pq[1][1]);
    out[2][2] = t00, out[2][3] = out[3][2] = t01, out[3][3] = t11;
}

template <class Real>
INLINE Real read_component(const Node<Pair<Real>>& node, int i) {
    return part(i < 2 ? node.u : node.slope, i % 2);
}

// As `eliminate` of one plane.
template <class Real>
void eliminate(
    CoupledCarried<Real>& carried, CoupledElement<Real, true>& k, const Real& h, Kind kind, const Node<Pair<Real>>& value,
    CoupledFactor<Real>& factor
) {
    constexpr int N = UNKNOWNS;
    Real d[N][N], e[N][N], f[N][N], r[N];
    auto& s = carried.s;
    for (int i = 0; i < N; i++) {
        r[i] = carried.r[i] + k.f[0][i];
        for (int p = 0; p < 2; p++) {
            int u = p, slope = 2 + p;
            k.bb[i][slope] += h * k.bd[i][u];
            k.bb[i][u] -= k.bd[i][u], k.bb[i][slope] -= k.bd[i][slope];
            e[i][u] = k.db[i][u] - k.dd[i][u], e[i][slope] = k.db[i][slope] - (k.dd[i][slope] - h * k.dd[i][u]);
            f[u][i] = k.dd[u][i] - k.bd[u][i], f[slope][i] = (k.dd[slope][i] - h * k.dd[u][i]) - k.bd[slope][i];
        }
    }
    for (int i = 0; i < N; i++) {
        bool held = i < 2 ? kind != FREE : kind == CLAMPED;
        for (int j = 0; j < N; j++) {
            Real lost = held ? k.dd[i][j] : -s[i][j], gone = held ? e[i][j] : Real{};
            k.bd[i][j] -= lost, k.bb[i][j] -= gone;
            if (i < 2) k.bd[2 + i][j] += h * lost, k.bb[2 + i][j] += h * gone;
            d[i][j] = held ? Real{} : k.dd[i][j] + s[i][j];
            if (held) e[i][j] = Real{};
        }
        if (held) d[i][i] = all_lanes<Real>(1.0), r[i] = read_component(value, i);
    }
    invert(d);
    for (int i = 0; i < N; i++) {
        Real z{};
        for (int j = 0; j < N; j++) {
            Real g{}, onward{};
            for (int l = 0; l < N; l++)
                g += d[i][l] * e[l][j], onward += f[i][l] * d[l][j];
            factor.inverse[i][j] = d[i][j], factor.g[i][j] = g, factor.onward[i][j] = onward;
            z += d[i][j] * r[j];
        }
        factor.z[i] = z;
    }
    for (int i = 0; i < N; i++) {
        Real load = k.f[1][i];
        for (int j = 0; j < N; j++) {
            Real lost{};
            for (int l = 0; l < N; l++) lost += k.bd[i][l] * factor.g[l][j];
            s[i][j] = k.bb[i][j] - lost;
            load += factor.onward[i][j] * r[j];
        }
        carried.r[i] = load;
    }
}

// The same of a free node and a symmetric element: then onward = -G^T, which is all that is kept.
template <class Real>
INLINE void eliminate(
    CoupledCarried<Real>& carried, const CoupledElement<Real, false>& element, const Real& h, CoupledFactor<Real>& factor
) {
    constexpr int N = UNKNOWNS;
    const auto& k = element.k;
    SymmetricMatrix<Real> e[2][2] = {{k[0][2] - k[0][0], k[0][3] - (k[0][1] - h * k[0][0])},
                                     {k[1][2] - k[0][1], k[1][3] - (k[1][1] - h * k[0][1])}};
    SymmetricMatrix<Real> rest[2][2] = {{k[2][2] - k[0][2], k[2][3] - (k[1][2] - h * k[0][2])},
                                        {{}, k[3][3] - (k[1][3] - h * k[0][3])}};
    auto entry = [](const auto& blocks, int i, int j) -> const Real& { return part(blocks[i / 2][j / 2], i % 2, j % 2); };
    Real d[N][N], inverse[N][N], w[N][N], g[N][N];  // w = bd + T^T s
    auto& s = carried.s;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            if (i <= j) d[i][j] = entry(k, i, j) + s[i][j];
            w[i][j] = entry(k, j, 4 + i) + (i < 2 ? s[i][j] : s[i][j] - h * s[i - 2][j]);
        }
    invert_symmetric(d, inverse);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            g[i][j] = inverse[i][0] * entry(e, 0, j) + inverse[i][1] * entry(e, 1, j) +
                      (inverse[i][2] * entry(e, 2, j) + inverse[i][3] * entry(e, 3, j));
            factor.onward[j][i] = -g[i][j];
        }
    for (int i = 0; i < N; i++)
        for (int j = i; j < N; j++)
            s[i][j] = s[j][i] =
                entry(rest, i, j) - (w[i][0] * g[0][j] + w[i][1] * g[1][j] + (w[i][2] * g[2][j] + w[i][3] * g[3][j]));
}

template <class Real>
INLINE Node<Pair<Real>> substitute(const CoupledFactor<Real>& factor, const Node<Pair<Real>>& next) {
    Real found[UNKNOWNS];
    for (int i = 0; i < UNKNOWNS; i++) {
        found[i] = factor.z[i];
        for (int j = 0; j < UNKNOWNS; j++) found[i] -= factor.g[i][j] * read_component(next, j);
    }
    return {{found[0], found[1]}, {found[2], found[3]}};
}

}  // namespace needlefit
