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

// What belongs to a kind of number: how many lanes it has, and the type of a comparison.
template <class Real>
struct Traits {
    static constexpr int lanes = sizeof(Real) / sizeof(double);
    using Mask = decltype(Real() < Real());
};

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

template <class Real>
INLINE Real all_lanes(double value) {
    return Real() + value;  // -0.0 becomes 0.0
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
template <class Real>
INLINE Real select(const Mask<Real>& chosen, const Real& yes, const Real& no) {
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
    INLINE Real operator()(const Real& found, const Real& kept) const {
        return all ? found : select<Real>(lanes, found, kept);
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

INLINE bool is_finite(double value) { return value - value == 0.0; }

}  // namespace needlefit
