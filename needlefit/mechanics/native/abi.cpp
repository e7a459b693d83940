// The C interface of the kernel: structures of pointers and counts, no state of its own, no memory of its own. What
// computes begins with a `DefaultArithmetic`, and every NaN that it writes is canonical.
#include "checks.hpp"
#include "environment.hpp"
#include "loads.hpp"
#include "plan.hpp"
#include "processor.hpp"
#include "shape.hpp"

using namespace needlefit;

#ifndef NEEDLEFIT_LANES
#define NEEDLEFIT_LANES 8
#endif
constexpr int LANES = NEEDLEFIT_LANES;
#define EXPORT extern "C" __attribute__((visibility("default")))

// Where shapes go: (S, room) arrays for nodes, (S, cells) for constraint points of the last stop.
struct Shapes {
    Index room, points;
    double *x, *u, *slope;  // (S, room), (P, S, room) of the chain's nodes, base first; P is the number of planes
    double* constraints;    // (S, points, 1 + P) depth and place
    double* track;          // (S, points, P, 2)
    Index* status;          // (S)
    Index* passes;          // (S)
    Index* nodes;           // (1) nodes of the chain
    double *u_by, *slope_by;           // (P, S, room, columns); all null where no derivative is asked for
    double *constraints_by, *track_by;  // (P, S, points, columns) of the place, and of the tip's deflection, or null
};

// Call `work` with a vector of the problem's planes, of one needle.
template <class Work>
auto choose_planes(const Problem& problem, Work work) {
    return problem.planes == 2 ? work(Pair<double>()) : work(double());
}
// The same, of one needle or as many as there are lanes.
template <class Work>
auto choose_vector(Index planes, Index lanes, Work work) {
    using Lanes = LanesOf<LANES>::Vector;
    if (lanes == 1) return planes == 2 ? work(Pair<double>()) : work(double());
    return planes == 2 ? work(Pair<Lanes>()) : work(Lanes());
}

template <class Vector>
Index lay_out(Insertion<Vector>& insertion, Derivatives<Vector>& derivatives, char* memory) {
    Arena arena{memory, memory != nullptr};
    insertion.lay_out_fixed(arena), insertion.lay_out_state(arena), insertion.lay_out_scratch(arena);
    if (insertion.problem.columns > 0) derivatives.lay_out(arena);
    return arena.at - memory;
}

template <class Vector>
void write_shapes(const Insertion<Vector>& insertion, const Shapes& out) {
    using Real = Scalar<Vector>;
    constexpr Index P = Traits<Vector>::planes;
    const Problem& problem = insertion.problem;
    Index front = insertion.front, count = insertion.progress->nodes;
    Lattice lattice = problem.lattice();
    *out.nodes = front + count;
    for (int lane = 0; lane < Traits<Real>::lanes && insertion.set + lane < problem.sets; lane++) {
        Index set = insertion.set + lane;
        auto lane_of = [&](const Real& value) { return canonical(get_lane(value, lane)); };
        bool good = lane_of(*insertion.status) == 0.0;
        auto value = [&](const Real& number) { return good ? lane_of(number) : NOT_A_NUMBER; };
        out.status[set] = Index(lane_of(*insertion.status)), out.passes[set] = Index(lane_of(*insertion.passes));
        for (Index i = 0; i < front + count; i++) {
            const Node<Vector>& node = i < front ? insertion.fronts[i] : insertion.states[insertion.progress->now][i - front];
            Index at = set * out.room + i;
            out.x[at] = i < front ? lane_of(insertion.front_x[i]) : insertion.nodes[i - front];
            for (int plane = 0; plane < P; plane++, at += problem.sets * out.room)
                out.u[at] = value(part(node.u, plane)), out.slope[at] = value(part(node.slope, plane));
        }
        for (Index m = 0; m < out.points; m++) {
            Index at = set * out.points + m;
            double *point = out.constraints + (1 + P) * at, *tip = out.track + 2 * P * at;
            const Node<Vector>& stood = insertion.track[m];
            point[0] = m + 1 < out.points ? lattice.depth(m) : insertion.progress->tip;
            for (int plane = 0; plane < P; plane++) {
                point[1 + plane] = lane_of(part(insertion.y[m], plane));
                tip[2 * plane] = lane_of(part(stood.u, plane)), tip[2 * plane + 1] = lane_of(part(stood.slope, plane));
            }
        }
    }
}

