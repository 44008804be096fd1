// Numbers with their derivatives by some of the parameters, a few columns at a time.
#pragma once

#include <cstddef>

#include "dual.hpp"

namespace thinshell {

constexpr int lanes = 8;  // columns that are differentiated at once
using Lanes = Along<double, lanes>;

inline Lanes seeded(double value, const double *d) {
  Lanes out(value);
  for (int l = 0; l < lanes; ++l) out.d[l] = d[l];
  return out;
}

inline void scatter(const Lanes *v, int rows, double *out, std::size_t columns, int first) {
  for (int i = 0; i < rows; ++i)
    for (int l = 0; l < lanes; ++l) out[i * columns + first + l] += v[i].d[l];
}

}  // namespace thinshell
