// What a problem must satisfy for the kernel to stay within its arrays, whose lengths Python and JavaScript compare
// with its sizes. Values of parameters are free: what is not finite gives the status NON_FINITE.
#pragma once

#include "derivatives.hpp"

namespace needlefit {

// `FAULTS` of mechanics/native.py describes each.
enum Fault : Index { SOUND, BAD_SIZE, BAD_MESH, BAD_STOP, BAD_GUIDES, BAD_COLUMN, BAD_OUTPUT, BAD_POINTS };

constexpr Index MAX_COUNT = 1 << 24;  // of nodes, guides, columns: sums and products stay far below overflow

INLINE bool within(Index value, Index low, Index high) { return value >= low && value <= high; }

inline Fault check_stop(const Problem& problem, const Stop& stop, Index cells) {
    bool good = stop.tip >= 0.0 && stop.tip <= problem.deepest + SAME_DEPTH_MM && within(stop.cell, 0, cells) &&
                within(stop.ray, 0, problem.rays - 1) && within(stop.bevel, 0, problem.bevels - 1) &&
                within(stop.inputs, 0, problem.inputs - 1);
    return good && (!(stop.flags & EXTRAPOLATES) || stop.cell >= 2) ? SOUND : BAD_STOP;
}
inline Fault check_stops(const Problem& problem) {
    Index cells = problem.cells();
    for (Index s = 0; s < problem.stop_count; s++)
        if (check_stop(problem, problem.stops[s], cells)) return BAD_STOP;
    return SOUND;
}

inline Fault check_columns(const Problem& problem) {
    Index layers = problem.layers, guides = problem.before_first[problem.inputs] + problem.within_first[problem.inputs];
    for (Index kind = 0; kind < COLUMN_KINDS; kind++) {
        Index first = problem.column_of[kind], count = 1;
        if (kind == MU || kind == FRICTION) count = layers;
        if (kind == SHAPE) count = layers * problem.shapes;
        if (kind == BOUNDARY) count = layers - 1;
        if (first != -1 && !within(first, 0, problem.columns - count)) return BAD_COLUMN;
    }
    for (Index i = 0; i < problem.guide_size() * guides; i++)
        if (!within(problem.guide_columns[i], -1, problem.columns - 1)) return BAD_COLUMN;
    return SOUND;
}

inline Fault check_problem(const Problem& p) {
    bool sizes = within(p.planes, 1, 2) && p.sets > 0 && within(p.layers, 1, MAX_COUNT) && within(p.shapes, 0, MAX_SHAPES) &&
                 within(p.terms, 0, MAX_COUNT) && p.numbers == (p.terms > 0 ? 2 * p.terms : TABLE_NUMBERS) &&
                 p.stop_count > 0 && within(p.rays, 1, MAX_COUNT) && within(p.guides, 0, MAX_COUNT) &&
                 within(p.columns, 0, MAX_COUNT) && within(p.max_iterations, 0, MAX_COUNT) && p.bevels > 0 && p.inputs > 0;
    if (!sizes) return BAD_SIZE;
    bool mesh = p.element > 0.0 && p.spacing >= 0.5 * p.element && p.spacing > SAME_DEPTH_MM &&
                p.first_cell > SAME_DEPTH_MM && p.deepest >= 0.0 &&
                (p.deepest + p.first_cell + 2.0 * p.spacing) / p.element < MAX_COUNT && is_finite(p.length) &&
                absolute(p.per_cell() * p.element - p.spacing) <= 1e-9 * p.spacing &&
                (p.part == LINEAR_CUT || (p.part >= 0.0 && p.part <= 1.0));
    for (Index i = 0; i < p.sets * (p.layers - 1); i++)  // a layer may have no extent
        mesh = mesh && p.boundaries[i] >= (i % (p.layers - 1) > 0 ? p.boundaries[i - 1] : 0.0) && is_finite(p.boundaries[i]);
    if (!mesh) return BAD_MESH;
    if (p.before_first[0] != 0 || p.within_first[0] != 0) return BAD_GUIDES;
    for (Index i = 0; i < p.inputs; i++) {
        Index before = p.count_before(i), within_tissue = p.count_within(i);
        if (before < 0 || within_tissue < 0 || before + within_tissue > p.guides) return BAD_GUIDES;
    }
    if (Fault fault = check_stops(p)) return fault;
    return p.columns > 0 ? check_columns(p) : SOUND;
}

// Depths or nodes that are finite and increase.
inline bool increase(const double* values, Index count, Index stride = 1) {
    for (Index i = 0; i < count; i++)
        if (!is_finite(values[i * stride]) || (i > 0 && !(values[i * stride] > values[(i - 1) * stride]))) return false;
    return true;
}

// Constraint points at given depths (cells + 1), the last under the tip.
inline Fault check_depths(const Problem& problem, const double* depths, Index cells, Index stride = 1) {
    bool good = within(cells, 0, problem.cells()) && increase(depths, cells + 1, stride) && depths[0] >= 0.0;
    return good && depths[cells * stride] <= problem.deepest + SAME_DEPTH_MM ? SOUND : BAD_POINTS;
}

}  // namespace needlefit