template <class Vector>
void write_derivatives(const Derivatives<Vector>& derivatives, const Shapes& out) {
    using Real = Scalar<Vector>;
    constexpr Index P = Traits<Vector>::planes;
    const Insertion<Vector>& insertion = derivatives.needle;
    Index columns = derivatives.columns, count = derivatives.tip_node() + 1, sets = insertion.problem.sets;
    for (int lane = 0; lane < Traits<Real>::lanes && insertion.set + lane < insertion.problem.sets; lane++) {
        Index set = insertion.set + lane;
        bool good = get_lane(*insertion.status, lane) == 0.0;
        auto value = [&](const Real& number) { return good ? canonical(get_lane(number, lane)) : NOT_A_NUMBER; };
        for (Index i = 0; i < count; i++)
            for (Index p = 0; p < columns; p++) {
                const Vector& u = derivatives.whole[2 * i * columns + p];
                const Vector& slope = derivatives.whole[(2 * i + 1) * columns + p];
                for (Index plane = 0; plane < P; plane++) {
                    Index at = ((plane * sets + set) * out.room + i) * columns + p;
                    out.u_by[at] = value(part(u, int(plane))), out.slope_by[at] = value(part(slope, int(plane)));
                }
            }
        for (Index m = 0; m < out.points; m++)
            for (Index p = 0; p < columns; p++) {
                const Vector& point = derivatives.constraints[m * columns + p];
                const Vector& tip = derivatives.track[2 * m * columns + p];
                for (Index plane = 0; plane < P; plane++) {
                    Index at = ((plane * sets + set) * out.points + m) * columns + p;
                    out.constraints_by[at] = value(part(point, int(plane)));
                    if (out.track_by) out.track_by[at] = value(part(tip, int(plane)));
                }
            }
    }
}

template <class Vector>
Fault simulate(const Problem& problem, Index first, char* memory, const Shapes& out) {
    Insertion<Vector> insertion(problem);
    Derivatives<Vector> derivatives(insertion);
    insertion.set = first;
    lay_out(insertion, derivatives, memory);
    insertion.prepare(), insertion.begin();
    if (problem.columns > 0) derivatives.begin(out.track_by);
    for (Index s = 0; s < problem.stop_count; s++) {
        if (problem.columns > 0)
            derivatives.advance(problem.stops[s], s + 1 == problem.stop_count);
        else
            insertion.advance(problem.stops[s]);
    }
    if (insertion.front + insertion.progress->nodes > out.room) return BAD_OUTPUT;
    write_shapes(insertion, out);
    if (problem.columns > 0) write_derivatives(derivatives, out);
    return SOUND;
}

template <class Vector>
Index measure(const Problem& problem) {
    Insertion<Vector> insertion(problem);
    Derivatives<Vector> derivatives(insertion);
    return lay_out(insertion, derivatives, nullptr);
}

inline Fault check_output(const Problem& problem, const Shapes& out) {
    bool good = within(out.points, 0, problem.cells() + 1) && (problem.columns == 0 || out.u_by);
    return good ? SOUND : BAD_OUTPUT;
}

EXPORT Index nf_abi_version() { return 4; }
EXPORT Index nf_lanes() { return LANES; }
EXPORT Index nf_processor_level() { return find_processor_level(); }

// ---- many insertions ------------------------------------------------------------------------------------------------

// What is wrong with a problem (0: nothing), and its sizes: nodes of a chain, constraint points, quadrature points.
EXPORT Index nf_check(const Problem* problem, Index* sizes) {
    DefaultArithmetic arithmetic;
    if (Fault fault = check_problem(*problem)) return fault;
    sizes[0] = Insertion<double>(*problem).chain(), sizes[1] = problem->cells() + 1, sizes[2] = problem->points(1);
    return SOUND;
}

