// Exact derivatives of an insertion with respect to its parameters (docs/model.md, section 7).
//
// The past enters a stop only through the y of the constraint points, and these only through the rays that the tip has
// cut. So the derivatives of every constraint point and every ray are kept, one column for each parameter. At each
// stop two adjoint rows, K^T lambda = the tip's deflection and slope, give the derivatives of the tip; full tangent
// systems are solved at the last stop alone. What is differentiated is the converged residual: one further pass over
// all elements makes its factor, and leaves the state as it is, so that a shape has the same bytes with and without
// its derivatives.
#pragma once

#include "needle.hpp"

namespace needlefit {

enum ColumnKind {
    MU, SHAPE, FRICTION, BOUNDARY, RIGIDITY, BEVEL, BASE_Y, BASE_SLOPE, STAGE_SLOPE,
    ROLL, BASE_Z, BASE_SLOPE_Z, STAGE_SLOPE_Z,  // in space
    COLUMN_KINDS
};

template <class Vector>
struct Derivatives {
    static constexpr int W = Traits<Vector>::lanes, P = Traits<Vector>::planes;
    static constexpr int N = 2 * P;  // unknowns of a node: deflections, then slopes
    using Real = Scalar<Vector>;
    Insertion<Vector>& needle;
    const Problem& problem;
    Index columns;

    Real* slope_series;      // (layers, shapes, SERIES_TERMS) of mu dk/dp
    const double** law_by;   // (layers, shapes, W)

    // Derivatives so far, all 0 before first contact: the tip defines the frame there, so no parameter moves it.
    Vector* constraints;  // (cells + 1, columns) of the constraint points
    Vector* rays;         // (rays, 2, columns) of where each begins, and of its slope
    Vector* tip;          // (2, columns) of the tip's deflection and slope now
    Vector* track;        // (cells + 1, 2, columns) of the tip as it last stood in each cell
    Vector* cut;          // (columns) of the cut at the tip
    Vector* whole;        // (chain, 2, columns) of every node, at the last stop

    // Room to work in.
    Reaction<Vector, Matrix<Vector>>* points;
    Vector* by_constraint;  // (cells + 1, N) adjoint rows times loads
    Real* by_layer;         // (layers, N, shapes + 2): of the force, of friction, of each shape parameter
    Node<Vector> (*rows)[N];       // (chain) the adjoint rows, 0 where prescribed
    Node<Vector> (*held_rows)[N];  // the same where something is prescribed: the answer per unit of that
    struct Entry {
        Index node, unknown, column;
        Real amount;
    };
    Entry* entries;  // right-hand sides that touch few nodes
    Index entry_count;
    Index past_rays;  // that were begun by bevels which are not differentiated
    bool joined;  // in place of the tip's deflection and slope the next constraint point is followed

    explicit Derivatives(Insertion<Vector>& given) : needle(given), problem(given.problem), columns(problem.columns) {}

    void lay_out(Arena& arena) {
        Index cells = problem.cells() + 1, chain = needle.chain();
        slope_series = arena.take<Real>(problem.layers * problem.shapes * SERIES_TERMS);
        law_by = arena.take<const double*>(problem.layers * problem.shapes * W);
        constraints = arena.take<Vector>(cells * columns), rays = arena.take<Vector>(problem.rays * 2 * columns);
        tip = arena.take<Vector>(2 * columns), track = arena.take<Vector>(cells * 2 * columns);
        cut = arena.take<Vector>(columns), whole = arena.take<Vector>(chain * 2 * columns);
        points = arena.take<Reaction<Vector, Matrix<Vector>>>(problem.points(W));
        by_constraint = arena.take<Vector>(cells * N);
        by_layer = arena.take<Real>(problem.layers * N * (problem.shapes + 2));
        rows = arena.take<Node<Vector>[N]>(chain), held_rows = arena.take<Node<Vector>[N]>(chain);
        // In each plane: the base has 3 entries; a guide 2, and 6 for the three nodes that its x moves; a boundary 4 on
        // two nodes.
        entries = arena.take<Entry>(P * (3 + 8 * (problem.guides + 1) + 4 * problem.layers));
    }

    Index column(ColumnKind kind) const { return problem.column_of[kind]; }

