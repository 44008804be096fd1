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

template <class T, int N> struct Dual {
  using Scalar = Dual;
  static constexpr int directions = N;
  T v;
  T d[N];
  THINSHELL_FN Dual() : v(0), d{} {}
  THINSHELL_FN Dual(T value) : v(value), d{} {}
  template <class U, class = typename EnableIf<is_number<U> && !Same<U, T>::value>::type>
  THINSHELL_FN Dual(U value) : v(T(value)), d{} {}
  // The value of a variable, whose direction is the i-th.
  static THINSHELL_FN Dual variable(T value, int i) { Dual out(value); out.d[i] = T(1); return out; }
  THINSHELL_FN explicit operator int() const { return int(v); }

  friend THINSHELL_FN Dual chain(const Dual &a, T f, T f1, T) {
    Dual out(f);
    THINSHELL_UNROLL for (int i = 0; i < N; ++i) out.d[i] = f1 * a.d[i];
    return out;
  }
  friend THINSHELL_FN Dual chain(const Dual &a, const Dual &b, T f, T fa, T fb, T, T, T) {
    Dual out(f);
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

template <class T, int N> struct RealUnder<Dual<T, N>> : RealUnder<T> {};
template <class T, int N> struct RealUnder<Dual2<T, N>> : RealUnder<T> {};

// Value of a dual number, and of a plain one.
template <class T, class = typename EnableIf<is_number<T>>::type> THINSHELL_FN T value(const T &x) { return x; }
template <class T, int N> THINSHELL_FN T value(const Dual<T, N> &x) { return x.v; }
template <class T, int N> THINSHELL_FN T value(const Dual2<T, N> &x) { return x.v; }

#define THINSHELL_DUAL_COMPARISON(D, OP)                                                                                \
  template <class T, int N> THINSHELL_FN bool operator OP(const D<T, N> &a, const D<T, N> &b) { return a.v OP b.v; }    \
  template <class T, int N, class U, class = typename EnableIf<is_number<U>>::type>                                     \
  THINSHELL_FN bool operator OP(const D<T, N> &a, U b) { return a.v OP T(b); }                                          \
  template <class T, int N, class U, class = typename EnableIf<is_number<U>>::type>                                     \
  THINSHELL_FN bool operator OP(U a, const D<T, N> &b) { return T(a) OP b.v; }

// An operator of two dual numbers, and of one and a plain number c, which has no derivative.
#define THINSHELL_DUAL_OPERATOR(D, OP, F, G, FA, FB, FAA, FAB, FBB, WITH_RIGHT, WITH_LEFT)                              \
  template <class T, int N> THINSHELL_FN D<T, N> operator OP(const D<T, N> &a, const D<T, N> &b) {                      \
    [[maybe_unused]] const T x = a.v, y = b.v, f = F, g = G;                                                            \
    return chain(a, b, f, T(FA), T(FB), T(FAA), T(FAB), T(FBB));                                                        \
  }                                                                                                                     \
  template <class T, int N, class U, class = typename EnableIf<is_number<U>>::type>                                     \
  THINSHELL_FN D<T, N> operator OP(const D<T, N> &a, U c) {                                                             \
    [[maybe_unused]] const T x = a.v, y = T(c), f = F, g = G; return WITH_RIGHT; }                                      \
  template <class T, int N, class U, class = typename EnableIf<is_number<U>>::type>                                     \
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
  THINSHELL_DUAL_OPERATOR(D, -, x - y, f, 1, -1, 0, 0, 0, shifted(a, g), chain(b, g, T(-1), T(0)))                      \
  THINSHELL_DUAL_OPERATOR(D, *, x * y, f, y, x, 0, 1, 0, chain(a, g, y, T(0)), chain(b, g, x, T(0)))                    \
  THINSHELL_DUAL_OPERATOR(D, /, x / y, T(1) / y, g, -f * g, 0, -g * g, T(2) * f * g * g, chain(a, f, g, T(0)),          \
                          chain(b, f, -f * g, T(2) * f * g * g))                                                        \
  template <class T, int N> THINSHELL_FN D<T, N> operator-(const D<T, N> &a) { return chain(a, -a.v, T(-1), T(0)); }    \
  template <class T, int N> THINSHELL_FN D<T, N> operator+(const D<T, N> &a) { return a; }                              \
  THINSHELL_DUAL_FUNCTION(D, abs, abs(x), x < T(0) ? T(-1) : T(1), T(0))                                                \
  THINSHELL_DUAL_FUNCTION(D, sqrt, sqrt(x), f > T(0) ? T(0.5) / f : T(0), f > T(0) ? T(-0.5) * g / x : T(0))            \
  THINSHELL_DUAL_FUNCTION(D, exp, exp(x), f, f)                                                                         \
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
  template <class T, int N, class U, class = typename EnableIf<is_number<U>>::type>                                     \
  THINSHELL_FN D<T, N> pow(const D<T, N> &a, U p) {                                                                     \
    const T x = a.v, n = T(p), m = n * (n - T(1));                                                                      \
    return chain(a, pow(x, n), n == T(0) ? n : n * pow(x, n - T(1)), m == T(0) ? m : m * pow(x, n - T(2)));             \
  }                                                                                                                     \
  template <class T, int N> THINSHELL_FN D<T, N> pow(const D<T, N> &a, const D<T, N> &p) { return exp(p * log(a)); }    \
  template <class T, int N, class U, class = typename EnableIf<is_number<U>>::type>                                     \
  THINSHELL_FN D<T, N> pow(U a, const D<T, N> &p) { return exp(p * T(log(T(a)))); }

// The same derivatives at another value.
template <class D, class T> THINSHELL_FN D shifted(const D &a, T f) { D out = a; out.v = f; return out; }

THINSHELL_DUAL(Dual)
THINSHELL_DUAL(Dual2)
#undef THINSHELL_DUAL
#undef THINSHELL_DUAL_FUNCTION
#undef THINSHELL_DUAL_OPERATOR
#undef THINSHELL_DUAL_COMPARISON

}  // namespace thinshell