// How many nodes the chain has at the last stop; `x` has room for those of any.
EXPORT Index nf_nodes(const Problem* problem, double* x) {
    DefaultArithmetic arithmetic;
    Insertion<double> needle(*problem);
    needle.own_grid.x = x;
    const Stop& stop = problem->stops[problem->stop_count - 1];
    return 1 + problem->count_before(stop.inputs) + needle.place_nodes_at(stop.tip, stop.inputs);
}

// Bytes that a block of `lanes` sets needs, aligned to 64.
EXPORT Index nf_memory(const Problem* problem, Index lanes) {
    DefaultArithmetic arithmetic;
    return choose_vector(problem->planes, lanes, [&](auto vector) { return measure<decltype(vector)>(*problem); });
}

// Insert the needles of the sets from `first` on: so many as there are lanes, or one. Returns what is wrong.
EXPORT Index nf_simulate(const Problem* problem, Index first, Index lanes, char* memory, const Shapes* out) {
    DefaultArithmetic arithmetic;
    if (Fault fault = check_output(*problem, *out)) return fault;
    return choose_vector(problem->planes, lanes, [&](auto vector) {
        return simulate<decltype(vector)>(*problem, first, memory, *out);
    });
}

// The stops of some moves from first contact on, for a lattice of constraint points; `rays` and `stops` have room for so
// many. Returns how many there are.
EXPORT Index nf_plan(
    double first_cell, double spacing, const Move* moves, Index count, CutRay* rays, Stop* stops, Index room
) {
    Position position{};
    Index found = 0;
    auto halt = [&](const Stop& stop) {
        if (found < room) stops[found] = stop;
        found++;
    };
    for (Index m = 0; m < count; m++) plan_move(position, moves[m], {first_cell, spacing}, rays, room, halt);
    return found;
}

// ---- one needle, step by step ---------------------------------------------------------------------------------------

// A session keeps three pieces of memory: what never changes, the state of the needle, and room to work in.
template <class Vector>
struct Session : Insertion<Vector> {
    using Base = Insertion<Vector>;
    using Base::problem, Base::constants, Base::main, Base::progress, Base::cut, Base::status, Base::passes, Base::stale;
    using Base::super, Base::fronts, Base::front_x, Base::nodes, Base::y, Base::track, Base::states, Base::past, Base::pulls;
    using Base::rays;
    Position* position;
    CutRay* cut_rays;
    Stop* stops;  // of one move