    // `tracked`: the tip's own derivatives are asked for at every stop. If not, half of the rows do in space where each
    // constraint point has a ray of its own.
    void begin(bool tracked) {
        Index cells = problem.cells() + 1, shapes = problem.shapes;
        past_rays = 0;
        joined = P == 2 && !tracked && problem.part != LINEAR_CUT;
        for (Index s = 0; s < problem.stop_count; s++)
            if (problem.stops[s].cell > 0 && !(problem.stops[s].flags & STARTS_RAY)) joined = false;
        for (Index i = 0; i < cells * columns; i++) constraints[i] = Vector{};
        for (Index i = 0; i < cells * 2 * columns; i++) track[i] = Vector{};
        for (Index i = 0; i < problem.rays * 2 * columns; i++) rays[i] = Vector{};
        for (Index i = 0; i < columns; i++) tip[i] = tip[columns + i] = cut[i] = Vector{};
        if (column(SHAPE) < 0) return;
        for (Index i = 0; i < problem.layers; i++)
            for (Index p = 0; p < shapes; p++) {
                const Layer<Real>& layer = needle.layers[i];
                const double** by = law_by + (i * shapes + p) * W;
                for (int lane = 0; lane < W; lane++)
                    by[lane] = problem.law_by + ((needle.set_of(lane) * problem.layers + i) * shapes + p) * problem.numbers;
                Real* series = slope_series + (i * shapes + p) * SERIES_TERMS;
                fit_slope_series(series, layer.law, by, layer.mu, layer.thickness, layer.limit);
            }
    }

    INLINE Node<Vector>& node_at(Index i) const {
        return i < needle.front ? needle.fronts[i] : needle.state()[i - needle.front];
    }
    INLINE Real x_at(Index i) const {
        return i < needle.front ? needle.front_x[i] : all_lanes<Real>(needle.grid->x[i - needle.front]);
    }
    INLINE Index tip_node() const { return needle.front + needle.last; }
    INLINE const auto& factor_of(Index node) const {
        if constexpr (P == 2)
            return needle.coupled[node];
        else
            return needle.factors[node];
    }
    static INLINE Real& unknown_of(Node<Vector>& node, int i) { return part(i < P ? node.u : node.slope, i % P); }

    // Bring the needle to a stop, and all derivatives with it; `final`: fill `whole`.
    void advance(const Stop& stop, bool final) {
        needle.reach(stop);
        linearize(final);
        needle.record(stop);
        place_constraint(stop);
        list_entries(stop);
        if (final) {
            differentiate_shape();
        } else if (P == 2 && joined) {
            double ahead = problem.tangent * ((&stop)[1].tip - stop.tip);
            solve_adjoint<P>(ahead), sum_loads<P>(stop), differentiate_tip<P>(stop);
        } else {
            solve_adjoint<N>(0.0), sum_loads<N>(stop), differentiate_tip<N>(stop);
        }
        for (Index p = 0; p < columns; p++) {
            track[(2 * stop.cell) * columns + p] = tip[p], track[(2 * stop.cell + 1) * columns + p] = tip[columns + p];
            cut[p] = stop.cell > 0 ? constraints[stop.cell * columns + p] : tip[p];
        }
    }

    void linearize(bool whole) {
        Seen<Real> seen;
        auto keep = [&](Index q, const Reaction<Vector, Matrix<Vector>>& found) { points[q] = found; };
        if constexpr (P == 2) {
            needle.constants->friction || whole ? needle.template sweep_coupled<true>(needle.state(), seen, keep)
                                                : needle.template sweep_coupled<false>(needle.state(), seen, keep);
        } else if (needle.constants->friction)
            needle.template sweep<true>(needle.state(), 0, seen, keep);
        else
            needle.template sweep<false>(needle.state(), 0, seen, keep);
    }

