// The mesh of one stop and its quadrature (docs/model.md, sections 3 and 4): where nodes, constraint points and
// quadrature points lie. The same for all lanes.
#pragma once

#include "real.hpp"

namespace needlefit {

constexpr double GAUSS_OFFSET = 0.28867513459481287;  // two Gauss points stand at 1/2 -+ this of an interval
constexpr double SAME_DEPTH_MM = 1e-9;                // depths nearer than this are the same
constexpr double GUIDE_ENGAGEMENT_MM = 0.05;          // a guide in the tissue holds once the tip is this far past it
constexpr double LINEAR_CUT = -1.0;                   // in place of `switch`: the cut is linear between its points

// Depths of constraint points: 0, first_cell, and every spacing from there.
struct Lattice {
    double first_cell, spacing;

    // The number of the constraint point at `depth`, or of the next deeper one.
    Index cell(double depth) const {
        if (depth <= SAME_DEPTH_MM) return 0;
        double cells = __builtin_ceil((depth - first_cell - SAME_DEPTH_MM) / spacing);
        return 1 + (cells > 0.0 ? Index(cells) : 0);
    }
    double depth(Index cell) const { return cell == 0 ? 0.0 : first_cell + (cell - 1) * spacing; }
};

// The four cubic Hermite functions of an element at a point x from its beginning, and their slopes.
template <class Real>
struct Hermite {
    Real n[4], m[4];

    INLINE Hermite() = default;
    INLINE Hermite(Real x, Real length) {
        Real s = x / length, r = 1.0 - s;
        n[0] = 1.0 - s * s * (3.0 - 2.0 * s), n[1] = x * r * r;
        n[2] = s * s * (3.0 - 2.0 * s), n[3] = x * s * (s - 1.0);
        m[0] = -6.0 * s * r / length, m[1] = r * (1.0 - 3.0 * s);
        m[2] = -m[0], m[3] = s * (3.0 * s - 2.0);
    }

    // Their change per unit of what moves x by `drift` and the element's length by `grows`.
    static INLINE Hermite change(Real x, Real length, double drift, double grows) {
        Real s = x / length, r = 1.0 - s, by_s = drift * 6.0 * s * r / length, square = length * length;
        Hermite found;
        found.n[2] = by_s - grows * 6.0 * s * s * r / length, found.n[0] = -found.n[2];
        found.n[1] = drift * r * (1.0 - 3.0 * s) + grows * 2.0 * s * s * r;
        found.n[3] = drift * s * (3.0 * s - 2.0) + grows * s * s * (1.0 - 2.0 * s);
        found.m[0] = drift * (12.0 * s - 6.0) / square + grows * 6.0 * s * (2.0 - 3.0 * s) / square;
        found.m[1] = (drift * (6.0 * s - 4.0) + grows * s * (4.0 - 6.0 * s)) / length;
        found.m[2] = -found.m[0], found.m[3] = (drift * (6.0 * s - 2.0) + grows * s * (2.0 - 6.0 * s)) / length;
        return found;
    }
};

// A quadrature point.
struct Point {
    Hermite<double> shape;   // of its element; not of element 0, whose length may change from lane to lane
    double x, weight;        // mm
    double share, rate;      // of a linear cut: how much of the way to `other` it has gone there, and d share / dx
    int layer, near, other;  // the constraint point that it belongs to, and the one at the other end of its cell
};

// Element e ends at node e; element 0 reaches from the last node before the tissue to node 0.
struct Grid {
    Index nodes;
    double* x;      // (nodes) depth, the tip last
    Index* first;   // (nodes + 1) first quadrature point of each element
    Point* points;  // sorted by depth