    explicit Session(const Problem& problem) : Base(problem) {}
    Session(const Problem& problem, char* fixed, char* state, char* scratch) : Session(problem) {
        Arena arena{fixed};
        this->lay_out_fixed(arena);
        arena.at = state, lay_out_state(arena);
        arena.at = scratch, lay_out_scratch(arena);
    }
    Index most_stops() const { return problem.cells() + 4; }
    void lay_out_state(Arena& arena) {
        Base::lay_out_state(arena);
        position = arena.take<Position>(1), cut_rays = arena.take<CutRay>(problem.rays);
    }
    void lay_out_scratch(Arena& arena) {
        Base::lay_out_scratch(arena);
        stops = arena.take<Stop>(most_stops());
    }
    // Become as another session of the same sizes, or of fewer rays: what it has in use, for all of it takes longer to
    // copy than a step to make.
    void copy(const Session& other) {
        main.nodes = constants->nodes;
        auto copy = [](auto* to, const auto* from, Index count) { __builtin_memcpy(to, from, count * sizeof(*to)); };
        copy(progress, other.progress, 1), copy(position, other.position, 1);
        copy(cut, other.cut, 1), copy(status, other.status, 1), copy(passes, other.passes, 1);
        copy(stale, other.stale, 1), copy(super, other.super, 1);
        copy(fronts, other.fronts, problem.guides + 1), copy(front_x, other.front_x, problem.guides + 1);
        copy(nodes, other.nodes, progress->nodes);
        copy(y, other.y, problem.cells() + 1), copy(track, other.track, problem.cells() + 1);
        Index used = progress->nodes > progress->older_nodes ? progress->nodes : progress->older_nodes;
        for (int i = 0; i < 2; i++) copy(states[i], other.states[i], used);
        copy(past, other.past, progress->condensed + 1), copy(pulls, other.pulls, main.first[progress->condensed + 1]);
        copy(rays, other.rays, position->rays), copy(cut_rays, other.cut_rays, position->rays);
    }
};
EXPORT void nf_session_memory(const Problem* problem, Index* bytes) {
    DefaultArithmetic arithmetic;
    choose_planes(*problem, [&](auto vector) {
        Session<decltype(vector)> session(*problem);
        Arena arena{nullptr};
        session.lay_out_fixed(arena), bytes[0] = arena.at - static_cast<char*>(nullptr);
        arena.at = nullptr, session.lay_out_state(arena), bytes[1] = arena.at - static_cast<char*>(nullptr);
        arena.at = nullptr, session.lay_out_scratch(arena), bytes[2] = arena.at - static_cast<char*>(nullptr);
    });
}
EXPORT void nf_session_begin(const Problem* problem, char* fixed, char* state, char* scratch) {
    DefaultArithmetic arithmetic;
    choose_planes(*problem, [&](auto vector) {
        Session<decltype(vector)> session(*problem, fixed, state, scratch);
        session.prepare(), session.begin(), *session.position = {};
    });
}
// Move the tip to a depth, from the state `from` to the state `to`; the problem holds the inputs there,
// `bevel` and `inputs` identify them. `done` receives the number of stops, of constraint points, and of rays. Returns
// what is wrong: BAD_STOP where the problem has less room than that.
template <class Vector>
Index advance_session(
    const Problem* problem, char* fixed, char* from, char* to, char* scratch, const Shapes* out, double depth,
    Index bevel, Index inputs, Index* done
) {
    Session<Vector> session(*problem, fixed, to, scratch);
    session.copy(Session<Vector>(*problem, fixed, from, scratch));
    Index count = 0, room = session.most_stops();
    if (!(depth >= 0.0 && depth <= problem->deepest + SAME_DEPTH_MM)) return BAD_STOP;
    auto halt = [&](Stop stop) {
        stop.bevel = stop.inputs = 0;  // those that the problem holds
        if (count < room) session.stops[count] = stop;
        count++;
    };
    plan_move(
        *session.position, Move{depth, bevel, inputs}, problem->lattice(), session.cut_rays, problem->rays, halt
    );
    done[0] = count, done[1] = session.position->cell + 1, done[2] = session.position->rays;
    if (count > room || session.position->rays > problem->rays) return BAD_STOP;
    Shapes shapes = *out;
    shapes.points = done[1];
    if (out->points < shapes.points || check_output(*problem, shapes)) return BAD_OUTPUT;
    for (Index s = 0; s < count; s++) session.advance(session.stops[s]);
    if (count > 0 && session.front + session.progress->nodes > shapes.room) return BAD_OUTPUT;
    if (count > 0) write_shapes<Vector>(session, shapes);
    return SOUND;
}
EXPORT Index nf_session_advance(
    const Problem* problem, char* fixed, char* from, char* to, char* scratch, const Shapes* out, double depth,
    Index bevel, Index inputs, Index* done
) {
    DefaultArithmetic arithmetic;
    return choose_planes(*problem, [&](auto vector) {
        return advance_session<decltype(vector)>(problem, fixed, from, to, scratch, out, depth, bevel, inputs, done);
    });
}
// The rays of a state (their number), written to `rays`, which has room for as many as the problem; and the position.
EXPORT Index nf_session_rays(const Problem* problem, char* fixed, char* state, char* scratch, CutRay* rays, Position* position) {
    return choose_planes(*problem, [&](auto vector) {
        Session<decltype(vector)> session(*problem, fixed, state, scratch);
        *position = *session.position;
        for (Index n = 0; n < position->rays; n++) rays[n] = session.cut_rays[n];
        return position->rays;
    });
}
// Copy a state to that of a problem with room for as many rays or more; otherwise the problems are alike.
EXPORT void nf_session_copy(
    const Problem* problem, const Problem* larger, char* fixed, char* state, char* scratch, char* larger_state,
    char* larger_scratch
) {
    choose_planes(*problem, [&](auto vector) {
        using One = Session<decltype(vector)>;
        One(*larger, fixed, larger_state, larger_scratch).copy(One(*problem, fixed, state, scratch));
    });
}

// ---- one equilibrium ------------------------------------------------------------------------------------------------