    // c_m = y + (x_m - x)(slope + turn), differentiated.
    void place_constraint(const Stop& stop) {
        if (stop.flags & PAST) past_rays = stop.cell > 0 ? stop.ray + 1 : 0;
        bool path_angle = problem.part == LINEAR_CUT;
        Vector* ray = rays + stop.ray * 2 * columns;
        if (stop.flags & STARTS_RAY)
            for (Index p = 0; p < columns; p++) {
                ray[p] = path_angle ? cut[p] : tip[p];
                ray[columns + p] = problem.tangent * tip[columns + p];
                if (path_angle && get_lane(needle.rays[stop.ray].start, 0) == 0.0) constraints[p] = cut[p];
                if (path_angle && stop.flags & EXTRAPOLATES)
                    ray[columns + p] += 0.5 * (tip[columns + p] - track[(2 * (stop.cell - 2) + 1) * columns + p]);
            }
        if (stop.cell == 0) return;
        double ahead = stop.tip - get_lane(needle.rays[stop.ray].start, 0);
        Vector* found = constraints + stop.cell * columns;
        for (Index p = 0; p < columns; p++) found[p] = ray[p] + ahead * ray[columns + p];
        if (stop.ray < past_rays) return;
        if (column(BEVEL) >= 0)
            found[column(BEVEL)] += ahead * needle.gather_vector(problem.turn_by + stop.bevel * problem.sets * P, P, 1);
        if constexpr (P == 2)
            if (column(ROLL) >= 0) {
                const Vector& turn = needle.rays[stop.ray].turn;
                found[column(ROLL)] += ahead * Vector{-turn.z, turn.y};
            }
    }

    // ---- right-hand sides -------------------------------------------------------------------------------------------

    // Visit all pairs of quadrature points with their element, the number of the first, and the shape functions of both;
    // those of element 0 depend on the lane. Both points of a pair have the same layer and constraint points.
    template <class Visit>
    INLINE void visit_pairs(Visit visit) const {
        const Grid& grid = *needle.grid;
        Real start = needle.front_x[needle.front - 1];
        for (Index q = 0; q < grid.first[1]; q += 2)
            visit(Index(0), q, Hermite<Real>(grid.points[q].x - start, grid.x[0] - start),
                  Hermite<Real>(grid.points[q + 1].x - start, grid.x[0] - start));
        for (Index e = 1; e <= needle.last; e++)
            for (Index q = grid.first[e]; q < grid.first[e + 1]; q += 2)
                visit(e, q, grid.points[q].shape, grid.points[q + 1].shape);
    }
    INLINE bool rubs() const { return needle.constants->friction || column(FRICTION) >= 0; }

    // Minus the residual's derivatives at one quadrature point, over its shape functions: by the constraint point it
    // belongs to (`near`, `other`), by the logarithm of mu (`force`), by friction and by the shape parameters.
    struct PointLoads {
        Matrix<Vector> near, other;
        Vector force, friction;
    };
    template <class Shape>
    INLINE PointLoads find_loads(Index e, Index q, const Hermite<Shape>& shape, Vector* by_shape) const {
        const Point& point = needle.grid->points[q];
        const Layer<Real>& layer = needle.layers[point.layer];
        const auto& at = points[q];
        PointLoads found{at.pull, point.share * at.pull, at.force, Vector{}};
        found.near = found.near - found.other;
        Vector slope;
        if (rubs()) {
            const Node<Vector>&a = node_at(needle.front + e - 1), &b = node_at(needle.front + e);
            slope = shape.m[0] * a.u + shape.m[1] * a.slope + shape.m[2] * b.u + shape.m[3] * b.slope;
            found.friction = find_force_by_friction(layer, at.force, slope);
        }
        if (column(SHAPE) >= 0)
            for (Index p = 0; p < problem.shapes; p++) {
                Index row = point.layer * problem.shapes + p;
                by_shape[p] = point.weight * find_force_by_shape(
                    layer, slope_series + row * SERIES_TERMS, law_by + row * W, at.e, rubs() ? &slope : nullptr
                );
            }
        return found;
    }

    void add_entry(Index node, Index unknown, Index where, const Real& amount) {
        if (where >= 0) entries[entry_count++] = {node, unknown, where, amount};
    }

