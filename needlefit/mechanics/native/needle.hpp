// A needle that is inserted from stop to stop (docs/model.md, section 4): at each stop the tip cuts a constraint point,
// and the needle finds its equilibrium against all of them.
//
// All lanes are parameter sets of one insertion: depths, meshes and kinds of supports are the same. A lane whose
// iteration has ended keeps its bits while others go on, so no lane depends on another.
#pragma once

#include "past.hpp"

namespace needlefit {

// One stop of the tip; `mechanics/plan.py` describes each field. `flags`: 1 permanent, 2 starts a ray, 4 extrapolates.
struct Stop {
    double tip;
    Index cell, ray, bevel, inputs, flags;
};
// PAST: derivatives by base, guides and bevel are those of later stops alone.
enum StopFlags : Index { PERMANENT = 1, STARTS_RAY = 2, EXTRAPOLATES = 4, PAST = 8 };

// An insertion and its parameter sets, as Python hands them over. Arrays are in C order; S is `sets`.
struct Problem {
    Index planes;  // 1: y alone; 2: y and z, of which all arrays give y first. P is their number.
    Index sets, layers, shapes, terms, numbers, stop_count, bevels, inputs, rays, guides, columns, max_iterations;
    double length, first_cell, spacing, element, part, tangent, tolerance, deepest;
    const double* boundaries;  // (S, layers - 1) mm; derivatives are those at the boundaries of the first set
    const Stop* stops;
    const double* rigidity;            // (S) EI, N mm^2
    const double *mu, *thickness, *friction;  // (S, layers)
    const double* law;                 // (S, layers, numbers): see `Law`
    const double* law_by;              // (S, layers, shapes, numbers)
    const double* turn;                // (bevels, S, P) slope that the bevel adds to the cut
    const double* base;                // (inputs, S, P, 3) place, slope, slope of the stage's axis
    const Index *before_first, *within_first;  // (inputs + 1) into the guides before and in the tissue
    const double *before, *within;     // (guides, 1 + 2 P) x, and place and slope; slopes that are left free are NaN
    const double* held_tip;            // (inputs, P, 2) place and slope of a tracked tip; NaN where it is free
    const double* guide_x;             // (S) where the first guide before the tissue stands instead; may be null
    const double* turn_by;             // (bevels, S, P) derivative of `turn` with respect to the bevel's strength
    const Index* column_of;            // (COLUMN_KINDS) first column of each kind of parameter, -1: not asked for
    const Index* guide_columns;        // (guides of all inputs, 1 + 2 P), those before the tissue first

    Lattice lattice() const { return {first_cell, spacing}; }
    Index cells() const {
        Index count = lattice().cell(deepest);
        return count > 1 ? count : 1;
    }
    Index per_cell() const { return Index(spacing / element + 0.5); }
    // The same for all blocks, so that a set's bytes do not depend on those beside it.
    bool has_friction() const {
        for (Index i = 0; i < sets * layers; i++)
            if (friction[i] > 0.0) return true;
        return false;
    }
    // Room for the nodes in the tissue of any stop.
    Index nodes() const {
        return Index(__builtin_ceil((first_cell + (cells() + 1) * spacing) / element)) + guides + 4;
    }
    // Pieces of tissue into which the boundaries of so many sets divide a path.
    Index pieces(Index lanes) const { return columns > 0 ? layers : lanes * (layers - 1) + 1; }
    Index points(Index lanes) const { return Grid::count_points(nodes(), pieces(lanes), cells()); }
    Index guide_size() const { return 1 + 2 * planes; }
    const double* guide_before(Index inputs, Index i) const { return before + (before_first[inputs] + i) * guide_size(); }
    const double* guide_within(Index inputs, Index i) const { return within + (within_first[inputs] + i) * guide_size(); }
    Index count_before(Index inputs) const { return before_first[inputs + 1] - before_first[inputs]; }
    Index count_within(Index inputs) const { return within_first[inputs + 1] - within_first[inputs]; }
};

#ifdef __SANITIZE_ADDRESS__
extern "C" void __asan_poison_memory_region(const volatile void*, unsigned long);
extern "C" void __asan_unpoison_memory_region(const volatile void*, unsigned long);
constexpr Index GAP = 64;
#endif

// Memory that the caller owns, handed out piece by piece; from null it only counts. Under AddressSanitizer there is a gap
// behind each piece, which nothing may touch if the arena is `guarded`: its memory must then not be copied as a whole.
struct Arena {
    char* at;
    bool guarded = false;

