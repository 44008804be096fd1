// Dead loads and pressures of a rig, each times a value of its time table at the end of the step
// (sim_core/energies/dead_load.py, sim_core/energies/pressure.py):
//
//     E = -s f . sum_k w_k x_k,    E = -p s sum_q w_q W(u, g, h; g_s, h_s)
//
// W: the volume swept at a point of a face, whose derivatives are those of dual numbers, by
// z = (u, g, h, g_s, h_s), of which each is a sum over the nodes of the face.
#pragma once

#include <vector>

#include "blocks.hpp"
#include "lanes.hpp"
#include "laws.hpp"
#include "record.hpp"
#include "small.hpp"

namespace thinshell {

template <class> struct Pull;

class Loads {
 public:
  explicit Loads(const Record &record) : r_(record), now_(record.loads, 0.0) {}

  bool any() const { return r_.loads > 0; }

  void couple(Blocks &h) const {
    each([&](const Face &f) { pairs(f, [&](int a, int b) { h.couple(f.node[a], f.node[b]); }); });
  }
  void bind(const Blocks &h) {
    slots_.clear();
    each([&](const Face &f) { pairs(f, [&](int a, int b) { slots_.push_back(h.slot(f.node[a], f.node[b])); }); });
  }

  // `end`: of the step [s].
  void begin(const double *x_start, double end) {
    x_start_ = x_start;
    for (int k = 0; k < r_.loads; ++k) now_[k] = value_at(k, end);
  }

  double energy(const double *x) const {
    double out = 0.0;
    each_dead([&](int k, int node, double weight) {
      for (int i = 0; i < 3; ++i) out -= now_[k] * weight * number(k)[i] * x[3 * node + i];
    });
    each_point([&](const Face &f, const Point &p) {
      double z[size];
      see(f, p, x, z);
      out -= now_[f.load] * number(f.load)[0] * p.weight * swept(z);
    });
    return out;
  }

  void add_gradient(const double *x, double *out) const {
    each_dead([&](int k, int node, double weight) {
      for (int i = 0; i < 3; ++i) out[3 * node + i] -= now_[k] * weight * number(k)[i];
    });
    each_point([&](const Face &f, const Point &p) {
      Dual<double, own> z[size];
      seed<own>(f, p, x, z);
      const auto found = swept(z);
      const double by = now_[f.load] * number(f.load)[0] * p.weight;
      for (int a = 0; a < f.nodes; ++a)
        for (int i = 0; i < 3; ++i)
          for (int part = 0; part < 3; ++part) out[3 * f.node[a] + i] -= by * p.share(part, a) * found.d[3 * part + i];
    });
  }

  // Positive and negative values alike: none of it unless `exact`.
  void add_hessian(const double *x, bool exact, Blocks &h) const {
    if (!exact) return;
    const Slot *slot = slots_.data();
    each([&](const Face &f) {
      Mat3 block[6][6] = {};
      points(f, [&](const Point &p) {
        Dual2<double, own> z[size];
        seed<own>(f, p, x, z);
        const auto found = swept(z);
        const double by = -now_[f.load] * number(f.load)[0] * p.weight;
        pairs(f, [&](int a, int b) {
          for (int q = 0; q < 3; ++q)
            for (int r = 0; r < 3; ++r) {
              const double both = by * p.share(q, a) * p.share(r, b);
              for (int i = 0; i < 3; ++i)
                for (int j = 0; j < 3; ++j) block[a][b](i, j) += both * found.second(3 * q + i, 3 * r + j);
            }
        });
      });
      pairs(f, [&](int a, int b) { h.add(*slot++, block[a][b]); });
    });
  }

  // What forces change by where positions at the end are held, into (nodes, 3, columns).
  void add_columns(const double *x, const double *dx_start, double *out) const {
    const std::size_t width = r_.columns;
    each_dead([&](int k, int node, double weight) {
      for (int i = 0; i < 3; ++i)
        for (std::size_t c = 0; c < width; ++c) out[(3 * node + i) * width + c] -= now_[k] * weight * d_number(k, i)[c];
    });
    each_point([&](const Face &f, const Point &p) {
      Dual2<double, size> z[size];
      seed<size>(f, p, x, z);
      const auto found = swept(z);
      const double by = now_[f.load] * p.weight, pressure = number(f.load)[0];
      for (std::size_t c = 0; c < width; ++c) {
        double change[size] = {};  // of z
        for (int a = 0; a < f.nodes; ++a)
          for (int i = 0; i < 3; ++i) {
            const double moved = dx_start[(3 * f.node[a] + i) * width + c];
            change[i] -= p.share(0, a) * moved;
            change[own + i] += p.share(1, a) * moved;
            change[own + 3 + i] += p.share(2, a) * moved;
          }
        for (int k = 0; k < own; ++k) {
          double total = d_number(f.load, 0)[c] * found.d[k];
          for (int l = 0; l < size; ++l) total += pressure * found.second(k, l) * change[l];
          for (int a = 0; a < f.nodes; ++a) out[(3 * f.node[a] + k % 3) * width + c] -= by * p.share(k / 3, a) * total;
        }
      }
    });
  }