    // List the right-hand sides of base, guides and boundaries.
    void list_entries(const Stop& stop) {
        entry_count = 0;
        if (!(stop.flags & PAST)) list_inputs(stop);
        if (column(BOUNDARY) >= 0)
            for (Index b = 0; b < problem.layers - 1; b++)
                if (0.0 <= problem.boundaries[b] && problem.boundaries[b] < stop.tip)
                    move_boundary(b, problem.boundaries[b], column(BOUNDARY) + b);
    }
    void list_inputs(const Stop& stop) {
        Real one = all_lanes<Real>(1.0);
        add_entry(0, 0, column(BASE_Y), one);
        add_entry(0, 0, column(STAGE_SLOPE), all_lanes<Real>(stop.tip));
        add_entry(0, P, column(BASE_SLOPE), one);
        if constexpr (P == 2) {
            add_entry(0, 1, column(BASE_Z), one);
            add_entry(0, 1, column(STAGE_SLOPE_Z), all_lanes<Real>(stop.tip));
            add_entry(0, P + 1, column(BASE_SLOPE_Z), one);
        }
        Index front = needle.front, before = front - 1, count = before + problem.count_within(stop.inputs);
        Index size = problem.guide_size(), guides = problem.before_first[stop.inputs] + problem.within_first[stop.inputs];
        const Index* own = problem.guide_columns + size * guides;
        for (Index g = 0; g < count; g++, own += size) {
            Index node = g + 1;
            if (node >= front) {
                double x = *problem.guide_within(stop.inputs, g - before);
                node = front + count_below(needle.grid->x, needle.last + 1, x);
                if (node >= tip_node() || needle.grid->x[node - front] != x) continue;  // the tip has not passed it yet
            }
            for (Index component = 0; component < (needle.kinds[node] == CLAMPED ? 2 : 1); component++)
                for (Index plane = 0; plane < P; plane++)
                    add_entry(node, P * component + plane, own[1 + 2 * plane + component], one);
            if (own[0] >= 0) move_node(node, own[0]);
        }
    }

    // List a load on the residual, on nodes from `node` on; what is prescribed has no equation that it could enter.
    void add_loads(const Node<Vector>* load, Index count, Index node, Index where) {
        for (Index i = 0; i < count; i++)
            for (int plane = 0; plane < P; plane++) {
                if (needle.kinds[node + i] == FREE) add_entry(node + i, plane, where, -part(load[i].u, plane));
                if (needle.kinds[node + i] != CLAMPED) add_entry(node + i, P + plane, where, -part(load[i].slope, plane));
            }
    }

    // The cut and its slope at a quadrature point.
    INLINE void find_cut(const Point& point, Vector& c, Vector& slope) const {
        Vector near = needle.y[point.near], rise = needle.y[point.other] - near;
        c = near + point.share * rise, slope = point.rate * rise;
    }

    // d(residual)/dx of a node that moves along the needle: the element that ends there grows, the other one shrinks.
    void move_node(Index i, Index where) {
        Node<Vector> load[3];
        const Grid& grid = *needle.grid;
        for (Index side = 0; side < 2; side++) {
            Index a = i - 1 + side, e = a + 1 - needle.front;
            double grows = 1.0 - 2.0 * double(side);
            Real start = x_at(a), length = x_at(a + 1) - start;
            grow_beam(load + side, a, length, grows);
            if (e < 0) continue;
            for (Index q = grid.first[e]; q < grid.first[e + 1]; q++) {
                // Only the piece of quadrature that touches a node in the tissue moves with it.
                double second = double((q - grid.first[e]) % 2), drift = 0.0, gain = 0.0;
                if (i >= needle.front && side == 0 && q >= grid.first[e + 1] - 2)
                    drift = 0.5 + (2.0 * second - 1.0) * GAUSS_OFFSET, gain = 0.5;
                else if (i >= needle.front && side == 1 && q < grid.first[e] + 2)
                    drift = 0.5 - (2.0 * second - 1.0) * GAUSS_OFFSET, gain = -0.5;
                const Point& point = grid.points[q];
                Vector c, slope;
                find_cut(point, c, slope);
                move_point(
                    load + side, a, point.layer, c, slope * drift, point.x - start, length, point.weight,
                    drift - double(side), grows, gain
                );
            }
        }
        add_loads(load, 3, i - 1, where);
    }