    template <class T>
    T* take(Index count) {
        at = reinterpret_cast<char*>((reinterpret_cast<unsigned long long>(at) + 63) / 64 * 64);
        T* found = reinterpret_cast<T*>(at);
        at += count * Index(sizeof(T));
#ifdef __SANITIZE_ADDRESS__
        if (guarded) __asan_unpoison_memory_region(found, at - reinterpret_cast<char*>(found));
        if (guarded) __asan_poison_memory_region(at, GAP);
        at += GAP;
#endif
        return found;
    }
};

inline Grid take_grid(Arena& arena, const Problem& problem, Index lanes) {
    Index nodes = problem.nodes();
    return {0, arena.take<double>(nodes), arena.take<Index>(nodes + 1), arena.take<Point>(problem.points(lanes))};
}

// The straight path that the tip cuts, in all lanes.
template <class Vector>
struct Ray {
    Vector y, slope, turn;
    Scalar<Vector> start;  // depth where it begins, mm
};

enum Status : int { CONVERGED, OVER_COMPRESSED, NOT_CONVERGED, NON_FINITE };

constexpr int LIVE_CELLS = 3;      // linearised anew in every pass
constexpr int CHORD_PASSES = 2;    // with the tangents that are kept, before all are renewed
constexpr int RENEWED_NODES = 8;   // after so many nodes all lanes renew their tangents at the same stop
constexpr double CHORD_ERROR = 2.0;  // a chord step is off by so many times `curvature`, its increment and the distance
                                     // from where the tangent was taken, since the errors of all stops add up
constexpr double ROUNDING_MM = 1e-4;  // Newton's last steps square the increment: only rounding keeps one so small alive
constexpr int SHARED_PASSES = 4;    // of Newton's method in space with one matrix for both planes, before the coupled one
constexpr double SKEW_ERROR = 4.0;  // in space a step is off by so many times the skew of the tangents and its increment
constexpr double MAX_SKEW = 0.1;    // with more, slow steps may be more than rounding
constexpr int MAX_PASSES = 12;        // of the quick scheme; a lane that needs more begins again with Newton's method

// Displacements are a `Vector`: a number in the plane, a pair in space.
template <class Vector>
struct Insertion {
    static constexpr int W = Traits<Vector>::lanes, P = Traits<Vector>::planes;
    using Real = Scalar<Vector>;
    using M = Mask<Real>;

    const Problem& problem;
    Index set = 0;  // of lane 0

    // Fixed once the insertion has begun.
    Grid main;             // of all constraint points that the tip can reach
    Layer<Real>* layers;   // those of the problem, then those of the pieces of tissue where lanes differ in boundaries
    double* ends;          // of all pieces of tissue but the last, mm; each is a boundary of some lane
    struct Constants {
        Real rigidity, curvature;  // the greatest of all layers
        Index friction, nodes;     // whether any layer of any set has friction; of the main grid
        Index pieces, first;       // pieces of tissue; the first one's place in `layers`
    };
    Constants* constants;

    // What an insertion leaves behind from stop to stop.
    struct Progress {
        double tip;                              // mm
        Index nodes, older_nodes, on_main, now, front, condensed;
    };
    Progress* progress;
    double* nodes;         // of the tissue's nodes now
    Vector* y;             // of the constraint points, mm
    Node<Vector>* track;   // the tip as it stood at each
    Ray<Vector>* rays;
    Vector* cut;           // the cut at the tip
    Node<Vector>* states[2];  // of the nodes in the tissue, now and one cell ago
    Node<Vector>* fronts;  // of base and guides before the tissue
    Real* front_x;
    Real* status;          // of each lane: a `Status`
    Real* passes;          // Newton passes so far
    Real* stale;           // 1: the past has to be linearised anew
    PastNode<Vector>* past;
    Real* pulls;           // w d(k e)/de of the points of the past
    Element<Vector>* super;

    // Room to work in, for one stop.
    Grid own_grid;
    Factor<Vector>* factors;
    CoupledFactor<Real>* coupled;  // of a needle in space
    Node<Vector>* good;
    Kind* kinds;
    Node<Vector>* values;  // prescribed

    // The stop under way.
    const Grid* grid;
    Index last;            // the tip's node
    Index front;           // base and guides before the tissue

    explicit Insertion(const Problem& given) : problem(given) {}

    Index chain() const { return problem.guides + 1 + problem.nodes(); }

    void lay_out_fixed(Arena& arena) {
        Index pieces = problem.pieces(W);
        constants = arena.take<Constants>(1), main = take_grid(arena, problem, W);
        layers = arena.take<Layer<Real>>(problem.layers + pieces), ends = arena.take<double>(pieces);
    }
    void lay_out_state(Arena& arena) {
        Index count = problem.nodes(), points = problem.cells() + 1;
        progress = arena.take<Progress>(1);
        cut = arena.take<Vector>(1), status = arena.take<Real>(1), passes = arena.take<Real>(1);
        stale = arena.take<Real>(1), super = arena.take<Element<Vector>>(1);
        fronts = arena.take<Node<Vector>>(problem.guides + 1), front_x = arena.take<Real>(problem.guides + 1);
        nodes = arena.take<double>(count);
        y = arena.take<Vector>(points), track = arena.take<Node<Vector>>(points);
        for (auto& state : states) state = arena.take<Node<Vector>>(count);
        past = arena.take<PastNode<Vector>>(count), pulls = arena.take<Real>(problem.points(W));
        rays = arena.take<Ray<Vector>>(problem.rays);
    }
    void lay_out_scratch(Arena& arena) {
        own_grid = take_grid(arena, problem, W);
        factors = arena.take<Factor<Vector>>(chain()), good = arena.take<Node<Vector>>(chain());
        if (P == 2) coupled = arena.take<CoupledFactor<Real>>(chain());
        kinds = arena.take<Kind>(chain()), values = arena.take<Node<Vector>>(chain());
    }

    // The parameters of lane `lane`; lanes to spare repeat the last set.
    Index set_of(int lane) const { return set + lane < problem.sets ? set + lane : problem.sets - 1; }
    INLINE Real gather(const double* values, Index stride = 1) const {
        Real found{};
        for (int lane = 0; lane < W; lane++) set_lane(found, lane, values[set_of(lane) * stride]);
        return found;
    }