 private:
  template <class> friend struct Pull;
  static constexpr int own = 9, size = 15;  // numbers of z at the end of the step, and all

  struct Face {
    int load, nodes;
    const int32_t *node;
    bool straight() const { return nodes == 3; }
  };
  // A point of the rule, with shape functions and their slopes.
  struct Point {
    double weight;
    const double *shape, *slope;
    double share(int part, int a) const { return part == 0 ? shape[a] : slope[2 * a + part - 1]; }
  };

  template <class S> static S swept(const S *z) {
    auto vector = [&](int k) { return Vec<S, 3>{{z[3 * k], z[3 * k + 1], z[3 * k + 2]}}; };
    return laws::pressure::swept(vector(0), vector(1), vector(2), vector(3), vector(4));
  }

  double value_at(int k, double t) const {
    const int first = r_.load_table_start[k], last = r_.load_table_start[k + 1] - 1;
    if (last < first) return 1.0;
    const double *times = r_.load_time, *values = r_.load_value;
    if (t <= times[first]) return values[first];
    for (int at = first; at < last; ++at)
      if (t < times[at + 1])
        return values[at] + (values[at + 1] - values[at]) * (t - times[at]) / (times[at + 1] - times[at]);
    return values[last];
  }
  const double *number(int k) const { return r_.load_number + 3 * k; }
  const double *d_number(int k, int i) const { return r_.d_load_number + (3 * k + i) * r_.columns; }

  template <class F> void each_dead(F &&f) const {
    for (int k = 0; k < r_.loads; ++k)
      for (int n = r_.dead_start[k]; n < r_.dead_start[k + 1]; ++n) f(k, r_.dead_node[n], r_.dead_weight[n]);
  }
  template <class F> void each(F &&f) const {
    for (int k = 0; k < r_.loads; ++k)
      for (int n = r_.face_start[k]; n < r_.face_start[k + 1]; ++n)
        f(Face{k, r_.face_node[6 * n + 3] < 0 ? 3 : 6, r_.face_node + 6 * n});
  }
  // The rules of faces with 3 nodes, one point, and with 6, six points, lie one behind the other.
  template <class F> void points(const Face &face, F &&f) const {
    const int count = face.straight() ? 1 : 6, first = face.straight() ? 0 : 1, offset = face.straight() ? 0 : 3;
    for (int q = 0; q < count; ++q) {
      const double *shape = r_.rule_shape + offset + face.nodes * q, *slope = r_.rule_slope + 2 * (offset + face.nodes * q);
      f(Point{r_.rule_weight[first + q], shape, slope});
    }
  }
  template <class F> void each_point(F &&f) const {
    each([&](const Face &face) { points(face, [&](const Point &p) { f(face, p); }); });
  }
  template <class F> void pairs(const Face &face, F &&f) const {
    for (int a = 0; a < face.nodes; ++a)
      for (int b = a; b < face.nodes; ++b) f(a, b);
  }

  void see(const Face &f, const Point &p, const double *x, double *z) const {
    std::fill(z, z + size, 0.0);
    for (int a = 0; a < f.nodes; ++a)
      for (int i = 0; i < 3; ++i) {
        const double there = x[3 * f.node[a] + i], start = x_start_[3 * f.node[a] + i];
        z[i] += p.share(0, a) * (there - start);
        for (int part = 1; part < 3; ++part) {
          z[3 * part + i] += p.share(part, a) * there;
          z[6 + 3 * part + i] += p.share(part, a) * start;
        }
      }
  }
  // The same as variables, the first `count` of them.
  template <int count, class D> void seed(const Face &f, const Point &p, const double *x, D *z) const {
    double at[size];
    see(f, p, x, at);
    for (int k = 0; k < size; ++k) z[k] = k < count ? D::variable(at[k], k) : D(at[k]);
  }

  const Record &r_;
  std::vector<double> now_;
  std::vector<Slot> slots_;
  const double *x_start_ = nullptr;
};

}  // namespace thinshell
