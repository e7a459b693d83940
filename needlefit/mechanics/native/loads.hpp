// The tissue's load on a bent needle, and the forces of the supports that balance it (docs/model.md, section 3).
#pragma once

#include "beam.hpp"

namespace needlefit {

// A needle as it stands: nodes of the chain, and constraint points. P is the number of planes.
struct BentNeedle {
    Index nodes, cells;
    const double *x, *u, *slope;  // (nodes), and (P, nodes) each
    const double* constraints;    // (cells + 1, 1 + P) depth and place
};

// The same, to be read as vectors.
template <class Vector>
struct BentVectors {
    static constexpr int P = Traits<Vector>::planes;
    const BentNeedle& bent;
    Index nodes = bent.nodes, cells = bent.cells;

    double depth(Index m) const { return bent.constraints[(1 + P) * m]; }
    Vector y(Index m) const {
        Vector found{};
        for (int plane = 0; plane < P; plane++) part(found, plane) = bent.constraints[(1 + P) * m + 1 + plane];
        return found;
    }
    Vector sum(const double* n, Index e) const {
        Vector found{};
        for (int plane = 0; plane < P; plane++) {
            const double *u = bent.u + plane * nodes, *slope = bent.slope + plane * nodes;
            part(found, plane) = n[0] * u[e] + n[1] * slope[e] + n[2] * u[e + 1] + n[3] * slope[e + 1];
        }
        return found;
    }
};

// The load -k e g at a point s mm in the element that begins at node e; c is the cut there.
template <class Vector>
Vector evaluate_load(const BentVectors<Vector>& needle, const Layer<double>& layer, Index e, double s, Vector c) {
    const double* x = needle.bent.x;
    Hermite<double> shape(s - x[e], x[e + 1] - x[e]);
    Vector away = needle.sum(shape.n, e) - c, slope = needle.sum(shape.m, e);
    Seen<double> ignored;
    return -find_force(layer, away, &slope, ignored).value;
}

// The cut at a depth: of the constraint point that it belongs to, or linear between two.
template <class Vector>
Vector find_cut(const BentVectors<Vector>& needle, double s, double part) {
    bool linear = part == LINEAR_CUT;
    Index m = 0;
    if (!linear) {
        while (m < needle.cells && (1.0 - part) * needle.depth(m) + part * needle.depth(m + 1) < s) m++;
        return needle.y(m);
    }
    if (needle.cells == 0) return needle.y(0);
    m = 1;
    while (m < needle.cells && needle.depth(m) < s) m++;
    double along = (s - needle.depth(m - 1)) / (needle.depth(m) - needle.depth(m - 1));
    return needle.y(m - 1) + along * (needle.y(m) - needle.y(m - 1));
}

// Force and moment (nodes, 2) that must act on each node beside the load: what holds it, where something does;
// elsewhere nothing but rounding. Of one plane, the first of those of the needle. `grid` is that of the nodes in the tissue, `load` of its points.
inline void balance_nodes(const BentNeedle& needle, const Grid& grid, double rigidity, const double* load, double* out) {
    for (Index i = 0; i < 2 * needle.nodes; i++) out[i] = 0.0;
    Index front = needle.nodes - grid.nodes;
    for (Index i = 0; i + 1 < needle.nodes; i++) {
        double length = needle.x[i + 1] - needle.x[i];
        Element<double> k;
        k.add_bending(rigidity, length);
        double u0 = needle.u[i], t0 = needle.slope[i], u1 = needle.u[i + 1], t1 = needle.slope[i + 1];
        double away = u0 - u1 + length * t1, turn = t0 - t1;
        double force = k.k00 * away + k.k01 * turn, moment = k.k01 * away + k.k11 * turn;
        out[2 * i] += force, out[2 * i + 1] += moment;
        out[2 * i + 2] -= force, out[2 * i + 3] += length * force - moment;
        Index e = i + 1 - front;
        if (e < 0) continue;
        for (Index q = grid.first[e]; q < grid.first[e + 1]; q++) {
            Hermite<double> shape(grid.points[q].x - needle.x[i], length);
            for (Index j = 0; j < 4; j++) out[2 * i + j] -= grid.points[q].weight * load[q] * shape.n[j];
        }
    }
}

}  // namespace needlefit