    // Of values (S, stride) those along y and, `apart` numbers on, along z.
    INLINE Vector gather_vector(const double* values, Index stride, Index apart) const {
        Vector found{};
        for (int plane = 0; plane < P; plane++) part(found, plane) = gather(values + plane * apart, stride);
        return found;
    }
    static INLINE Vector read_vector(const double* values, Index apart) {
        Vector found{};
        for (int plane = 0; plane < P; plane++) part(found, plane) = all_lanes<Real>(values[plane * apart]);
        return found;
    }

    // Read the parameters and place the main grid.
    void prepare() {
        constants->rigidity = gather(problem.rigidity), constants->friction = problem.has_friction();
        Real curvature{};
        Index n = problem.layers;
        for (Index i = 0; i < n; i++) {
            layers[i].law.terms = int(problem.terms);
            for (int lane = 0; lane < W; lane++)
                layers[i].law.numbers[lane] = problem.law + (set_of(lane) * n + i) * problem.numbers;
            layers[i].mu = gather(problem.mu + i, n), layers[i].thickness = gather(problem.thickness + i, n);
            layers[i].friction = gather(problem.friction + i, n);
            layers[i].prepare();
            curvature = greater_of(layers[i].curvature, curvature);
        }
        constants->curvature = curvature;
        divide_tissue();
        Lattice lattice = problem.lattice();
        Index cells = problem.cells();
        double tip = lattice.depth(cells);
        constants->nodes = main.nodes = place_nodes(main.x, tip, lattice, problem.element, nullptr, 0);
        place_points(
            main, [&](Index m) { return lattice.depth(m); }, cells, ends, constants->pieces, problem.part
        );
    }

    // Divide the tissue at the boundaries of all lanes. Where these differ, a piece consists of the layers in which each
    // lane has it: a lane then has more quadrature points than its own boundaries ask for.
    void divide_tissue() {
        Index n = problem.layers, count = 0;
        auto boundaries = [&](int lane) { return problem.boundaries + set_of(lane) * (n - 1); };
        bool differ = false;
        for (int lane = 1; lane < W && problem.columns == 0; lane++)
            for (Index b = 0; b < n - 1; b++) differ = differ || boundaries(lane)[b] != boundaries(0)[b];
        for (int lane = 0; lane < (differ ? W : 1); lane++)
            for (Index b = 0; b < n - 1; b++, count++) {
                Index at = count;  // they are few: sorted as they come
                for (; differ && at > 0 && ends[at - 1] > boundaries(lane)[b]; at--) ends[at] = ends[at - 1];
                ends[at] = boundaries(lane)[b];
            }
        constants->pieces = count + 1, constants->first = differ ? n : 0;
        for (Index piece = 0; differ && piece <= count; piece++)
            for (int lane = 0; lane < W; lane++) {
                Index layer = 0;
                while (layer < n - 1 && piece > 0 && boundaries(lane)[layer] <= ends[piece - 1]) layer++;
                layers[n + piece].take_lane(lane, layers[layer]);
            }
    }
    INLINE const Layer<Real>& layer_at(const Point& point) const { return layers[constants->first + point.layer]; }

    void begin() {
        *progress = {};
        *cut = Vector{}, *status = *passes = Real{}, *stale = all_lanes<Real>(1.0);
        y[0] = Vector{};
        for (Index m = 1; m <= problem.cells(); m++) y[m] = all_lanes<Vector>(__builtin_nan(""));
        for (Index m = 0; m <= problem.cells(); m++) track[m] = {y[1], y[1]};
    }

    Node<Vector>* state() { return states[progress->now]; }

    // ---- the cut ------------------------------------------------------------------------------------------------

    // Put the constraint point under the tip on its ray: along the tip's tangent, turned by the bevel, or at an angle
    // to the path.
    void place_constraint(const Stop& stop) {
        bool path_angle = problem.part == LINEAR_CUT;
        if (stop.flags & STARTS_RAY) {
            Ray<Vector>& ray = rays[stop.ray];
            const Node<Vector> tip = progress->nodes > 0 ? state()[progress->nodes - 1] : Node<Vector>();
            ray = {tip.u, problem.tangent * tip.slope, gather_vector(problem.turn + stop.bevel * problem.sets * P, P, 1),
                   all_lanes<Real>(progress->tip)};
            if (path_angle) {
                ray.y = *cut;
                if (progress->tip == 0.0) y[0] = *cut;  // it begins where the tip is, under the inputs that hold now
                // phi_m = 3/2 u'_{m-1} - 1/2 u'_{m-2}
                if (stop.flags & EXTRAPOLATES) ray.slope += 0.5 * (tip.slope - track[stop.cell - 2].slope);
            }
        }
        if (stop.cell > 0) {
            const Ray<Vector>& ray = rays[stop.ray];
            Vector found = ray.y + (stop.tip - ray.start) * (ray.slope + ray.turn);
            y[stop.cell] = select<Vector>(*status == 0.0, found, y[stop.cell]);  // what is never reached stays NaN
        }
    }

    // The cut at a quadrature point.
    INLINE Vector cut_at(const Point& point) const {
        Vector near = y[point.near];
        return point.share == 0.0 ? near : near + point.share * (y[point.other] - near);
    }

