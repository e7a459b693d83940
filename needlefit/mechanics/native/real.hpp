// Numbers of one needle (double) or of several needles side by side (a vector of lanes).
//
// Every equation of the kernel is written once, as a template of `Real`. Lanes never mix: a lane computes what a
// single needle would, to the bit, because all operations are those of IEEE 754 and the build forbids the compiler
// to fuse or reorder them. No library is included: the bytes of a result depend on no libm.
#pragma once

namespace needlefit {

#define INLINE inline __attribute__((always_inline))

using Index = long long;  // as NumPy's int64

template <int Width>
struct LanesOf {
    typedef double Vector __attribute__((vector_size(Width * sizeof(double))));
};
template <>
struct LanesOf<1> {
    typedef double Vector;
};

// What a needle in space has along y and along z, and a planar one along y alone. Equations in which the two planes are
// alike are templates of a `Vector`, a pair or a number.
template <class Real>
struct Pair {
    Real y{}, z{};
};

// What belongs to a kind of number: how many lanes it has, the type of a comparison, its parts along y and z.
template <class Real>
struct Traits {
    static constexpr int lanes = sizeof(Real) / sizeof(double), planes = 1;
    using Mask = decltype(Real() < Real());
    using Scalar = Real;
};
template <class Real>
struct Traits<Pair<Real>> {
    static constexpr int lanes = Traits<Real>::lanes, planes = 2;
    using Mask = typename Traits<Real>::Mask;
    using Scalar = Real;
};
template <class Vector>
struct Traits<const Vector> : Traits<Vector> {};
template <class Vector>
using Scalar = typename Traits<Vector>::Scalar;

template <class Real>
using Mask = typename Traits<Real>::Mask;

// 64-bit integers, as many as there are lanes.
template <class Real>
struct IntegersOf {
    using Type = Mask<Real>;
};
template <>
struct IntegersOf<double> {
    using Type = Index;
};
template <class Real>
using Integers = typename IntegersOf<Real>::Type;

template <class Vector>
INLINE Vector all_lanes(double value) {
    if constexpr (Traits<Vector>::planes == 2)
        return {all_lanes<Scalar<Vector>>(value), all_lanes<Scalar<Vector>>(value)};
    else
        return Vector() + value;  // -0.0 becomes 0.0
}

INLINE double get_lane(double value, int) { return value; }
template <class Real>
INLINE double get_lane(const Real& value, int lane) {
    return value[lane];
}
INLINE bool get_lane(bool value, int) { return value; }
INLINE bool any(bool mask) { return mask; }

INLINE void set_lane(double& number, int, double value) { number = value; }
template <class Real>
INLINE void set_lane(Real& number, int lane, double value) {
    number[lane] = value;
}

// `chosen ? yes : no`, lane by lane; both have been computed.
INLINE double select(bool chosen, double yes, double no) { return chosen ? yes : no; }
template <class Vector>
INLINE Vector select(const Mask<Vector>& chosen, const Vector& yes, const Vector& no) {
    if constexpr (Traits<Vector>::planes == 2)
        return {
            select<Scalar<Vector>>(chosen, yes.y, no.y), select<Scalar<Vector>>(chosen, yes.z, no.z)
        };
    else
        return chosen ? yes : no;
}

INLINE bool any(int mask) { return mask != 0; }  // of `bool & bool`
template <class M>
INLINE bool any(const M& mask) {
    long long found = 0;
    for (unsigned lane = 0; lane < sizeof(M) / sizeof(long long); lane++) found |= mask[lane];
    return found != 0;
}

// The lanes that take part in something; most often all of them do, and nothing has to be selected.
template <class Real>
struct Chosen {
    Mask<Real> lanes;
    bool all;
    INLINE explicit Chosen(const Mask<Real>& given) : lanes(given), all(!any(!given)) {}
    template <class Vector>
    INLINE Vector operator()(const Vector& found, const Vector& kept) const {
        return all ? found : select<Vector>(lanes, found, kept);
    }
};

template <class Real>
INLINE Real absolute(const Real& value) {
    return select<Real>(value < 0.0, -value, value);
}
template <>
INLINE double absolute(const double& value) {
    return __builtin_fabs(value);
}

// The greater one; `other` where `value` is not a number.
template <class Real>
INLINE Real greater_of(const Real& value, const Real& other) {
    return select<Real>(value > other, value, other);
}

template <class Real>
INLINE Real square_root(const Real& value) {
#if __has_builtin(__builtin_elementwise_sqrt)
    return __builtin_elementwise_sqrt(value);
#else
    Real found{};
    for (int lane = 0; lane < Traits<Real>::lanes; lane++) set_lane(found, lane, __builtin_sqrt(get_lane(value, lane)));
    return found;
#endif
}

// ---- pairs ------------------------------------------------------------------------------------------------------------

template <class Real>
INLINE Pair<Real> operator+(const Pair<Real>& a, const Pair<Real>& b) {
    return {a.y + b.y, a.z + b.z};
}
template <class Real>
INLINE Pair<Real> operator-(const Pair<Real>& a, const Pair<Real>& b) {
    return {a.y - b.y, a.z - b.z};
}
template <class Real>
INLINE Pair<Real> operator-(const Pair<Real>& a) {
    return {-a.y, -a.z};
}
template <class Real, class Number>
INLINE auto operator*(const Number& by, const Pair<Real>& a) -> Pair<decltype(by * a.y)> {
    return {by * a.y, by * a.z};
}
template <class Real, class Number>
INLINE Pair<Real> operator*(const Pair<Real>& a, const Number& by) {
    return {a.y * by, a.z * by};
}
template <class Real, class Number>
INLINE Pair<Real> operator/(const Pair<Real>& a, const Number& by) {
    return {a.y / by, a.z / by};
}
template <class Real>
INLINE Pair<Real>& operator+=(Pair<Real>& a, const Pair<Real>& b) {
    return a = a + b;
}
template <class Real>
INLINE Pair<Real>& operator-=(Pair<Real>& a, const Pair<Real>& b) {
    return a = a - b;
}

// The part along y (0) or z (1).
template <class Vector>
INLINE Scalar<Vector>& part(Vector& vector, int plane) {
    if constexpr (Traits<Vector>::planes == 2)
        return plane == 0 ? vector.y : vector.z;
    else
        return vector;
}
template <class Vector>
INLINE const Scalar<Vector>& part(const Vector& vector, int plane) {
    return part(const_cast<Vector&>(vector), plane);
}

template <class Vector>
INLINE Scalar<Vector> dot(const Vector& a, const Vector& b) {
    if constexpr (Traits<Vector>::planes == 2)
        return a.y * b.y + a.z * b.z;
    else
        return a * b;
}

template <class Vector>
INLINE Scalar<Vector> length_of(const Vector& vector) {
    if constexpr (Traits<Vector>::planes == 2)
        return square_root(dot(vector, vector));
    else
        return absolute(vector);
}

// A bound of the length of a vector, at most 1.42 times that; the length itself of a number.
template <class Vector>
INLINE Scalar<Vector> bound_size(const Vector& vector) {
    if constexpr (Traits<Vector>::planes == 2)
        return absolute(vector.y) + absolute(vector.z);
    else
        return absolute(vector);
}

// A symmetric matrix that takes vectors to vectors: in the plane a number.
template <class Real>
struct SymmetricMatrix {
    Real yy, yz, zz;
};
template <class Vector>
struct MatrixOf {
    using Type = Vector;
};
template <class Real>
struct MatrixOf<Pair<Real>> {
    using Type = SymmetricMatrix<Real>;
};
template <class Vector>
using Matrix = typename MatrixOf<Vector>::Type;
template <class Real, class Number>
INLINE SymmetricMatrix<Real> operator*(const Number& by, const SymmetricMatrix<Real>& a) {
    return {by * a.yy, by * a.yz, by * a.zz};
}
template <class Real>
INLINE SymmetricMatrix<Real> operator+(const SymmetricMatrix<Real>& a, const SymmetricMatrix<Real>& b) {
    return {a.yy + b.yy, a.yz + b.yz, a.zz + b.zz};
}
template <class Real>
INLINE SymmetricMatrix<Real> operator-(const SymmetricMatrix<Real>& a, const SymmetricMatrix<Real>& b) {
    return {a.yy - b.yy, a.yz - b.yz, a.zz - b.zz};
}
template <class Real>
INLINE Pair<Real> operator*(const SymmetricMatrix<Real>& a, const Pair<Real>& b) {
    return {a.yy * b.y + a.yz * b.z, a.yz * b.y + a.zz * b.z};
}

template <class Real>
INLINE const Real& part(const SymmetricMatrix<Real>& matrix, int row, int column) {
    return row != column ? matrix.yz : row == 0 ? matrix.yy : matrix.zz;
}

INLINE bool is_finite(double value) { return value - value == 0.0; }

}  // namespace needlefit