// Nodes in the tissue, which a grid of the problem has room for.
inline bool are_nodes(const Problem& problem, const double* nodes, Index count) {
    return within(count, 1, problem.nodes()) && increase(nodes, count);
}

// The equilibrium of a needle with its tip at `depths[cells]` against given constraint points (cells + 1), from the
// guess `state` (room, 2, P), which the answer replaces; `x` receives the nodes. `y` (cells + 1, P) are the places of the
// points; `target` (points of quadrature, P) takes their place where it is not null. Returns the number of nodes, or -1
// for points that are none.
template <class Vector>
Index find_equilibrium(
    const Problem* problem, Index cells, const double* depths, double* y, Index targets, double* target, double* state,
    char* memory, double* x, Index* status
) {
    constexpr int P = Traits<Vector>::planes;
    if (check_depths(*problem, depths, cells)) return -1;
    Insertion<Vector> needle(*problem);
    Arena arena{memory, true};
    needle.lay_out_fixed(arena), needle.lay_out_state(arena), needle.lay_out_scratch(arena);
    needle.prepare(), needle.begin();
    needle.make_grid(depths[cells], 0, cells, [&](Index m) { return depths[m]; });
    needle.hold(0, depths[cells]);
    needle.y = reinterpret_cast<Vector*>(target ? target : y);
    Index points = needle.grid->first[needle.grid->nodes];
    if (target && targets != points) return -1;
    if (target)
        for (Index q = 0; q < points; q++) {
            Point& point = needle.own_grid.points[q];
            point.near = point.other = int(q), point.share = 0.0;
        }
    Index size = needle.front + needle.last + 1;
    auto node_at = [&](Index i) -> Node<Vector>& {
        return i < needle.front ? needle.fronts[i] : needle.states[1][i - needle.front];
    };
    auto number = [&](Index i, int j) -> double& {
        return part(j < P ? node_at(i).u : node_at(i).slope, j % P);
    };
    for (Index i = 0; i < size; i++) {
        for (int j = 0; j < 2 * P; j++) number(i, j) = state[2 * P * i + j];
        x[i] = i < needle.front ? needle.front_x[i] : needle.grid->x[i - needle.front];
    }
    needle.constants->friction ? needle.template equilibrate<true>(true) : needle.template equilibrate<false>(true);
    for (Index i = 0; i < size; i++)
        for (int j = 0; j < 2 * P; j++) state[2 * P * i + j] = number(i, j);
    make_canonical(state, 2 * P * size);
    status[0] = Index(*needle.status), status[1] = Index(*needle.passes);
    return size;
}
EXPORT Index nf_equilibrium(
    const Problem* problem, Index cells, const double* depths, double* y, Index targets, double* target, double* state,
    char* memory, double* x, Index* status
) {
    DefaultArithmetic arithmetic;
    return choose_planes(*problem, [&](auto vector) {
        return find_equilibrium<decltype(vector)>(
            problem, cells, depths, y, targets, target, state, memory, x, status
        );
    });
}

// The quadrature of a needle as it stands: place, weight, layer and constraint point of each point, and the number of
// points, -1 where nodes or points are none; `nodes` (N) are those in the tissue, `depths` (cells + 1).
EXPORT Index nf_quadrature(
    const Problem* problem, Index count, const double* nodes, Index cells, const double* depths, char* memory,
    double* x, double* weight, Index* layer, Index* near
) {
    DefaultArithmetic arithmetic;
    if (check_depths(*problem, depths, cells) || !are_nodes(*problem, nodes, count)) return -1;
    Arena arena{memory, true};
    Grid grid = take_grid(arena, *problem, 1);
    grid.nodes = count;
    for (Index i = 0; i < count; i++) grid.x[i] = nodes[i];
    auto depth_of = [&](Index m) { return depths[m]; };
    place_points(grid, depth_of, cells, problem->boundaries, problem->layers, problem->part);
    Index points = grid.first[count];
    for (Index q = 0; q < points; q++) {
        const Point& point = grid.points[q];
        x[q] = point.x, weight[q] = point.weight, layer[q] = point.layer, near[q] = point.near;
    }
    return points;
}

// ---- loads, laws, points, functions -----------------------------------------------------------------------------------