    // ---- the equations ------------------------------------------------------------------------------------------

    // Choose the grid of a stop: every prefix of the main one is the grid of a stop at a constraint point.
    void choose_grid(const Stop& stop) {
        if ((stop.flags & PERMANENT) && stop.cell > 0 && problem.count_within(stop.inputs) == 0) {
            grid = &main;
            last = count_below(main.x, main.nodes - 1, stop.tip - SAME_DEPTH_MM);
            return;
        }
        Lattice lattice = problem.lattice();
        make_grid(stop.tip, stop.inputs, stop.cell, [&](Index m) { return m == stop.cell ? stop.tip : lattice.depth(m); });
    }
    // Make the grid of a tip at any depth, with nodes at the guides that hold the needle.
    template <class DepthOf>
    void make_grid(double tip, Index inputs, Index cells, DepthOf depth_of) {
        own_grid.nodes = place_nodes_at(tip, inputs);
        place_points(own_grid, depth_of, cells, ends, constants->pieces, problem.part);
        grid = &own_grid;
        last = own_grid.nodes - 1;
    }
    Index place_nodes_at(double tip, Index inputs) {
        Index held = count_held(tip, inputs);
        double* depths = own_grid.x + problem.nodes() - held;  // a place that the nodes do not need yet
        for (Index i = 0; i < held; i++) depths[i] = *problem.guide_within(inputs, i);
        return place_nodes(own_grid.x, tip, problem.lattice(), problem.element, depths, held);
    }
    // How many guides in the tissue the tip has passed.
    Index count_held(double tip, Index inputs) const {
        Index held = 0, guides = problem.count_within(inputs);
        while (held < guides && *problem.guide_within(inputs, held) <= tip - GUIDE_ENGAGEMENT_MM) held++;
        return held;
    }

    // Prescribe what the inputs hold.
    void hold(Index inputs, double tip) {
        front = 1 + problem.count_before(inputs);
        // The base moves with the stage, whose axis may lie at an angle to the insertion axis.
        const double* base = problem.base + inputs * problem.sets * P * 3;
        auto of_base = [&](Index number) { return gather_vector(base + number, 3 * P, 3); };
        front_x[0] = all_lanes<Real>(tip - problem.length);
        prescribe(0, of_base(0) + of_base(2) * tip, of_base(1), CLAMPED);
        for (Index i = 1; i < front; i++) {
            const double* guide = problem.guide_before(inputs, i - 1);
            front_x[i] = i == 1 && problem.guide_x ? gather(problem.guide_x) : all_lanes<Real>(guide[0]);
            prescribe(i, guide + 1);
        }
        for (Index i = 0; i <= last; i++) kinds[front + i] = FREE;
        for (Index i = 0; i < count_held(tip, inputs); i++) {
            const double* guide = problem.guide_within(inputs, i);
            Index node = count_below(grid->x, grid->nodes, guide[0]);
            if (node < last) prescribe(front + node, guide + 1);  // none holds the tip itself
        }
        const double* tracked = problem.held_tip + 2 * P * inputs;
        if (tracked[0] == tracked[0]) prescribe(front + last, tracked);
    }
    void prescribe(Index node, Vector u, Vector slope, Kind kind) {
        values[node] = {u, slope};
        kinds[node] = kind;
    }
    // At place and slope along each direction; slopes that are left free are NaN.
    void prescribe(Index node, const double* held) {
        bool free = held[1] != held[1];
        Vector slope = free ? Vector{} : read_vector(held + 1, 2);
        prescribe(node, read_vector(held, 2), slope, free ? PINNED : CLAMPED);
    }

    // Add a quadrature point, linearised about the element's ends `a` and `b`.
    template <class Shape>
    INLINE Reaction<Vector, Real> add_point(
        Element<Vector>& k, Rubbing<Real>* rubbing, const Hermite<Shape>& shape, const Shape& behind, const Point& point,
        const Node<Vector>& a, const Node<Vector>& b, Seen<Real>& seen
    ) const {
        const Layer<Real>& layer = layer_at(point);
        Vector u = shape.n[0] * a.u + shape.n[1] * a.slope + shape.n[2] * b.u + shape.n[3] * b.slope;
        Vector slope = shape.m[0] * a.u + shape.m[1] * a.slope + shape.m[2] * b.u + shape.m[3] * b.slope;
        Vector e = u - cut_at(point);
        Force<Vector> force = find_force(layer, e, rubbing ? &slope : nullptr, seen);
        Real pull = point.weight * force.by_e;
        Vector value = point.weight * force.value, load = pull * u - value;
        if constexpr (P == 1)  // in space the two planes would differ
            if (rubbing) {
                Real by_slope = point.weight * force.by_slope;
                rubbing->add_point(shape, behind, by_slope);
                load = load + by_slope * slope;
            }
        k.add_point(shape, behind, pull, load);
        return {e, pull, value};
    }

    // The equations of element e >= 1; `keep(q, reaction)` receives what its points add.
    template <class Keep>
    INLINE Element<Vector> linearize(
        Index e, const Node<Vector>* state, Rubbing<Real>* rubbing, Seen<Real>& seen, Keep keep
    ) const {
        Element<Vector> k;
        for (Index q = grid->first[e]; q < grid->first[e + 1]; q++) {
            const Point& point = grid->points[q];
            double behind = point.x - grid->x[e];
            keep(q, add_point(k, rubbing, point.shape, behind, point, state[e - 1], state[e], seen));
        }
        k.add_bending(constants->rigidity, all_lanes<Real>(grid->x[e] - grid->x[e - 1]));
        return k;
    }

