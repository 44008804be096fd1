// Four numbers at once: a scalar for laws without branches, which a processor works out side by side. What comparisons
// of it find is a mask, by which `select`, and so `max`, `min` and `abs`, choose.
#pragma once

#include <cstdint>

#include "dual.hpp"

namespace thinshell {

// What is true of four numbers.
struct Mask {
  typedef int64_t Values __attribute__((vector_size(4 * sizeof(int64_t))));
  Values a;
  friend Mask operator&&(const Mask &x, const Mask &y) { return {x.a & y.a}; }
  friend Mask operator||(const Mask &x, const Mask &y) { return {x.a | y.a}; }
  friend Mask operator!(const Mask &x) { return {~x.a}; }
};

struct Pack {
  static constexpr int size = 4;
  typedef double Values __attribute__((vector_size(size * sizeof(double))));  // of GCC and Clang
  Values a;
  Pack() = default;
  Pack(Values values) : a(values) {}
  Pack(double value) : a{value, value, value, value} {}

#define THINSHELL_PACK_OPERATOR(OP)                                                            \
  friend Pack operator OP(const Pack &x, const Pack &y) { return x.a OP y.a; }                 \
  friend Pack operator OP(const Pack &x, double y) { return x OP Pack(y); }                    \
  friend Pack operator OP(double x, const Pack &y) { return Pack(x) OP y; }                    \
  friend Pack &operator OP##=(Pack &x, const Pack &y) { return x = x OP y; }
  THINSHELL_PACK_OPERATOR(+)
  THINSHELL_PACK_OPERATOR(-)
  THINSHELL_PACK_OPERATOR(*)
  THINSHELL_PACK_OPERATOR(/)
#undef THINSHELL_PACK_OPERATOR
#define THINSHELL_PACK_COMPARISON(OP)                                                          \
  friend Mask operator OP(const Pack &x, const Pack &y) { return {x.a OP y.a}; }               \
  friend Mask operator OP(const Pack &x, double y) { return x OP Pack(y); }                    \
  friend Mask operator OP(double x, const Pack &y) { return Pack(x) OP y; }
  THINSHELL_PACK_COMPARISON(<)
  THINSHELL_PACK_COMPARISON(>)
  THINSHELL_PACK_COMPARISON(<=)
  THINSHELL_PACK_COMPARISON(>=)
  THINSHELL_PACK_COMPARISON(==)
  THINSHELL_PACK_COMPARISON(!=)
#undef THINSHELL_PACK_COMPARISON
  friend Pack operator-(const Pack &x) { return Pack(0.0) - x; }
  friend Pack operator+(const Pack &x) { return x; }
  friend Pack abs(const Pack &x) { return (x < 0.0).a ? (-x).a : x.a; }
  friend Pack pow(const Pack &x, const Pack &p) {
    Pack out;
    for (int i = 0; i < size; ++i) out.a[i] = pow(x.a[i], p.a[i]);
    return out;
  }
#define THINSHELL_PACK_FUNCTION(NAME)                                                          \
  friend Pack NAME(const Pack &x) {                                                            \
    Pack out;                                                                                  \
    for (int i = 0; i < size; ++i) out.a[i] = NAME(x.a[i]);                                    \
    return out;                                                                                \
  }
  THINSHELL_PACK_FUNCTION(sqrt)
  THINSHELL_PACK_FUNCTION(exp)
  THINSHELL_PACK_FUNCTION(expm1)
  THINSHELL_PACK_FUNCTION(log)
  THINSHELL_PACK_FUNCTION(sin)
  THINSHELL_PACK_FUNCTION(cos)
  THINSHELL_PACK_FUNCTION(tan)
  THINSHELL_PACK_FUNCTION(tanh)
  THINSHELL_PACK_FUNCTION(atan)
  THINSHELL_PACK_FUNCTION(asin)
  THINSHELL_PACK_FUNCTION(acos)
  THINSHELL_PACK_FUNCTION(floor)
  THINSHELL_PACK_FUNCTION(ceil)
#undef THINSHELL_PACK_FUNCTION
  friend Pack atan2(const Pack &y, const Pack &x) {
    Pack out;
    for (int i = 0; i < size; ++i) out.a[i] = atan2(y.a[i], x.a[i]);
    return out;
  }
};

// A plain number for laws and dual numbers.
template <> constexpr bool is_number<Pack> = true;

inline Pack chosen(const Mask &which, const Pack &yes, const Pack &no) { return which.a ? yes.a : no.a; }
template <int N> Dual<Pack, N> chosen(const Mask &which, const Dual<Pack, N> &yes, const Dual<Pack, N> &no) {
  Dual<Pack, N> out(chosen(which, yes.v, no.v));
  for (int i = 0; i < N; ++i) out.d[i] = chosen(which, yes.d[i], no.d[i]);
  return out;
}
template <int N> Dual2<Pack, N> chosen(const Mask &which, const Dual2<Pack, N> &yes, const Dual2<Pack, N> &no) {
  Dual2<Pack, N> out(chosen(which, yes.v, no.v));
  for (int i = 0; i < N; ++i) out.d[i] = chosen(which, yes.d[i], no.d[i]);
  for (int i = 0; i < N * (N + 1) / 2; ++i) out.h[i] = chosen(which, yes.h[i], no.h[i]);
  return out;
}
template <class A, class B> auto select(const Mask &which, const A &yes, const B &no) {
  using C = Common<Pack, A, B>;
  return chosen(which, C(yes), C(no));
}

}  // namespace thinshell
