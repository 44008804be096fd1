// Pressures, mounts that give way and drag on the way back (elements_pull.hpp).
#pragma once

#include "contact_pull.hpp"
#include "drag.hpp"
#include "loads.hpp"
#include "yielding.hpp"

namespace thinshell {

template <> struct Pull<Loads> {
  Pull(Loads &loads, const Record &record) : l_(loads), r_(record) {}

  void to_start(const double *x, StepWeights &w) {
    const std::vector<double> &y = w.residual;
    l_.each_dead([&](int k, int node, double weight) {
      for (int i = 0; i < 3; ++i) number(k, i, -l_.now_[k] * weight * y[3 * node + i], w);
    });
    l_.each_point([&](const Loads::Face &f, const Loads::Point &p) {
      constexpr int own = Loads::own, size = Loads::size;
      Dual2<double, size> z[size];
      l_.seed<size>(f, p, x, z);
      const auto found = Loads::swept(z);
      const double by = -l_.now_[f.load] * p.weight, pressure = l_.number(f.load)[0];
      double along[own] = {}, total = 0.0;  // of the weights, by u, g and h
      for (int k = 0; k < own; ++k) {
        for (int a = 0; a < f.nodes; ++a) along[k] += p.share(k / 3, a) * y[3 * f.node[a] + k % 3];
        total += along[k] * found.d[k];
      }
      number(f.load, 0, by * total, w);
      for (int l = 0; l < size; ++l) {
        if (l >= 3 && l < own) continue;  // sides at the end
        double back = 0.0;
        for (int k = 0; k < own; ++k) back += along[k] * found.second(k, l);
        const int part = l < 3 ? 0 : l / 3 - 2;
        for (int a = 0; a < f.nodes; ++a)
          w.start[3 * f.node[a] + l % 3] += (l < 3 ? -1.0 : 1.0) * by * pressure * back * p.share(part, a);
      }
    });
  }

 private:
  void number(int k, int i, double weight, StepWeights &w) const {
    for (int c = 0; c < r_.columns; ++c) w.numbers[c] += weight * r_.d_load_number[std::size_t(3 * k + i) * r_.columns + c];
  }
  Loads &l_;
  const Record &r_;
};

template <> struct Pull<Yielding> {
  Pull(Yielding &yielding, const Record &record) : y_(yielding), r_(record) {}

  void to_start(const double *x, StepWeights &w) {
    for (int a = 0; a < y_.count(); ++a)
      for (int c = 0; c < r_.columns; ++c)
        w.numbers[c] += w.residual[y_.first() + a] * r_.d_yield_spring[a * r_.columns + c] * x[y_.first() + a];
  }

 private:
  Yielding &y_;
  const Record &r_;
};

template <> struct Pull<Drag> {
  Pull(Drag &drag, const Record &record) : d_(drag), r_(record) {}

  void to_start(const double *x, const double *x_start, StepWeights &w) {
    const int own[3] = {0, 1, 2};
    for (int t = 0; t < d_.count_; ++t) {
      trace_.clear();
      const Trace::Scope scope(trace_);
      Noted start[9], force[9];
      double here[9];
      const auto at = [&](int k) { return 3 * std::size_t(d_.node(t, k / 3)) + k % 3; };
      for (int k = 0; k < 9; ++k) {
        start[k] = noted(x_start[at(k)]);
        here[k] = x[at(k)];
      }
      const auto corner = [&](int a) { return Vec<Noted, 3>{{start[3 * a], start[3 * a + 1], start[3 * a + 2]}}; };
      const Vec<Noted, 3> n = Drag::normal(corner(0), corner(1), corner(2));
      const Noted given = noted(r_.drag_factor[t]), factor = given / (d_.dt_ * d_.dt_);
      laws::air_drag::_gradient(View<const double, 2>(here, 3, 3), View<const Noted, 2>(start, 3, 3),
                                View<const int, 2>(own, 1, 3), View<const Noted, 2>(n.a, 1, 3),
                                View<const Noted, 1>(&factor, 1), View<Noted, 2>(force, 3, 3));
      for (int k = 0; k < 9; ++k)
        if (force[k].at) trace_.weight(force[k].at) += w.residual[at(k)];
      trace_.sweep(0, trace_.size());
      for (int k = 0; k < 9; ++k) w.start[at(k)] += trace_.weight(start[k].at);
      if (w.by_elements) w.elements.drag_factor[t] += trace_.weight(given.at);
      for (int c = 0; c < r_.columns; ++c)
        w.numbers[c] += trace_.weight(given.at) * r_.d_drag_factor[std::size_t(t) * r_.columns + c];
    }
  }

 private:
  Drag &d_;
  const Record &r_;
  Trace trace_;
};

}  // namespace thinshell