    // Eliminate from base to tip; of a condensed past, its super-element stands for the elements up to `condensed`.
    // `keep` receives the reaction at each point.
    template <bool Friction, class Keep>
    INLINE void sweep(const Node<Vector>* state, Index condensed, Seen<Real>& seen, Keep keep) {
        Carried<Vector> carried;
        auto pass = [&](const Element<Vector>& k, const Rubbing<Real>* rubbing, const Real& length,
                        Index node) __attribute__((always_inline)) {
            eliminate(carried, k, P == 1 ? rubbing : nullptr, length, kinds[node], values[node], factors[node]);
        };
        Rubbing<Real> rubbing;
        for (Index i = 0; i < front; i++) {
            Element<Vector> k;
            Real begin = front_x[i], length = (i + 1 < front ? front_x[i + 1] : all_lanes<Real>(grid->x[0])) - begin;
            if constexpr (Friction) rubbing = {};
            if (i + 1 == front)
                for (Index q = 0; q < grid->first[1]; q++) {
                    const Point& point = grid->points[q];
                    Hermite<Real> shape(point.x - begin, length);
                    Rubbing<Real>* extra = Friction ? &rubbing : nullptr;
                    keep(q, add_point(k, extra, shape, point.x - grid->x[0] + Real{}, point, fronts[i], state[0], seen));
                }
            k.add_bending(constants->rigidity, length);
            pass(k, Friction ? &rubbing : nullptr, length, i);
        }
        if (condensed > 0) pass(*super, nullptr, all_lanes<Real>(grid->x[condensed] - grid->x[0]), front);
        for (Index e = condensed + 1; e <= last; e++) {
            if constexpr (Friction) rubbing = {};
            Element<Vector> k = linearize(e, state, Friction ? &rubbing : nullptr, seen, keep);
            pass(k, Friction ? &rubbing : nullptr, all_lanes<Real>(grid->x[e] - grid->x[e - 1]), front + e - 1);
        }
        pass(Element<Vector>(), nullptr, Real{}, front + last);
    }
    template <bool Friction>
    INLINE void sweep(const Node<Vector>* state, Index condensed, Seen<Real>& seen) {
        sweep<Friction>(state, condensed, seen, [](Index, const Reaction<Vector, Real>&) {});
    }

    // The same of both planes together, all elements linearised. Unless `General`, nothing has friction, and of free nodes
    // only `onward` is found.
    template <bool General, class Keep>
    void sweep_coupled(const Node<Vector>* state, Seen<Real>& seen, Keep keep) {
        CoupledCarried<Real> carried;
        for (Index i = 0; i < front + last; i++) {
            Index e = i + 1 - front;
            const Node<Vector>&a = i < front ? fronts[i] : state[e - 1], &b = i + 1 < front ? fronts[i + 1] : state[e];
            Real begin = i < front ? front_x[i] : all_lanes<Real>(grid->x[e - 1]);
            Real end = i + 1 < front ? front_x[i + 1] : all_lanes<Real>(grid->x[e]), length = end - begin;
            auto add_pair = [&](auto& k, Index q, const auto& first, const auto& second, const auto& end)
                                __attribute__((always_inline)) {
                const Point* points = grid->points + q;
                auto one = linearize_coupled<General>(first, points[0], a, b, seen);
                auto two = linearize_coupled<General>(second, points[1], a, b, seen);
                k.add_pair(first, second, points[0].x - end, points[1].x - end, one, two);
                keep(q, one), keep(q + 1, two);
            };
            auto linearize = [&](auto& k) __attribute__((always_inline)) {
                for (Index q = e < 0 ? 0 : grid->first[e]; e >= 0 && q < grid->first[e + 1]; q += 2) {
                    const Point &one = grid->points[q], &two = grid->points[q + 1];
                    if (e == 0)
                        add_pair(k, q, Hermite<Real>(one.x - begin, length), Hermite<Real>(two.x - begin, length), end);
                    else
                        add_pair(k, q, one.shape, two.shape, grid->x[e]);
                }
                k.add_bending(constants->rigidity, length);
            };
            if (General || kinds[i] != FREE) {
                CoupledElement<Real, true> k;
                linearize(k), eliminate(carried, k, length, kinds[i], values[i], coupled[i]);
            } else {
                CoupledElement<Real, false> k;
                linearize(k), eliminate(carried, k, length, coupled[i]);
            }
        }
        if (!General && kinds[front + last] == FREE) return invert_symmetric(carried.s, coupled[front + last].inverse);
        CoupledElement<Real, true> nothing;
        eliminate(carried, nothing, Real{}, kinds[front + last], values[front + last], coupled[front + last]);
    }
    template <bool Friction, class Shape>
    INLINE CoupledPoint<Real> linearize_coupled(
        const Hermite<Shape>& shape, const Point& point, const Node<Vector>& a, const Node<Vector>& b, Seen<Real>& seen
    ) const {
        const Shape *n = shape.n, *m = shape.m;
        Vector u = n[0] * a.u + n[1] * a.slope + n[2] * b.u + n[3] * b.slope;
        Vector slope = m[0] * a.u + m[1] * a.slope + m[2] * b.u + m[3] * b.slope;
        CoupledPoint<Real> found;
        found.e = u - cut_at(point);
        Force<Vector> force = find_force(layer_at(point), found.e, Friction ? &slope : nullptr, seen);
        const Vector& along = force.direction;
        Vector stiffening = (force.along - force.across) * along;
        found.pull = point.weight * SymmetricMatrix<Real>{
            force.across + stiffening.y * along.y, stiffening.y * along.z, force.across + stiffening.z * along.z
        };
        found.force = point.weight * force.value, found.plain = point.weight * force.plain, found.friction = force.friction;
        found.load = found.pull * u - found.force + found.plain * dot(force.friction, slope);
        return found;
    }