    // d(K_b u) of the element from node a on, whose length grows so.
    void grow_beam(Node<Vector>* load, Index a, const Real& length, double grows) const {
        const Node<Vector>&p = node_at(a), &q = node_at(a + 1);
        Real f = -grows * needle.constants->rigidity / (length * length);
        Vector away = p.u - q.u;
        Vector shear = f * (36.0 * away / (length * length) + 12.0 * (p.slope + q.slope) / length);
        Vector turn = f * 12.0 * away / length;
        load[0].u += shear, load[1].u -= shear;
        load[0].slope += turn + f * (4.0 * p.slope + 2.0 * q.slope);
        load[1].slope += turn + f * (2.0 * p.slope + 4.0 * q.slope);
    }

    // d(w k e g N) of a point x mm into the element from node a on. Per unit of what moves, x grows by `drift`, the
    // element's length by `grows`, the weight by `gain`, and the cut's y there, c, by `c_by`.
    void move_point(
        Node<Vector>* load, Index a, int layer, const Vector& c, const Vector& c_by, const Real& x, const Real& length,
        double weight, double drift, double grows, double gain
    ) const {
        Hermite<Real> shape(x, length), by = Hermite<Real>::change(x, length, drift, grows);
        const Node<Vector>&p = node_at(a), &q = node_at(a + 1);
        auto sum = [&](const Real* n) { return n[0] * p.u + n[1] * p.slope + n[2] * q.u + n[3] * q.slope; };
        Vector e = sum(shape.n) - c, slope = sum(shape.m), force;
        Vector force_by = differentiate_force<Vector>(needle.layers[layer], e, slope, sum(by.n) - c_by, sum(by.m), force);
        Vector first = gain * force + weight * force_by, second = weight * force;
        load[0].u += first * shape.n[0] + second * by.n[0], load[0].slope += first * shape.n[1] + second * by.n[1];
        load[1].u += first * shape.n[2] + second * by.n[2], load[1].slope += first * shape.n[3] + second * by.n[3];
    }

    // d(residual)/d(depth) of the boundary between layers b and b + 1. Where it lies on a node or on a change of
    // constraint, the derivative is that toward greater depth.
    void move_boundary(Index b, double depth, Index where) {
        Node<Vector> load[3];
        const Grid& grid = *needle.grid;
        Index right = 0, e = 0, points_here = grid.first[needle.last + 1];
        while (right < points_here && grid.points[right].x < depth) right++;  // pieces end at boundaries
        while (grid.first[e + 1] <= right) e++;
        Index a = e - 1 + needle.front, left = right - 2;
        Real start = x_at(a), length = x_at(a + 1) - start;
        Vector c, slope;
        const Point& beyond = grid.points[right];
        find_cut(beyond, c, slope);
        c = c + slope * (depth - beyond.x);  // at the boundary
        auto move = [&](Index q, Index layer, double side) {
            const Point& point = grid.points[q];
            double drift = 0.5 + side * (2.0 * double((q - right) & 1) - 1.0) * GAUSS_OFFSET;
            Vector here, rate;
            find_cut(point, here, rate);
            move_point(
                load, a, int(layer), here, rate * drift, point.x - start, length, point.weight, drift, 0.0, 0.5 * side
            );
        };
        auto jump = [&](Index layer, double gain) {
            move_point(load, a, int(layer), c, Vector{}, depth - start, length, 0.0, 0.0, 0.0, gain);
        };
        if (left >= grid.first[e] && grid.points[left].layer == b && grid.points[left].near == beyond.near)
            move(left, b, 1.0), move(left + 1, b, 1.0);
        else
            jump(b, 1.0);
        if (beyond.layer == b + 1)
            move(right, b + 1, -1.0), move(right + 1, b + 1, -1.0);
        else  // a layer without extent
            jump(b + 1, -1.0);
        add_loads(load, 2, a, where);
    }

    // ---- the tip ------------------------------------------------------------------------------------------------------

