// Four numbers at once: a scalar for laws without branches, which a processor works out side by side.
#pragma once

#include "small.hpp"

namespace thinshell {

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
  friend Pack operator-(const Pack &x) { return Pack(0.0) - x; }
  friend Pack sqrt(const Pack &x) {
    Pack out;
    for (int i = 0; i < size; ++i) out.a[i] = sqrt(x.a[i]);
    return out;
  }
  friend Pack atan2(const Pack &y, const Pack &x) {
    Pack out;
    for (int i = 0; i < size; ++i) out.a[i] = atan2(y.a[i], x.a[i]);
    return out;
  }
};

// A plain number for laws and dual numbers.
template <> constexpr bool is_number<Pack> = true;

}  // namespace thinshell