    // Substitute back from tip to base; `put(node, solved)` receives each node of the chain.
    template <class Put>
    INLINE void substitute_back(Index condensed, Put put) {
        Node<Vector> next{};
        for (Index i = last; i >= condensed; i--) put(front + i, next = substitute(factors[front + i], next));
        if (condensed > 0) {
            Node<Vector> first = substitute(factors[front], next);
            for (Index i = condensed - 1; i > 0; i--) put(front + i, next = substitute(past[i], next, first));
            put(front, next = first);
        }
        for (Index i = front - 1; i >= 0; i--) put(i, next = substitute(factors[i], next));
    }

    template <class Put>
    INLINE void substitute_back_coupled(Put put) {
        Node<Vector> next{};
        for (Index i = front + last; i >= 0; i--) put(i, next = substitute(coupled[i], next));
    }

    // ---- the quick scheme -----------------------------------------------------------------------------------------

    // Linearise elements `from` to `to` of the past about `state`, in the chosen lanes.
    void condense(const Node<Vector>* state, Index from, Index to, const M& chosen, Seen<Real>& seen) {
        for (Index e = from; e <= to; e++) {
            auto keep = [&](Index q, const Reaction<Vector, Real>& found) {
                pulls[q] = select<Real>(chosen, found.pull, pulls[q]);
            };
            Element<Vector> k = linearize(e, state, nullptr, seen, keep), found = *super;
            past[e].reference = select<Vector>(chosen, state[e].u, past[e].reference);
            if (e == 1) {
                past[0].reference = select<Vector>(chosen, state[0].u, past[0].reference);
                found = k;
            } else {
                PastNode<Vector> node = past[e - 1];
                append(found, k, grid->x[e - 1] - grid->x[0], grid->x[e] - grid->x[e - 1], node);
                replace_chosen<PastNode<Vector>, Real>(past[e - 1], node, chosen);
            }
            replace_chosen<Element<Vector>, Real>(*super, found, chosen);
        }
    }

    // Renew the right-hand side of the past at `state`, with the tangents that are kept.
    INLINE void renew_loads(const Node<Vector>* state, Index to, const Chosen<Real>& chosen, Seen<Real>& seen) {
        Vector total[4]{};
        for (Index e = 1; e <= to; e++) {
            Vector f[4]{};
            const Node<Vector>&a = state[e - 1], &b = state[e];
            for (Index q = grid->first[e]; q < grid->first[e + 1]; q++) {
                const Point& point = grid->points[q];
                const double* n = point.shape.n;
                Vector u = n[0] * a.u + n[1] * a.slope + n[2] * b.u + n[3] * b.slope;
                Vector force = find_force<Real>(layer_at(point), u - cut_at(point), nullptr, seen).value;
                Vector load = pulls[q] * u - point.weight * force;
                for (int j = 0; j < 4; j++) f[j] += load * n[j];
            }
            if (e == 1)
                for (int j = 0; j < 4; j++) total[j] = f[j];
            else
                append_load(total, f, past[e - 1], chosen);
        }
        if (to > 0)
            for (int j = 0; j < 4; j++) super->f[j] = chosen(total[j], super->f[j]);
    }

    // Guess node i from the last two stops: it moves on as it, or the node one cell behind it, moved. `older_count` is
    // 0 where there is but one stop; a new node then lies on the tip's tangent.
    INLINE Node<Vector> guess(const Node<Vector>* now, const Node<Vector>* older, Index i, Index count, Index older_count) {
        Index growth = last + 1 - count;
        if (i < count) {
            if (older_count == 0) return now[i];
            Index j = i < older_count ? i : i - growth;
            return {now[i].u + (now[j].u - older[j].u), now[i].slope + (now[j].slope - older[j].slope)};
        }
        const Node<Vector>& tip = now[count - 1];
        Node<Vector> found{tip.u + (grid->x[i] - nodes[count - 1]) * tip.slope, tip.slope};
        if (older_count > 0) {  // as far beside the tangent as one cell ago
            const Node<Vector>& before = older[older_count - 1];
            double ahead = grid->x[i - growth] - nodes[older_count - 1];
            found.u += now[i - growth].u - (before.u + ahead * before.slope);
            found.slope += now[i - growth].slope - before.slope;
        }
        return found;
    }

