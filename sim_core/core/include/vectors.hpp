// Vectors of the searches on a CPU. A thread block has its own (sim_core/gpu/include/vectors.hpp), with the same functions.
#pragma once

#include <cmath>
#include <cstddef>
#include <vector>

namespace thinshell {

using Values = std::vector<double>;

inline double dot(const Values &a, const Values &b) {
  double out = 0.0;
#pragma omp simd reduction(+ : out)
  for (std::size_t k = 0; k < a.size(); ++k) out += a[k] * b[k];
  return out;
}

// Largest absolute value; one that is no number stays.
inline double largest(const double *v, std::size_t count) {
  double out = 0.0;
  for (std::size_t k = 0; k < count; ++k) {
    const double a = std::abs(v[k]);
    if (!(a <= out)) out = a;
  }
  return out;
}
inline double largest(const Values &v) { return largest(v.data(), v.size()); }

inline void scale(Values &v, double by) {
  for (double &x : v) x *= by;
}
// to += by * of
inline void add_scaled(Values &to, double by, const Values &of) {
  for (std::size_t k = 0; k < to.size(); ++k) to[k] += by * of[k];
}
// out = (a - b) / over
inline void set_slope(Values &out, const Values &a, const Values &b, double over) {
  out.resize(a.size());
  for (std::size_t k = 0; k < a.size(); ++k) out[k] = (a[k] - b[k]) / over;
}

// Changes of the inverse of a kept tangent, and the steps that they were learnt from (tangent.hpp).
class Corrections {
 public:
  void clear() { pairs_.clear(); }
  int count() const { return int(pairs_.size()); }
  const Values &change(int k) const { return pairs_[k].first; }
  const Values &step(int k) const { return pairs_[k].second; }
  void push(const Values &change, const Values &step) { pairs_.emplace_back(change, step); }

 private:
  std::vector<std::pair<Values, Values>> pairs_;
};

}  // namespace thinshell
