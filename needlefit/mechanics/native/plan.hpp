// The stops of a needle's moves: where the tip halts, and which ray cuts its path there. They depend on depths and on
// changes of the inputs, never on the solution.
#pragma once

#include "needle.hpp"

namespace needlefit {

// A step: the depth it leads to (mm), and numbers that identify its inputs.
struct Move {
    double depth;
    Index bevel, inputs;
};

// Where a plan has come to: the last stop, the inputs of the last move, and whether inputs have changed since the tip
// came to this depth.
struct Position {
    double tip;
    Index begun, cell, permanent, rays, bevel, inputs, changed;
};

// A ray that the tip has cut, from `start` mm on, and the inputs under which it began.
struct CutRay {
    double start;
    Index bevel, inputs;
};

INLINE bool same(double depth, double other) { return absolute(depth - other) <= SAME_DEPTH_MM; }

// Bring the position to where a move leads; `halt` receives each stop on the way, the last one at the move's depth.
// Of `rays` no more than `room` are written.
template <class Halt>
void plan_move(Position& position, const Move& move, Lattice lattice, CutRay* rays, Index room, Halt halt) {
    auto ray = [&](Index number) { return rays[number < room ? number : room - 1]; };
    auto stop = [&](double depth, Index flags) {
        position.cell = lattice.cell(depth);
        double point = lattice.depth(position.cell);
        position.permanent = same(point, depth), position.tip = position.permanent ? point : depth;
        Index number = position.rays > 0 ? position.rays - 1 : 0, bevel = position.rays > 0 ? ray(number).bevel : move.bevel;
        halt(Stop{position.tip, position.cell, number, bevel, move.inputs, flags + position.permanent * PERMANENT});
    };
    auto alike = [&](const auto& one) { return one.bevel == move.bevel && one.inputs == move.inputs; };
    if (!position.begun) {
        stop(0.0, 0);
        position.begun = 1, position.bevel = move.bevel, position.inputs = move.inputs;
    }
    bool held = position.inputs == move.inputs, changed = position.changed || !alike(position);
    double here = position.tip;
    if (move.depth > here + SAME_DEPTH_MM) {
        // A cell goes on along its ray unless something has changed; at a constraint point a new cell begins.
        bool begins = position.rays == 0 || position.permanent || changed || !alike(ray(position.rays - 1));
        if (begins && !held) stop(here, 0);
        while (move.depth > position.tip + SAME_DEPTH_MM) {
            Index flags = 0, number = position.rays;
            if (begins) {
                flags = STARTS_RAY;
                // It follows a whole cell that was cut under the same inputs.
                if (position.permanent && number > 0 && position.cell > 0 && alike(ray(number - 1)) &&
                    same(lattice.depth(position.cell - 1), ray(number - 1).start) &&
                    absolute(position.tip - ray(number - 1).start - lattice.spacing) <= 2.0 * SAME_DEPTH_MM)
                    flags += EXTRAPOLATES;
                if (number < room) rays[number] = {position.tip, move.bevel, move.inputs};
                position.rays++;
            }
            double end = lattice.depth(position.cell + position.permanent);
            stop(end < move.depth ? end : move.depth, flags);
            begins = true;
        }
    } else if (move.depth < here - SAME_DEPTH_MM) {
        // A retraction drops the rays that begin beyond the new depth; the tip then stands on the last one left.
        while (position.rays > 0 && ray(position.rays - 1).start >= move.depth - SAME_DEPTH_MM) position.rays--;
        stop(move.depth, 0);
    } else if (!held) {
        stop(here, 0);
    }
    position.changed = changed && same(move.depth, here);
    position.bevel = move.bevel, position.inputs = move.inputs;
}

}  // namespace needlefit
