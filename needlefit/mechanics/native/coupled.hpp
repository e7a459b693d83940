// The equations of both planes of a needle in space together: Newton's method where one matrix for both planes does
// not suffice, and derivatives. The same elimination as in `beam.hpp`, with u along y and z and both slopes of a node.
#pragma once

#include "beam.hpp"

namespace needlefit {

constexpr int UNKNOWNS = 4;  // of a node: v, w, v', w'; number 2 * component + plane

// The equations of an element for (d, b), and loads on (a, b).
template <class Real>
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

    // What the tissue adds at a point `behind` mm after node b (below 0): the weighted derivatives of its force by e, and
    // by the slope, and what stands on the right-hand side.
    template <class Shape>
    INLINE void add_point(
        const Hermite<Shape>& shape, const Shape& behind, const Real (&pull)[2][2], const Real (&by_slope)[2][2],
        const Pair<Real>& load
    ) {
        Shape one = Shape() + 1.0, n[4] = {shape.n[0], shape.n[1], one, behind};
        Shape m[4] = {shape.m[0], shape.m[1], Shape(), one};
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) {
                auto& block = i < 2 ? (j < 2 ? dd : db) : (j < 2 ? bd : bb);
                for (int p = 0; p < 2; p++)
                    for (int q = 0; q < 2; q++)
                        block[2 * (i % 2) + p][2 * (j % 2) + q] += n[i] * (pull[p][q] * n[j] + by_slope[p][q] * m[j]);
            }
        add_load(shape, load);
    }
    template <class Shape>
    INLINE void add_load(const Hermite<Shape>& shape, const Pair<Real>& load) {
        for (int j = 0; j < 4; j++)
            for (int p = 0; p < 2; p++) f[j / 2][2 * (j % 2) + p] += part(load, p) * shape.n[j];
    }

    // The same without friction, whose stiffness is symmetric: the rest follows from `mirror`.
    template <class Shape>
    INLINE void add_point(
        const Hermite<Shape>& shape, const Shape& behind, const SymmetricMatrix<Real>& pull, const Pair<Real>& load
    ) {
        Shape n[4] = {shape.n[0], shape.n[1], Shape() + 1.0, behind};
        for (int i = 0; i < 4; i++)
            for (int j = i; j < 4; j++) {
                auto& block = i < 2 ? (j < 2 ? dd : db) : bb;
                int row = 2 * (i % 2), column = 2 * (j % 2);
                Shape product = n[i] * n[j];
                Real across = product * pull.yz;
                block[row][column] += product * pull.yy, block[row + 1][column + 1] += product * pull.zz;
                block[row][column + 1] += across, block[row + 1][column] += across;
            }
        add_load(shape, load);
    }
    INLINE void mirror() {
        for (int i = 0; i < UNKNOWNS; i++)
            for (int j = 0; j < UNKNOWNS; j++) bd[i][j] = db[j][i];
        for (int i = 2; i < UNKNOWNS; i++)
            for (int j = 0; j < 2; j++) dd[i][j] = dd[j][i], bb[i][j] = bb[j][i];
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

template <class Real>
INLINE void invert(const Real (&a)[2][2], Real (&out)[2][2]) {
    Real inverse = 1.0 / (a[0][0] * a[1][1] - a[0][1] * a[1][0]);
    out[0][0] = a[1][1] * inverse, out[0][1] = -a[0][1] * inverse;
    out[1][0] = -a[1][0] * inverse, out[1][1] = a[0][0] * inverse;
}
template <class Real>
INLINE void multiply(const Real (&a)[2][2], const Real (&b)[2][2], Real (&out)[2][2]) {
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j];
}

// The inverse of a matrix, by its 2 x 2 blocks: of deflections, and of what they leave to the slopes.
template <class Real>
INLINE void invert(const Real (&a)[UNKNOWNS][UNKNOWNS], Real (&out)[UNKNOWNS][UNKNOWNS]) {
    Real p[2][2], q[2][2], r[2][2], s[2][2], p_inverse[2][2], pq[2][2], rp[2][2], rest[2][2], t[2][2], u[2][2];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++)
            p[i][j] = a[i][j], q[i][j] = a[i][2 + j], r[i][j] = a[2 + i][j], s[i][j] = a[2 + i][2 + j];
    invert(p, p_inverse);
    multiply(p_inverse, q, pq), multiply(r, p_inverse, rp), multiply(r, pq, rest);
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) rest[i][j] = s[i][j] - rest[i][j];
    invert(rest, t);
    multiply(pq, t, u), multiply(t, rp, r), multiply(u, rp, s);
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            out[i][j] = p_inverse[i][j] + s[i][j], out[i][2 + j] = -u[i][j];
            out[2 + i][j] = -r[i][j], out[2 + i][2 + j] = t[i][j];
        }
}

// The inverse of a symmetric matrix.
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
    CoupledCarried<Real>& carried, CoupledElement<Real>& k, const Real& h, Kind kind, const Node<Pair<Real>>& value,
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
    invert(d, factor.inverse);
    for (int i = 0; i < N; i++) {
        Real z{};
        for (int j = 0; j < N; j++) {
            Real g{}, onward{};
            for (int l = 0; l < N; l++)
                g += factor.inverse[i][l] * e[l][j], onward += f[i][l] * factor.inverse[l][j];
            factor.g[i][j] = g, factor.onward[i][j] = onward;
            z += factor.inverse[i][j] * r[j];
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

// The same of a free node and a symmetric element: then onward = -g^T, and half of the rest follows from the other half.
template <class Real>
INLINE void eliminate_symmetric(
    CoupledCarried<Real>& carried, const CoupledElement<Real>& k, const Real& h, CoupledFactor<Real>& factor
) {
    constexpr int N = UNKNOWNS;
    Real d[N][N], e[N][N], w[N][N], r[N];  // w = bd + T^T s
    auto& s = carried.s;
    for (int i = 0; i < N; i++) {
        r[i] = carried.r[i] + k.f[0][i];
        for (int j = 0; j < N; j++) {
            d[i][j] = k.dd[i][j] + s[i][j];
            e[i][j] = k.db[i][j] - (j < 2 ? k.dd[i][j] : k.dd[i][j] - h * k.dd[i][j - 2]);
            w[i][j] = k.db[j][i] + (i < 2 ? s[i][j] : s[i][j] - h * s[i - 2][j]);
        }
    }
    invert_symmetric(d, factor.inverse);
    const auto& inverse = factor.inverse;
    for (int i = 0; i < N; i++) {
        factor.z[i] = inverse[i][0] * r[0] + inverse[i][1] * r[1] + (inverse[i][2] * r[2] + inverse[i][3] * r[3]);
        for (int j = 0; j < N; j++) {
            Real g = inverse[i][0] * e[0][j] + inverse[i][1] * e[1][j] + (inverse[i][2] * e[2][j] + inverse[i][3] * e[3][j]);
            factor.g[i][j] = g, factor.onward[j][i] = -g;
        }
    }
    const auto& g = factor.g;
    for (int i = 0; i < N; i++) {
        for (int j = i; j < N; j++) {
            Real rest = k.bb[i][j] - (j < 2 ? k.db[j][i] : k.db[j][i] - h * k.db[j - 2][i]);
            s[i][j] = s[j][i] =
                rest - (w[i][0] * g[0][j] + w[i][1] * g[1][j] + (w[i][2] * g[2][j] + w[i][3] * g[3][j]));
        }
        carried.r[i] = k.f[1][i] - (g[0][i] * r[0] + g[1][i] * r[1] + (g[2][i] * r[2] + g[3][i] * r[3]));
    }
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
