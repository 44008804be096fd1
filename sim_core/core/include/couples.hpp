// Couples that follow a body (sim_core/energies/couple.py): moments M_k about fixed axes on short lines of nodes,
//
//     E = -sum_k M_k phi_k
//
// phi_k: the turn of a line about the axis, counted from the start of the step.
#pragma once

#include <cmath>
#include <vector>

#include "blocks.hpp"
#include "record.hpp"
#include "small.hpp"

namespace thinshell {

class Couples {
 public:
  explicit Couples(const Record &record) : r_(record) {}

  void couple(Blocks &h) const {
    each([&](int a, int b, const Line &) { h.couple(a, b); });
  }
  void bind(const Blocks &h) {
    slots_.clear();
    each([&](int a, int b, const Line &) {
      for (const auto &[p, q] : {std::pair{a, a}, std::pair{b, b}, std::pair{a, b}}) slots_.push_back(h.slot(p, q));
    });
  }
  void begin(const double *x_start) { x_start_ = x_start; }

  double energy(const double *x) const {
    double out = 0.0;
    each([&](int a, int b, const Line &line) {
      const Vec3 d = line.across(point(x, b) - point(x, a)), first = line.across(point(x_start_, b) - point(x_start_, a));
      out -= line.moment * std::atan2(line.axis.cross(first).dot(d), first.dot(d));
    });
    return out;
  }
  void add_gradient(const double *x, double *out) const {
    each([&](int a, int b, const Line &line) {
      const Vec3 d = line.across(point(x, b) - point(x, a));
      const Vec3 force = (line.moment / d.dot(d)) * line.axis.cross(d);
      for (int k = 0; k < 3; ++k) {
        out[3 * a + k] += force[k];
        out[3 * b + k] -= force[k];
      }
    });
  }
  // One positive and one negative value: none of it unless `exact`.
  void add_hessian(const double *x, bool exact, Blocks &h) const {
    if (!exact) return;
    const Slot *slot = slots_.data();
    each([&](int a, int b, const Line &line) {
      const Vec3 d = line.across(point(x, b) - point(x, a)), turned = line.axis.cross(d);
      const double by = line.moment / (d.dot(d) * d.dot(d));
      Mat3 block, other;
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          block(i, j) = by * (d[i] * turned[j] + turned[i] * d[j]);
          other(i, j) = -block(i, j);
        }
      h.add(*slot++, block);
      h.add(*slot++, block);
      h.add(*slot++, other);
    });
  }

 private:
  struct Line {
    Vec3 axis;
    double moment;
    Vec3 across(const Vec3 &d) const { return d - d.dot(axis) * axis; }
  };
  template <class F> void each(F &&f) const {
    for (int k = 0; k < r_.couples; ++k)
      f(r_.couple_node[2 * k], r_.couple_node[2 * k + 1], Line{point(r_.couple_axis, k), r_.couple_moment[k]});
  }

  const Record &r_;
  std::vector<Slot> slots_;
  const double *x_start_ = nullptr;
};

}  // namespace thinshell