    static Index count_points(Index nodes, Index layers, Index cells) { return 2 * (nodes + layers + 2 * cells + 2); }
};

INLINE Index count_below(const double* values, Index count, double bound) {
    Index low = 0, high = count;
    while (low < high) {
        Index middle = (low + high) / 2;
        if (values[middle] < bound)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

// Fill `x` with the nodes in the tissue for a tip at `tip`; return their number.
//
// Nodes stand every `element` before and after x_1. Short elements ruin the conditioning: a node is left out if it is
// nearer than half an element to the tip or a quarter to one of the `guides` in the tissue that hold the needle, and
// the entry has a node only if the next one is at least half an element away.
inline Index place_nodes(double* x, double tip, Lattice lattice, double element, const double* guides, Index held) {
    Index per_cell = Index(lattice.spacing / element + 0.5);
    Index i = 1 - Index(__builtin_ceil((lattice.first_cell - SAME_DEPTH_MM) / element));  // counted from x_1
    Index count = 1, guide = 0;                                                           // room for the entry
    for (;; i++) {
        Index cell = (i > 0 ? i : 0) / per_cell;
        double here = lattice.first_cell + cell * lattice.spacing + (i - cell * per_cell) * element;
        if (here > tip - 0.5 * element + SAME_DEPTH_MM) break;
        while (guide < held && guides[guide] < here) x[count++] = guides[guide++];
        bool near = (guide < held && guides[guide] - here < 0.25 * element) ||
                    (guide > 0 && here - guides[guide - 1] < 0.25 * element);
        if (!near) x[count++] = here;
    }
    while (guide < held) x[count++] = guides[guide++];
    x[count++] = tip;
    if (x[1] >= (0.5 - SAME_DEPTH_MM) * element) {
        x[0] = 0.0;
        return count;
    }
    for (Index n = 1; n < count; n++) x[n - 1] = x[n];
    return count - 1;
}

// Place the quadrature points of a grid whose nodes stand.
//
// Every interval lies in one element and one layer, and belongs to one constraint point: beyond `part` of the way to
// the next one (0.5: the nearest) to that. With LINEAR_CUT it belongs to the nearest, and lies in one cell. `depth_of`
// gives the depth of constraint points, of which there are `cells` + 1.
template <class DepthOf>
void place_points(Grid& grid, DepthOf depth_of, Index cells, const double* boundaries, Index layers, double part) {
    bool linear = part == LINEAR_CUT, next_cell = true;  // whether a lies at or beyond the point `near`
    if (linear) part = 0.5;
    Index count = grid.nodes, points = 0, layer = 0, near = 0, element = 0;
    grid.first[0] = 0;
    while (element < count && grid.x[element] <= 0.0) grid.first[++element] = 0;  // an entry node ends no tissue
    while (layer < layers - 1 && boundaries[layer] <= 0.0) layer++;
    double a = 0.0;
    while (element < count) {
        double change = __builtin_inf();
        if (near < cells) change = (1.0 - part) * depth_of(near) + part * depth_of(near + 1);
        if (linear && !next_cell) change = depth_of(near);
        double b = grid.x[element] < change ? grid.x[element] : change;
        if (layer < layers - 1 && boundaries[layer] < b) b = boundaries[layer];
        double length = b - a;
        if (length > 0.0)  // a boundary may lie on a node or on a change of constraint
            for (double side = -1.0; side < 2.0; side += 2.0) {
                Point& point = grid.points[points++];
                point.x = 0.5 * (a + b) + side * GAUSS_OFFSET * length;
                point.weight = 0.5 * length;
                point.layer = int(layer), point.near = point.other = int(near);
                point.share = point.rate = 0.0;
                if (linear && cells > 0) {
                    point.other += next_cell ? 1 : -1;
                    point.rate = 1.0 / (depth_of(point.other) - depth_of(near));
                    point.share = (point.x - depth_of(near)) * point.rate;
                }
            }
        a = b;
        if (b >= change) {
            if (next_cell) near++;
            next_cell = !(linear && next_cell);
        }
        if (layer < layers - 1 && b >= boundaries[layer]) layer++;
        if (b >= grid.x[element]) grid.first[++element] = points;
    }
    for (Index e = 1; e < count; e++)
        for (Index q = grid.first[e]; q < grid.first[e + 1]; q++)
            grid.points[q].shape = {grid.points[q].x - grid.x[e - 1], grid.x[e] - grid.x[e - 1]};
}

}  // namespace needlefit
