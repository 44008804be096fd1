// Air drag on the triangles of sheets (sim_core/energies/air_drag.py), whose kernels are run as they are, lowered; with
// the normal n and the centroid c_n at the start of a step:
//
//     U = sum_T f_T / 6 |s|^3,    s = n . (c - c_n),    f = rho C_D A / dt^2
#pragma once

#include <vector>

#include "elements.hpp"
#include "lanes.hpp"

namespace thinshell {

class Drag {
 public:
  explicit Drag(const Record &record) : r_(record), count_(int(record.drags)), normal_(3 * record.drags), factor_(record.drags) {}

  bool any() const { return count_ > 0; }

  void couple(Blocks &h) const { each([&](int t, int a, int b) { h.couple(node(t, a), node(t, b)); }); }
  void bind(const Blocks &h) {
    slots_.clear();
    each([&](int t, int a, int b) { slots_.push_back(h.slot(node(t, a), node(t, b))); });
  }

  void begin(const double *x_start, double dt) {
    x_start_ = x_start;
    dt_ = dt;
    for (int t = 0; t < count_; ++t) {
      const Vec3 n = normal(point(x_start, node(t, 0)), point(x_start, node(t, 1)), point(x_start, node(t, 2)));
      std::copy(n.a, n.a + 3, &normal_[3 * t]);
      factor_[t] = r_.drag_factor[t] / (dt * dt);
    }
  }

  double energy(const double *x) const {
    double out = 0.0;
    if (any()) laws::air_drag::_energy(rows(x), rows(x_start_), triangles(), normals(), factors(), View<double, 1>(&out, 1));
    return out;
  }
  void add_gradient(const double *x, double *out) const {
    if (any())
      laws::air_drag::_gradient(rows(x), rows(x_start_), triangles(), normals(), factors(), View<double, 2>(out, r_.nodes, 3));
  }
  void add_hessian(const double *x, Blocks &h) const {
    const Slot *slot = slots_.data();
    for (int t = 0; t < count_; ++t) {
      const auto [s, n] = laws::air_drag::_advance(rows(x), rows(x_start_), triangles(), normals(), t);
      const Mat3 block = (factor_[t] * abs(s) / 9.0) * n.outer_product(n);
      for (int k = 0; k < 6; ++k) h.add(*slot++, block);
    }
  }

  // What forces change by where positions at the end are held, into (nodes, 3, columns).
  void add_columns(const double *x, const double *dx_start, double *out) const {
    const std::size_t width = r_.columns;
    const int own[3] = {0, 1, 2};
    for (int t = 0; t < count_; ++t)
      for (std::size_t first = 0; first < width; first += lanes) {
        Lanes start[9], force[9];
        double here[9];
        for (int k = 0; k < 9; ++k) {
          const std::size_t at = 3 * std::size_t(node(t, k / 3)) + k % 3;
          start[k] = seeded(x_start_[at], dx_start + at * width + first);
          here[k] = x[at];
        }
        const auto corner = [&](int a) { return Vec<Lanes, 3>{{start[3 * a], start[3 * a + 1], start[3 * a + 2]}}; };
        const Vec<Lanes, 3> n = normal(corner(0), corner(1), corner(2));
        const Lanes factor = seeded(r_.drag_factor[t], r_.d_drag_factor + t * width + first) / (dt_ * dt_);
        laws::air_drag::_gradient(View<const double, 2>(here, 3, 3), View<const Lanes, 2>(start, 3, 3),
                                  View<const int, 2>(own, 1, 3), View<const Lanes, 2>(n.a, 1, 3),
                                  View<const Lanes, 1>(&factor, 1), View<Lanes, 2>(force, 3, 3));
        for (int a = 0; a < 3; ++a) scatter(force + 3 * a, 3, out + 3 * std::size_t(node(t, a)) * width, width, int(first));
      }
  }

 private:
  template <class> friend struct Pull;

  template <class S> static Vec<S, 3> normal(const Vec<S, 3> &p, const Vec<S, 3> &q, const Vec<S, 3> &r) {
    return Vec<S, 3>(Vec<S, 3>(q - p).cross(Vec<S, 3>(r - p))).normalized();
  }
  template <class F> void each(F &&f) const {
    for (int t = 0; t < count_; ++t)
      for (int a = 0; a < 3; ++a)
        for (int b = a; b < 3; ++b) f(t, a, b);
  }
  int node(int t, int a) const { return r_.drag_triangle[3 * t + a]; }
  View<const double, 2> rows(const double *x) const { return {x, r_.nodes, 3}; }
  View<const int, 2> triangles() const { return {r_.drag_triangle, count_, 3}; }
  View<const double, 2> normals() const { return {normal_.data(), count_, 3}; }
  View<const double, 1> factors() const { return {factor_.data(), count_}; }

  const Record &r_;
  int count_;
  const double *x_start_ = nullptr;
  double dt_ = 1.0;
  std::vector<double> normal_, factor_;
  std::vector<Slot> slots_;
};

}  // namespace thinshell