// The tissue's load (P, K) on a needle at beam coordinates s (K), 0 before the tissue.
EXPORT void nf_load(
    const Problem* problem, const BentNeedle* needle, Index wanted, const double* s, char* memory, double* out
) {
    DefaultArithmetic arithmetic;
    Insertion<double> insertion(*problem);
    Arena arena{memory};
    insertion.lay_out_fixed(arena), insertion.prepare();
    choose_planes(*problem, [&](auto vector) {
        using Vector = decltype(vector);
        BentVectors<Vector> bent{*needle};
        for (Index k = 0; k < wanted; k++) {
            Index layer = count_below(problem->boundaries, problem->layers - 1, s[k]);
            Index e = find_element(needle->x, needle->nodes, s[k]);
            Vector c = find_cut<Vector>(bent, s[k], problem->part), load{};
            if (!(s[k] < 0.0)) load = evaluate_load<Vector>(bent, insertion.layers[layer], e, s[k], c);
            for (int plane = 0; plane < bent.P; plane++) out[plane * wanted + k] = canonical(part(load, plane));
        }
    });
}

// Force and moment (P, nodes, 2) that hold a needle under the load (P, at the `points` of its quadrature), of which
// `front` nodes stand before the tissue. Returns what is wrong.
EXPORT Index nf_balance(
    const Problem* problem, const BentNeedle* needle, Index front, Index points, const double* load, char* memory,
    double* out
) {
    DefaultArithmetic arithmetic;
    if (!within(front, 1, needle->nodes - 1) || !are_nodes(*problem, needle->x + front, needle->nodes - front) ||
        check_depths(*problem, needle->constraints, needle->cells, 1 + problem->planes))
        return BAD_POINTS;
    Arena arena{memory, true};
    Grid grid = take_grid(arena, *problem, 1);
    grid.nodes = needle->nodes - front;
    for (Index i = 0; i < grid.nodes; i++) grid.x[i] = needle->x[front + i];
    auto depth_of = [&](Index m) { return needle->constraints[(1 + problem->planes) * m]; };
    place_points(grid, depth_of, needle->cells, problem->boundaries, problem->layers, problem->part);
    if (grid.first[grid.nodes] != points) return BAD_POINTS;
    for (Index plane = 0; plane < problem->planes; plane++) {
        BentNeedle one = *needle;
        one.u += plane * needle->nodes, one.slope += plane * needle->nodes;
        balance_nodes(one, grid, *problem->rigidity, load + plane * points, out + 2 * plane * needle->nodes);
    }
    make_canonical(out, 2 * problem->planes * needle->nodes);
    return SOUND;
}

// A layer's law at |e| (count) mm as the kernel evaluates it: k, d(k e)/de and, if `by` is not null, dk/dp of a shape
// parameter. `about` receives the |e| up to which the polynomial holds, the curvature and the polynomial (6).
EXPORT void nf_law(
    Index terms, const double* law, const double* by, double mu, double thickness, Index count, const double* size,
    double* k, double* tangent, double* slope, double* about
) {
    DefaultArithmetic arithmetic;
    Layer<double> layer;
    layer.law = {{law}, int(terms)};
    layer.mu = mu, layer.thickness = thickness, layer.friction = 0.0;
    layer.prepare();
    double series[SERIES_TERMS];
    if (by) fit_slope_series(series, layer.law, &by, mu, thickness, layer.limit);
    Seen<double> seen;
    for (Index i = 0; i < count; i++) {
        Modulus<double> found = evaluate_modulus(layer, size[i], seen);
        k[i] = found.value, tangent[i] = found.slope;
        if (by) slope[i] = evaluate_by_shape<double>(layer, series, &by, size[i]);
    }
    about[0] = layer.limit, about[1] = layer.curvature;
    for (int j = 0; j < SERIES_TERMS; j++) about[2 + j] = layer.series[j];
    make_canonical(k, count), make_canonical(tangent, count), make_canonical(about, 2 + SERIES_TERMS);
    if (by) make_canonical(slope, count);
}

// The compression up to which a polynomial serves for a table: what its second number has to be.
EXPORT void nf_table_range(const double* table, double* range) {
    DefaultArithmetic arithmetic;
    *range = canonical(measure_table_range(table));
}

