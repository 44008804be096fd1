// Dual numbers: a value with its derivatives in N directions, of first order (Dual) or of first and second (Dual2).
//
//     f(a):     d_i = f' a_i,                h_ij = f' a_ij + f'' a_i a_j
//     f(a, b):  d_i = f_a a_i + f_b b_i,     h_ij = f_a a_ij + f_b b_ij + f_aa a_i a_j + f_bb b_i b_j
//                                                   + f_ab (a_i b_j + b_i a_j)
//
// (Griewank & Walther, Evaluating Derivatives, 2nd ed., 2008, ch. 3 and 13.) Comparisons are those of values. A square
// root at zero has the derivatives zero: |u| has no slope at u = 0, and zero is in the middle of all its slopes. So the
// first derivative of a force like k(|u|) u is right there; the second derivative of an energy of |u| is not: differentiate
// the force.
#pragma once

#include "small.hpp"

namespace thinshell {

// What directions of derivatives are: those of a law's own variables, or changes along which many points are followed.
enum class Directions { own, along };

template <class T, int N, Directions kind> struct FirstOrder;
template <class T, int N> using Dual = FirstOrder<T, N, Directions::own>;
// A function of a Dual<T, N> and of an Along<T, M> has derivatives of both kinds, as a Dual<Along<T, M>, N>, and what depends
// on one alone is worked out in it alone.
template <class T, int N> using Along = FirstOrder<T, N, Directions::along>;

template <class A, class U> constexpr bool is_along = false;
template <class T, int N> constexpr bool is_along<Along<T, N>, T> = true;

template <class T, int N, Directions kind> struct FirstOrder {
  using Scalar = FirstOrder;
  static constexpr int directions = N;
  T v;
  T d[N];
  THINSHELL_FN FirstOrder() : v(0), d{} {}
  THINSHELL_FN FirstOrder(T value) : v(value), d{} {}
  template <class U, class = typename EnableIf<is_number<U> && !Same<U, T>::value>::type>
  THINSHELL_FN FirstOrder(U value) : v(T(value)), d{} {}
  // The value of a variable, whose direction is the i-th.
  static THINSHELL_FN FirstOrder variable(T value, int i) { FirstOrder out(value); out.d[i] = T(1); return out; }
  // From a number without changes along others, where this one has such (T is an Along<U, ...>).
  template <class U, class = typename EnableIf<is_along<T, U>>::type>
  THINSHELL_FN FirstOrder(const FirstOrder<U, N, kind> &one) : v(one.v), d{} {
    THINSHELL_UNROLL for (int i = 0; i < N; ++i) d[i] = T(one.d[i]);
  }
  THINSHELL_FN explicit operator int() const { return int(v); }

  friend THINSHELL_FN FirstOrder chain(const FirstOrder &a, T f, T f1, T) {
    FirstOrder out(f);
    THINSHELL_UNROLL for (int i = 0; i < N; ++i) out.d[i] = f1 * a.d[i];
    return out;
  }
  friend THINSHELL_FN FirstOrder chain(const FirstOrder &a, const FirstOrder &b, T f, T fa, T fb, T, T, T) {
    FirstOrder out(f);
    THINSHELL_UNROLL for (int i = 0; i < N; ++i) out.d[i] = fa * a.d[i] + fb * b.d[i];
    return out;
  }
};

template <class T, int N> struct Dual2 {
  using Scalar = Dual2;
  static constexpr int directions = N;
  T v;
  T d[N];
  T h[N * (N + 1) / 2];  // lower triangle, row by row
  THINSHELL_FN Dual2() : v(0), d{}, h{} {}
  THINSHELL_FN Dual2(T value) : v(value), d{}, h{} {}
  template <class U, class = typename EnableIf<is_number<U> && !Same<U, T>::value>::type>
  THINSHELL_FN Dual2(U value) : v(T(value)), d{}, h{} {}
  static THINSHELL_FN Dual2 variable(T value, int i) { Dual2 out(value); out.d[i] = T(1); return out; }
  THINSHELL_FN explicit operator int() const { return int(v); }
  // Second derivative in the directions i and j.
  THINSHELL_FN T second(int i, int j) const { return i < j ? h[j * (j + 1) / 2 + i] : h[i * (i + 1) / 2 + j]; }

  friend THINSHELL_FN Dual2 chain(const Dual2 &a, T f, T f1, T f2) {
    Dual2 out(f);
    THINSHELL_UNROLL for (int i = 0; i < N; ++i) out.d[i] = f1 * a.d[i];
    for (int i = 0, k = 0; i < N; ++i) {
      const T left = f2 * a.d[i];
      for (int j = 0; j <= i; ++j, ++k) out.h[k] = f1 * a.h[k] + left * a.d[j];
    }
    return out;
  }
  friend THINSHELL_FN Dual2 chain(const Dual2 &a, const Dual2 &b, T f, T fa, T fb, T faa, T fab, T fbb) {
    Dual2 out(f);
    THINSHELL_UNROLL for (int i = 0; i < N; ++i) out.d[i] = fa * a.d[i] + fb * b.d[i];
    for (int i = 0, k = 0; i < N; ++i) {
      const T left = faa * a.d[i] + fab * b.d[i], right = fab * a.d[i] + fbb * b.d[i];
      for (int j = 0; j <= i; ++j, ++k) out.h[k] = fa * a.h[k] + fb * b.h[k] + left * a.d[j] + right * b.d[j];
    }
    return out;
  }
};

// Numbers without a derivative in the directions of dual numbers over T.
template <class U, class T> constexpr bool is_plain = is_number<U> || Same<U, T>::value;

template <class T, int N> struct RealUnder<Dual<T, N>> : RealUnder<T> {};
template <class T, int N> struct RealUnder<Dual2<T, N>> : RealUnder<T> {};
template <class T, int N> struct RealUnder<Along<T, N>> : RealUnder<T> {};

// Value of a dual number, and of a plain one.
template <class T, class = typename EnableIf<is_number<T>>::type> THINSHELL_FN T value(const T &x) { return x; }
template <class T, int N> THINSHELL_FN T value(const Dual<T, N> &x) { return x.v; }
template <class T, int N> THINSHELL_FN T value(const Dual2<T, N> &x) { return x.v; }
template <class T, int N> THINSHELL_FN T value(const Along<T, N> &x) { return x.v; }

#define THINSHELL_DUAL_COMPARISON(D, OP)                                                                                \
  template <class T, int N> THINSHELL_FN auto operator OP(const D<T, N> &a, const D<T, N> &b) { return a.v OP b.v; }    \
  template <class T, int N, class U, class = typename EnableIf<is_plain<U, T>>::type>                                   \
  THINSHELL_FN auto operator OP(const D<T, N> &a, U b) { return a.v OP T(b); }                                          \
  template <class T, int N, class U, class = typename EnableIf<is_plain<U, T>>::type>                                   \
  THINSHELL_FN auto operator OP(U a, const D<T, N> &b) { return T(a) OP b.v; }

// An operator of two dual numbers, and of one and a plain number c, which has no derivative.
#define THINSHELL_DUAL_OPERATOR(D, OP, F, G, FA, FB, FAA, FAB, FBB, WITH_RIGHT, WITH_LEFT)                              \
  template <class T, int N> THINSHELL_FN D<T, N> operator OP(const D<T, N> &a, const D<T, N> &b) {                      \
    [[maybe_unused]] const T x = a.v, y = b.v, f = F, g = G;                                                            \
    return chain(a, b, f, T(FA), T(FB), T(FAA), T(FAB), T(FBB));                                                        \
  }                                                                                                                     \
  template <class T, int N, class U, class = typename EnableIf<is_plain<U, T>>::type>                                   \
  THINSHELL_FN D<T, N> operator OP(const D<T, N> &a, U c) {                                                             \
    [[maybe_unused]] const T x = a.v, y = T(c), f = F, g = G; return WITH_RIGHT; }                                      \
  template <class T, int N, class U, class = typename EnableIf<is_plain<U, T>>::type>                                   \
  THINSHELL_FN D<T, N> operator OP(U c, const D<T, N> &b) {                                                             \
    [[maybe_unused]] const T x = T(c), y = b.v, f = F, g = G; return WITH_LEFT; }                                       \
  template <class T, int N, class U> THINSHELL_FN D<T, N> &operator OP##=(D<T, N> &a, const U &b) { return a = a OP b; }

#define THINSHELL_DUAL_FUNCTION(D, NAME, F, F1, F2)                                                                     \
  template <class T, int N> THINSHELL_FN D<T, N> NAME(const D<T, N> &a) {                                               \
    [[maybe_unused]] const T x = a.v, f = F, g = F1;                                                                    \
    return chain(a, f, g, T(F2));                                                                                       \
  }

#define THINSHELL_DUAL(D)                                                                                               \
  THINSHELL_DUAL_COMPARISON(D, <) THINSHELL_DUAL_COMPARISON(D, >) THINSHELL_DUAL_COMPARISON(D, <=)                      \
  THINSHELL_DUAL_COMPARISON(D, >=) THINSHELL_DUAL_COMPARISON(D, ==) THINSHELL_DUAL_COMPARISON(D, !=)                    \
  THINSHELL_DUAL_OPERATOR(D, +, x + y, f, 1, 1, 0, 0, 0, shifted(a, g), shifted(b, g))                                  \
  THINSHELL_DUAL_OPERATOR(D, -, x - y, f, 1, -1, 0, 0, 0, shifted(a, g), scaled(b, g, T(-1)))                           \
  THINSHELL_DUAL_OPERATOR(D, *, x * y, f, y, x, 0, 1, 0, scaled(a, g, y), scaled(b, g, x))                              \
  THINSHELL_DUAL_OPERATOR(D, /, x / y, T(1) / y, g, -f * g, 0, -g * g, T(2) * f * g * g, scaled(a, f, g),               \
                          chain(b, f, -f * g, T(2) * f * g * g))                                                        \
  template <class T, int N> THINSHELL_FN D<T, N> operator-(const D<T, N> &a) { return scaled(a, -a.v, T(-1)); }         \
  template <class T, int N> THINSHELL_FN D<T, N> operator+(const D<T, N> &a) { return a; }                              \
  THINSHELL_DUAL_FUNCTION(D, abs, abs(x), select(x < T(0), T(-1), T(1)), T(0))                                                \
  THINSHELL_DUAL_FUNCTION(D, sqrt, sqrt(x), select(f > T(0), T(0.5) / f, T(0)), select(f > T(0), T(-0.5) * g / x, T(0)))            \
  THINSHELL_DUAL_FUNCTION(D, exp, exp(x), f, f)                                                                         \
  THINSHELL_DUAL_FUNCTION(D, expm1, expm1(x), f + T(1), f + T(1))                                                       \
  THINSHELL_DUAL_FUNCTION(D, log, log(x), T(1) / x, -g * g)                                                             \
  THINSHELL_DUAL_FUNCTION(D, sin, sin(x), cos(x), -f)                                                                   \
  THINSHELL_DUAL_FUNCTION(D, cos, cos(x), -sin(x), -f)                                                                  \
  THINSHELL_DUAL_FUNCTION(D, tan, tan(x), T(1) + f * f, T(2) * f * g)                                                   \
  THINSHELL_DUAL_FUNCTION(D, tanh, tanh(x), T(1) - f * f, T(-2) * f * g)                                                \
  THINSHELL_DUAL_FUNCTION(D, atan, atan(x), T(1) / (T(1) + x * x), T(-2) * x * g * g)                                   \
  THINSHELL_DUAL_FUNCTION(D, asin, asin(x), T(1) / sqrt(T(1) - x * x), x * g * g * g)                                   \
  THINSHELL_DUAL_FUNCTION(D, acos, acos(x), T(-1) / sqrt(T(1) - x * x), x * g * g * g)                                  \
  template <class T, int N> THINSHELL_FN T floor(const D<T, N> &a) { return floor(a.v); }                               \
  template <class T, int N> THINSHELL_FN T ceil(const D<T, N> &a) { return ceil(a.v); }                                 \
  template <class T, int N> THINSHELL_FN D<T, N> atan2(const D<T, N> &a, const D<T, N> &b) {                            \
    const T y = a.v, x = b.v, r = T(1) / (x * x + y * y), fy = x * r, fx = -y * r;                                      \
    return chain(a, b, atan2(y, x), fy, fx, T(2) * fx * fy, fx * fx - fy * fy, T(-2) * fx * fy);                        \
  }                                                                                                                     \
  template <class T, int N, class U, class = typename EnableIf<is_plain<U, T>>::type>                                   \
  THINSHELL_FN D<T, N> pow(const D<T, N> &a, U p) {                                                                     \
    const T x = a.v, n = T(p), m = n * (n - T(1));                                                                      \
    return chain(a, pow(x, n), select(n == T(0), n, n * pow(x, n - T(1))), select(m == T(0), m, m * pow(x, n - T(2))));   \
  }                                                                                                                     \
  template <class T, int N> THINSHELL_FN D<T, N> pow(const D<T, N> &a, const D<T, N> &p) { return exp(p * log(a)); }    \
  template <class T, int N, class U, class = typename EnableIf<is_plain<U, T>>::type>                                   \
  THINSHELL_FN D<T, N> pow(U a, const D<T, N> &p) { return exp(p * T(log(T(a)))); }

// The same derivatives at another value, or times a number.
template <class D, class T> THINSHELL_FN D shifted(const D &a, T f) { D out = a; out.v = f; return out; }
template <class T, int N> THINSHELL_FN Dual<T, N> scaled(const Dual<T, N> &a, T f, T by) { return chain(a, f, by, T(0)); }
template <class T, int N> THINSHELL_FN Along<T, N> scaled(const Along<T, N> &a, T f, T by) { return chain(a, f, by, T(0)); }
template <class T, int N> THINSHELL_FN Dual2<T, N> scaled(const Dual2<T, N> &a, T f, T by) {
  Dual2<T, N> out(f);
  THINSHELL_UNROLL for (int i = 0; i < N; ++i) out.d[i] = by * a.d[i];
  for (int i = 0; i < N * (N + 1) / 2; ++i) out.h[i] = by * a.h[i];
  return out;
}

THINSHELL_DUAL(Dual)
THINSHELL_DUAL(Dual2)
THINSHELL_DUAL(Along)

// Of both kinds.
template <class T, int N, int M> using Mixed = Dual<Along<T, M>, N>;
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> times(const Dual<T, N> &a, const Along<T, M> &b) {
  Mixed<T, N, M> out(a.v * b);
  THINSHELL_UNROLL for (int i = 0; i < N; ++i) out.d[i] = a.d[i] * b;
  return out;
}
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator*(const Dual<T, N> &a, const Along<T, M> &b) { return times(a, b); }
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator*(const Along<T, M> &b, const Dual<T, N> &a) { return times(a, b); }
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator/(const Dual<T, N> &a, const Along<T, M> &b) { return times(a, T(1) / b); }
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator/(const Along<T, M> &b, const Dual<T, N> &a) { return times(T(1) / a, b); }
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator+(const Dual<T, N> &a, const Along<T, M> &b) { return Mixed<T, N, M>(a) + b; }
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator+(const Along<T, M> &b, const Dual<T, N> &a) { return Mixed<T, N, M>(a) + b; }
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator-(const Dual<T, N> &a, const Along<T, M> &b) { return Mixed<T, N, M>(a) - b; }
template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator-(const Along<T, M> &b, const Dual<T, N> &a) { return b - Mixed<T, N, M>(a); }
#define THINSHELL_MIXED_COMPARISON(OP)                                                                                 \
  template <class T, int N, int M> THINSHELL_FN auto operator OP(const Dual<T, N> &a, const Along<T, M> &b) { return a.v OP b.v; } \
  template <class T, int N, int M> THINSHELL_FN auto operator OP(const Along<T, M> &a, const Dual<T, N> &b) { return a.v OP b.v; }
THINSHELL_MIXED_COMPARISON(<)
THINSHELL_MIXED_COMPARISON(>)
THINSHELL_MIXED_COMPARISON(<=)
THINSHELL_MIXED_COMPARISON(>=)
// A mixed number and one of the first kind.
#define THINSHELL_MIXED_OPERATOR(OP)                                                                                   \
  template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator OP(const Mixed<T, N, M> &a, const Dual<T, N> &b) { \
    return a OP Mixed<T, N, M>(b);                                                                                     \
  }                                                                                                                    \
  template <class T, int N, int M> THINSHELL_FN Mixed<T, N, M> operator OP(const Dual<T, N> &a, const Mixed<T, N, M> &b) { \
    return Mixed<T, N, M>(a) OP b;                                                                                     \
  }
THINSHELL_MIXED_OPERATOR(+)
THINSHELL_MIXED_OPERATOR(-)
THINSHELL_MIXED_OPERATOR(*)
THINSHELL_MIXED_OPERATOR(/)

}  // namespace thinshell