    // Find the equilibrium with the condensed past; return the lanes in which that failed.
    M equilibrate_quickly(const M& alive) {
        Node<Vector>*now = state(), *next = states[1 - progress->now];
        Index count = progress->nodes, growth = last + 1 - count, older_count = progress->older_nodes;
        bool extrapolates = growth > 0 && growth == count - older_count && older_count >= growth && older_count > 0;
        if (!extrapolates) older_count = 0;
        Index condensed = last - LIVE_CELLS * problem.per_cell();
        if (condensed < 0) condensed = 0;
        M old = *stale > 0.0;
        Seen<Real> ignored;
        Index kept = progress->condensed < condensed ? progress->condensed : condensed;
        if (kept < progress->condensed) old = alive;
        if (any(old & alive)) condense(now, 1, kept, old & alive, ignored);
        condense(now, kept + 1, condensed, alive, ignored);
        progress->condensed = condensed;
        *stale = select<Real>(alive, Real{}, *stale);
        // Predict: from the tip back, since `next` holds the stop one cell ago, which is read behind where it is written.
        for (Index i = last; i >= condensed; i--) next[i] = guess(now, next, i, count, older_count);
        if (condensed > 0) next[0] = guess(now, next, 0, count, older_count);
        for (Index i = 0; i < front; i++)
            if (kinds[i] != FREE) impose(fronts[i], i);
        for (Index i = condensed; i <= last; i++) impose(next[i], front + i);
        sweep<false>(next, condensed, ignored);
        Chosen<Real> present(alive);
        substitute_back(condensed, [&](Index i, const Node<Vector>& solved) {
            Node<Vector>& node = i < front ? fronts[i] : next[i - front];
            node = {present(solved.u, node.u), present(solved.slope, node.slope)};
        });
        M busy = alive, failed{};
        Real before = all_lanes<Real>(__builtin_inf());
        for (int n = 0; n < MAX_PASSES && any(busy); n++) {
            Seen<Real> seen;
            Chosen<Real> moving(busy);
            bool chord = n < CHORD_PASSES && (n > 0 || last % RENEWED_NODES > 0);
            if (chord)
                renew_loads(next, condensed, moving, seen);
            else if (condensed > 0)
                condense(next, 1, condensed, busy, seen);
            sweep<false>(next, condensed, seen);
            Real change{}, product{};
            substitute_back(condensed, [&](Index i, const Node<Vector>& solved) {
                Node<Vector>& node = i < front ? fronts[i] : next[i - front];
                Real step = bound_size(solved.u - node.u), away = step;
                if (condensed > 0 && i >= front && i <= front + condensed)
                    away = bound_size(solved.u - past[i - front].reference);
                Index e = i < front ? 0 : i - front + (i - front < last), first = grid->first[e];
                const Real& bend = first < grid->first[e + 1] ? layer_at(grid->points[first]).curvature : constants->curvature;
                product = greater_of(bend * step * away, product);
                change = select<Real>(step <= change, change, step);  // written so that a NaN remains
                node = {moving(solved.u, node.u), moving(solved.slope, node.slope)};
            });
            *passes = select<Real>(busy, *passes + 1.0, *passes);
            Real ahead = chord ? CHORD_ERROR * product : constants->curvature * (change * change);
            if constexpr (P == 2) ahead += SKEW_ERROR * seen.skew * change;
            ahead = select<Real>(seen.exact, change, ahead);
            M done = (change < problem.tolerance) | (ahead < problem.tolerance);
            // Of tangents that differ much from those that are used, more than rounding is left.
            M stalled = (change < ROUNDING_MM) & (change > 0.5 * before);
            if constexpr (P == 2) stalled = stalled & (seen.skew < MAX_SKEW);
            if (n > 1) done = done | stalled;
            M lost = busy & ((seen.crushed) | !(change < 1e300));
            failed = failed | lost;
            busy = busy & !(done | lost);
            before = change;
        }
        return failed | busy;
    }

    INLINE void impose(Node<Vector>& node, Index i) {
        if (kinds[i] == FREE) return;
        node.u = values[i].u;
        if (kinds[i] == CLAMPED) node.slope = values[i].slope;
    }

    // ---- Newton's method --------------------------------------------------------------------------------------------

    // Guess that the shape stays as it is, and goes straight on beyond its ends.
    void extend_straight() {
        const Node<Vector>* now = state();
        Node<Vector>* next = states[1 - progress->now];
        Index count = progress->nodes;
        for (Index i = 0; i <= last; i++) {
            double x = grid->x[i];
            if (count == 0) {
                next[i] = {};
            } else if (x <= nodes[0] || x >= nodes[count - 1]) {
                Index at = x <= nodes[0] ? 0 : count - 1;
                next[i] = {now[at].u + (x - nodes[at]) * now[at].slope, now[at].slope};
            } else {
                Index e = count_below(nodes, count, x) - 1;
                Hermite<double> shape(x - nodes[e], nodes[e + 1] - nodes[e]);
                const Node<Vector>&a = now[e], &b = now[e + 1];
                const double *n = shape.n, *m = shape.m;
                next[i] = {
                    n[0] * a.u + n[1] * a.slope + n[2] * b.u + n[3] * b.slope,
                    m[0] * a.u + m[1] * a.slope + m[2] * b.u + m[3] * b.slope
                };
            }
        }
    }