    // Solve K^T lambda = load from tip to base, for R loads: on the tip's deflection and on its slope, or one that stands
    // for the deflection `ahead` of it. At a prescribed value, lambda is the derivative of the tip with respect to that
    // value; it multiplies no load.
    template <int R>
    void solve_adjoint(double ahead) {
        const auto& inverse = factor_of(tip_node()).inverse;
        Node<Vector> arriving[R];
        for (int r = 0; r < R; r++)
            for (int j = 0; j < N; j++)
                unknown_of(arriving[r], j) = R == N ? inverse[r][j] : inverse[r][j] + ahead * inverse[P + r][j];
        for (Index i = tip_node(); i >= 0; i--)
            for (int r = 0; r < R; r++) {
                Node<Vector> row = arriving[r];
                if (needle.kinds[i] != FREE) held_rows[i][r] = row, row.u = Vector{};
                if (needle.kinds[i] == CLAMPED) row.slope = Vector{};
                rows[i][r] = row;
                if (i == 0) continue;
                const auto& m = factor_of(i - 1).onward;
                for (int j = 0; j < N; j++) {
                    Real sum = m[0][j] * unknown_of(row, 0);
                    for (int l = 1; l < N; l++) sum = sum + m[l][j] * unknown_of(row, l);
                    unknown_of(arriving[r], j) = sum;
                }
            }
    }

    // Sum adjoint rows times loads over the quadrature points, by constraint point and by layer.
    template <int R>
    void sum_loads(const Stop& stop) {
        Index shapes = problem.shapes, width = shapes + 2;
        for (Index m = 0; m < R * (stop.cell + 1); m++) by_constraint[m] = Vector{};
        for (Index i = 0; i < problem.layers * R * width; i++) by_layer[i] = Real{};
        Vector by_shape[2][MAX_SHAPES];
        visit_pairs([&](Index e, Index q, const auto& first, const auto& second) {
            Index i = e + needle.front - 1;
            const Point& point = needle.grid->points[q];
            PointLoads one = find_loads(e, q, first, by_shape[0]), two = find_loads(e, q + 1, second, by_shape[1]);
            for (int r = 0; r < R; r++) {
                const Node<Vector>&a = rows[i][r], &b = rows[i + 1][r];
                auto interpolate = [&](const auto& n) { return n[0] * a.u + n[1] * a.slope + n[2] * b.u + n[3] * b.slope; };
                Vector at = interpolate(first.n), then = interpolate(second.n);
                Vector& near = by_constraint[R * point.near + r];
                near = near + one.near * at + two.near * then;
                if (point.share != 0.0) {
                    Vector& other = by_constraint[R * point.other + r];
                    other = other + one.other * at + two.other * then;
                }
                Real* sums = by_layer + (R * point.layer + r) * width;
                sums[0] = sums[0] + dot(at, one.force) + dot(then, two.force);
                if (rubs()) sums[1] = sums[1] + dot(at, one.friction) + dot(then, two.friction);
                if (column(SHAPE) >= 0)
                    for (Index p = 0; p < shapes; p++)
                        sums[2 + p] = sums[2 + p] + dot(at, by_shape[0][p]) + dot(then, by_shape[1][p]);
            }
        });
    }

    template <int R>
    void differentiate_tip(const Stop& stop) {
        Index shapes = problem.shapes, width = shapes + 2;
        auto tip_at = [&](int r, Index p) -> Real& { return part(tip[r / P * columns + p], r % P); };
        for (Index p = 0; p < 2 * columns; p++) tip[p] = Vector{};
        for (Index m = 0; m <= stop.cell; m++)
            for (int r = 0; r < R; r++)
                for (Index p = 0; p < columns; p++)
                    tip_at(r, p) += dot(by_constraint[R * m + r], constraints[m * columns + p]);
        for (Index i = 0; i < problem.layers; i++)
            for (int r = 0; r < R; r++) {
                const Real* sums = by_layer + (R * i + r) * width;
                if (column(MU) >= 0) tip_at(r, column(MU) + i) -= sums[0] / needle.layers[i].mu;
                // In equilibrium the beam's own load is minus the tissue's.
                if (column(RIGIDITY) >= 0) tip_at(r, column(RIGIDITY)) += sums[0] / needle.constants->rigidity;
                if (column(FRICTION) >= 0) tip_at(r, column(FRICTION) + i) -= sums[1];
                if (column(SHAPE) >= 0)
                    for (Index p = 0; p < shapes; p++) tip_at(r, column(SHAPE) + p * problem.layers + i) -= sums[2 + p];
            }
        for (Index n = 0; n < entry_count; n++) {
            const Entry& entry = entries[n];
            bool held = needle.kinds[entry.node] > entry.unknown / P;
            for (int r = 0; r < R; r++) {
                Node<Vector>& row = (held ? held_rows : rows)[entry.node][r];
                tip_at(r, entry.column) += entry.amount * unknown_of(row, int(entry.unknown));
            }
        }
    }

