// Mounts that give way under load by a translation (sim_core/solve/unknowns.py): with the deflection u of a mount, what
// it holds is at
//
//     x_i = target_i + u,    E = 1/2 sum_a k_a u_a^2
//
// Deflections stand behind the nodes in all arrays of positions, as nodes without mass that have unknowns of their own.
#pragma once

#include <utility>
#include <vector>

#include "record.hpp"

namespace thinshell {

class Yielding {
 public:
  explicit Yielding(const Record &record) : r_(record), first_(3 * int(record.nodes)) {
    if (!any()) return;
    lead_.assign(first_, -1);
    for (int k = 0; k < first_; ++k) {
      if (r_.yield_of[k] < 0) continue;
      lead_[k] = first_ + 3 * r_.yield_of[k] + k % 3;
      led_.emplace_back(k, lead_[k]);
    }
  }

  bool any() const { return r_.yielding > 0; }
  // Components of all deflections, which begin at `first`.
  int count() const { return 3 * int(r_.yielding); }
  int first() const { return first_; }
  double spring(int a) const { return r_.yield_spring[a]; }
  // The deflection that a component follows, -1: none.
  int lead(int component) const { return any() ? lead_[component] : -1; }
  bool leads(int node) const { return lead(3 * node) >= 0 || lead(3 * node + 1) >= 0 || lead(3 * node + 2) >= 0; }

  // Put what is held at its targets, by the deflections further.
  void place(const double *targets, double *x) const {
    for (const auto &[k, by] : led_) x[k] = targets[k] + x[by];
  }
  // Where positions, or moves of what is held, lie without the deflections.
  void strip(double *x) const {
    for (const auto &[k, by] : led_) x[k] -= x[by];
  }
  // Let what is held move with the deflections as well, `width` columns, innermost.
  void follow(double *move, int width = 1) const {
    for (const auto &[k, by] : led_)
      for (int c = 0; c < width; ++c) move[std::size_t(k) * width + c] += move[std::size_t(by) * width + c];
  }
  // Carry forces on what is held to the deflections.
  void fold(double *force, int width = 1) const {
    for (const auto &[k, by] : led_)
      for (int c = 0; c < width; ++c) force[std::size_t(by) * width + c] += force[std::size_t(k) * width + c];
  }
  // Deflections of which what is held is at `x`, into it.
  void read(const double *targets, double *x) const {
    for (const auto &[k, by] : led_) x[by] = x[k] - targets[k];
  }

  double energy(const double *x) const {
    double out = 0.0;
    for (int a = 0; a < count(); ++a) out += 0.5 * spring(a) * x[first_ + a] * x[first_ + a];
    return out;
  }
  void add_gradient(const double *x, double *out) const {
    for (int a = 0; a < count(); ++a) out[first_ + a] += spring(a) * x[first_ + a];
  }
  // By the springs, into (components, columns).
  void add_columns(const double *x, double *out) const {
    const std::size_t width = r_.columns;
    for (int a = 0; a < count(); ++a)
      for (std::size_t c = 0; c < width; ++c)
        out[(first_ + a) * width + c] += r_.d_yield_spring[a * width + c] * x[first_ + a];
  }

 private:
  const Record &r_;
  int first_;
  std::vector<int> lead_;
  std::vector<std::pair<int, int>> led_;
};

}  // namespace thinshell