// How many of the needles from `first` on can be computed side by side: those whose nodes are at the same x, or one.
Index count_alike(const double* x, Index needles, Index count, Index first) {
    Index here = needles - first < LANES ? needles - first : LANES, at = first * count;
    for (Index i = 0; i < here * count; i++)
        if (x[at + i] != x[at + i % count]) return 1;
    return here;
}

// The points (B, K, 1 + P) of B needles in P planes with nodes x (B, N), u and slope (P, B, N) at the same beam
// coordinates s (K). `memory` has room for (1 + 5 P) (N + 2) LANES numbers.
EXPORT void nf_positions(
    Index planes, Index needles, Index count, Index wanted, const double* x, const double* u, const double* slope,
    const double* s, char* memory, double* out
) {
    DefaultArithmetic arithmetic;
    for (Index first = 0, here; first < needles; first += here) {
        here = count_alike(x, needles, count, first);
        Index at = first * count;
        Arena arena{memory};
        choose_vector(planes, here, [&](auto vector) {
            using Vector = decltype(vector);
            compute_positions<Vector>(
                here, needles, count, wanted, x + at, u + at, slope + at, s, arena.take<ShapeNode<Vector>>(count),
                out + first * wanted * (1 + planes)
            );
        });
    }
    make_canonical(out, needles * wanted * (1 + planes));
}

// The deflections (K) of a needle with nodes (N), which are not the y of its points.
EXPORT void nf_deflections(
    Index count, Index wanted, const double* x, const double* u, const double* slope, const double* s, double* out
) {
    DefaultArithmetic arithmetic;
    for (Index k = 0; k < wanted; k++) {
        Index e = find_element(x, count, s[k]);
        Hermite<double> shape(s[k] - x[e], x[e + 1] - x[e]);
        const double* n = shape.n;
        out[k] = canonical(n[0] * u[e] + n[1] * slope[e] + n[2] * u[e + 1] + n[3] * slope[e + 1]);
    }
}

// The derivatives (B, K, 1 + P, columns) of the points of B needles in P planes, from those of their nodes: x_by
// (N, columns) of all of them, u_by and slope_by (P, B, N, columns). `memory` has room for LANES times what
// `compute_position_derivatives` needs, at a multiple of 64.
EXPORT void nf_position_derivatives(
    Index planes, Index needles, Index count, Index wanted, Index columns, const double* x, const double* u, const double* slope,
    const double* s, const double* x_by, const double* u_by, const double* slope_by, char* memory, double* out
) {
    DefaultArithmetic arithmetic;
    for (Index first = 0, here; first < needles; first += here) {
        here = count_alike(x, needles, count, first);
        Index at = first * count, at_by = at * columns;
        choose_vector(planes, here, [&](auto vector) {
            compute_position_derivatives<decltype(vector)>(
                here, needles, count, wanted, columns, x + at, u + at, slope + at, s, x_by, u_by + at_by,
                slope_by + at_by, memory, out + first * wanted * (1 + planes) * columns
            );
        });
    }
    make_canonical(out, needles * wanted * (1 + planes) * columns);
}

// Elementary functions, to be tested: 0 exponential, 1 logarithm, 2 ln(1 - x), 3 sine, 4 cosine; 5, 6 in lanes.
EXPORT void nf_function(Index which, Index count, const double* x, double* out) {
    DefaultArithmetic arithmetic;
    using Lanes = LanesOf<LANES>::Vector;
    for (Index i = 0; i < count; i++) {
        double sine = 0.0, cosine = 0.0;
        if (which >= 5) {
            Lanes sines, cosines;
            sine_cosine<Lanes>(all_lanes<Lanes>(x[i]), sines, cosines);
            sine = sines[LANES - 1], cosine = cosines[LANES - 1];
        } else if (which >= 3) {
            sine_cosine<double>(x[i], sine, cosine);
        }
        out[i] = which == 0   ? exponential(x[i])
                 : which == 1 ? logarithm(x[i])
                 : which == 2 ? logarithm_of_1_minus(x[i])
                 : which % 2  ? sine
                              : cosine;
    }
}