    // ---- the whole shape --------------------------------------------------------------------------------------------

    INLINE Vector* row_of(Index node, Index component) { return whole + (2 * node + component) * columns; }

    void differentiate_shape() {
        Index size = tip_node() + 1, shapes = problem.shapes;
        for (Index i = 0; i < size * 2 * columns; i++) whole[i] = Vector{};
        Vector by_shape[MAX_SHAPES];
        auto add = [&](Index e, Index q, const auto& shape) {
            const Point& point = needle.grid->points[q];
            PointLoads loads = find_loads(e, q, shape, by_shape);
            const Vector *near = constraints + point.near * columns, *other = constraints + point.other * columns;
            for (Index j = 0; j < 4; j++) {
                Vector* into = row_of(e + needle.front - 1 + j / 2, j % 2);
                Real n = shape.n[j] + Real{};
                for (Index p = 0; p < columns; p++) into[p] += n * loads.near * near[p];
                if (point.share != 0.0)
                    for (Index p = 0; p < columns; p++) into[p] += n * loads.other * other[p];
                if (column(MU) >= 0)
                    into[column(MU) + point.layer] -= n * loads.force / needle.layers[point.layer].mu;
                if (column(RIGIDITY) >= 0) into[column(RIGIDITY)] += n * loads.force / needle.constants->rigidity;
                if (column(FRICTION) >= 0) into[column(FRICTION) + point.layer] -= n * loads.friction;
                if (column(SHAPE) >= 0)
                    for (Index p = 0; p < shapes; p++)
                        into[column(SHAPE) + p * problem.layers + point.layer] -= n * by_shape[p];
            }
        };
        visit_pairs([&](Index e, Index q, const auto& first, const auto& second) { add(e, q, first), add(e, q + 1, second); });
        for (Index i = 0; i < size; i++)  // what is prescribed has no equation that could be loaded
            for (Index component = 0; component < needle.kinds[i]; component++)
                for (Index p = 0; p < columns; p++) row_of(i, component)[p] = Vector{};
        for (Index n = 0; n < entry_count; n++) {
            Vector* into = row_of(entries[n].node, entries[n].unknown / P);
            part(into[entries[n].column], int(entries[n].unknown % P)) += entries[n].amount;
        }
        solve_tangents(size);
        for (Index p = 0; p < columns; p++) tip[p] = row_of(size - 1, 0)[p], tip[columns + p] = row_of(size - 1, 1)[p];
    }

    // Solve K du = load in place, forward and back.
    void solve_tangents(Index size) {
        auto at = [&](Index i, int unknown, Index p) -> Real& {
            return part(row_of(i, unknown / P)[p], unknown % P);
        };
        for (Index i = 0; i < size; i++) {
            const auto& factor = factor_of(i);
            Real onward[N][N];  // the equation of what is prescribed does not know this node
            for (int j = 0; j < N; j++)
                for (int l = 0; l < N; l++)
                    onward[j][l] = i + 1 < size && needle.kinds[i + 1] > j / P ? Real{} : factor.onward[j][l];
            for (Index p = 0; p < columns; p++) {
                Real load[N];
                for (int j = 0; j < N; j++) load[j] = at(i, j, p);
                auto sum = [&](const Real* row) {
                    Real found = row[0] * load[0];
                    for (int l = 1; l < N; l++) found = found + row[l] * load[l];
                    return found;
                };
                for (int j = 0; j < N; j++) at(i, j, p) = sum(factor.inverse[j]);
                if (i + 1 == size) continue;
                for (int j = 0; j < N; j++) at(i + 1, j, p) += sum(onward[j]);
            }
        }
        for (Index i = size - 2; i >= 0; i--) {
            const auto& g = factor_of(i).g;
            for (Index p = 0; p < columns; p++)
                for (int j = 0; j < N; j++) {
                    Real sum = g[j][0] * at(i + 1, 0, p);
                    for (int l = 1; l < N; l++) sum = sum + g[j][l] * at(i + 1, l, p);
                    at(i, j, p) -= sum;
                }
        }
    }
};

}  // namespace needlefit