    // Find the equilibrium from the guess in `next`, all elements linearised in every pass, in the chosen lanes.
    template <bool Friction>
    void equilibrate(const M& chosen) {
        Node<Vector>* next = states[1 - progress->now];
        Index size = front + last + 1;
        auto node_at = [&](Index i) -> Node<Vector>& { return i < front ? fronts[i] : next[i - front]; };
        for (Index i = 0; i < size; i++) {
            Node<Vector>& node = node_at(i);
            Node<Vector> held = node;
            impose(held, i);
            replace_chosen<Node<Vector>, Real>(node, held, chosen);
            good[i] = node;
        }
        M busy = chosen, borne{}, compressed{};
        Real before = all_lanes<Real>(__builtin_inf()), ended = all_lanes<Real>(NOT_CONVERGED);
        for (Index n = 0; n < problem.max_iterations && any(busy); n++) {
            Seen<Real> seen;
            bool coupled_pass = P == 2 && (Friction || n >= SHARED_PASSES);
            if (!coupled_pass)
                sweep<Friction>(next, 0, seen);
            else if constexpr (P == 2)
                sweep_coupled<true>(next, seen, [](Index, const CoupledPoint<Real>&) {});
            // A guess may lie beyond what the tissue bears, and the answer not: go on. Later, go half the way back to
            // the last state that some tissue bore.
            M back = seen.crushed & borne, onward = busy & !seen.crushed;
            Real change{};
            auto put = [&](Index i, const Node<Vector>& solved) {
                Node<Vector>&node = node_at(i), &kept = good[i];
                Real step = bound_size(solved.u - node.u), turn = bound_size(solved.slope - node.slope);
                step = select<Real>(turn <= step, step, turn);
                change = select<Real>(step <= change, change, step);
                Node<Vector> found{
                    select<Vector>(back, 0.5 * (node.u + kept.u), solved.u),
                    select<Vector>(back, 0.5 * (node.slope + kept.slope), solved.slope)
                };
                replace_chosen<Node<Vector>, Real>(kept, node, onward);
                replace_chosen<Node<Vector>, Real>(node, found, busy);
            };
            if (!coupled_pass)
                substitute_back(0, put);
            else if constexpr (P == 2)
                substitute_back_coupled(put);
            *passes = select<Real>(busy, *passes + 1.0, *passes);
            borne = borne | !seen.crushed, compressed = compressed | back;
            Real ahead = Friction ? change : select<Real>(seen.exact, change, constants->curvature * change * change);
            if (P == 2 && !coupled_pass) ahead += SKEW_ERROR * seen.skew * change;
            M done = (change < problem.tolerance) | (ahead < problem.tolerance);
            if (P == 1 || coupled_pass) done = done | ((change < ROUNDING_MM) & (change > 0.5 * before));
            M lost = busy & !back & !(change < 1e300);
            done = onward & done & !lost;
            ended = select<Real>(lost, all_lanes<Real>(NON_FINITE), ended);
            ended = select<Real>(done, all_lanes<Real>(CONVERGED), ended);
            busy = busy & !(done | lost);
            before = select<Real>(onward, change, before);
        }
        M crushed = busy & (compressed | !borne);
        ended = select<Real>(crushed, all_lanes<Real>(OVER_COMPRESSED), ended);
        *status = select<Real>(chosen, ended, *status);
        *stale = select<Real>(chosen, all_lanes<Real>(1.0), *stale);
    }

    // ---- from stop to stop --------------------------------------------------------------------------------------------

    // Bring the needle to a stop; a lane that fails keeps its status, and the rest of it is of no use.
    void reach(const Stop& stop) {
        place_constraint(stop);
        Index old_front = progress->front;
        choose_grid(stop);
        hold(stop.inputs, stop.tip);
        if (front != old_front)
            for (Index i = 0; i < front; i++) fronts[i] = {};
        bool on_main = grid == &main;
        M alive = *status == 0.0;
        Index count = progress->nodes;
        bool quick = on_main && progress->on_main && last + 1 >= count && !constants->friction;
        M failed = alive;
        if (quick && any(alive)) failed = equilibrate_quickly(alive);
        failed = failed & alive;
        if (any(failed)) {
            Node<Vector>* next = states[1 - progress->now];
            if (any(alive & !failed)) {  // the others keep what they have found
                for (Index i = 0; i <= last; i++) good[i] = next[i];
                extend_straight();
                for (Index i = 0; i <= last; i++) {
                    Node<Vector> guess = next[i];
                    next[i] = good[i];
                    replace_chosen<Node<Vector>, Real>(next[i], guess, failed);
                }
            } else
                extend_straight();
            constants->friction ? equilibrate<true>(failed) : equilibrate<false>(failed);
        }
        progress->older_nodes = quick && last + 1 > count ? count : 0;
        if (!quick) *stale = all_lanes<Real>(1.0), progress->condensed = 0;
        progress->now = 1 - progress->now, progress->nodes = last + 1, progress->on_main = on_main;
        progress->front = front, progress->tip = stop.tip;
        for (Index i = 0; i <= last; i++) nodes[i] = grid->x[i];
    }

    // Note where the tip stands.
    void record(const Stop& stop) {
        replace_chosen<Node<Vector>, Real>(track[stop.cell], state()[last], *status == 0.0);
        *cut = stop.cell > 0 ? y[stop.cell] : track[stop.cell].u;
    }

    void advance(const Stop& stop) {
        reach(stop);
        record(stop);
    }
};

}  // namespace needlefit
