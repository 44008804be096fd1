// Guides of sliders (sim_core/energies/guide.py): a point of one body on a line through another,
//
//     E = k/2 |r x d|^2,    r = sum_i a_i x_i,   d = sum_i l_i x_i,
//
// over the nodes of both bodies. Derivatives by r and d are those of dual numbers.
#pragma once

#include <vector>

#include "affine.hpp"

namespace thinshell {

class Guides {
 public:
  static constexpr int corners = 8;

  explicit Guides(const Record &record) : r_(record) {}

  void couple(Blocks &h) const {
    each_pair([&](int g, int i, int j) { h.couple(node(g, i), node(g, j)); });
  }
  void bind(const Blocks &h) {
    slots_.clear();
    each_pair([&](int g, int i, int j) { slots_.push_back(h.slot(node(g, i), node(g, j))); });
  }

  double energy(const double *x) const {
    double out = 0.0;
    for (int g = 0; g < r_.guides; ++g) out += energy_at(ends<Dual<double, 6>>(x, g), g).v;
    return out;
  }
  void add_gradient(const double *x, double *out) const {
    for (int g = 0; g < r_.guides; ++g) {
      const auto found = energy_at(ends<Dual<double, 6>>(x, g), g);
      for (int i = 0; i < corners; ++i)
        for (int k = 0; k < 3; ++k)
          out[3 * node(g, i) + k] += weight(g, i, 0) * found.d[k] + weight(g, i, 1) * found.d[3 + k];
    }
  }
  void add_hessian(const double *x, bool exact, Blocks &h) const {
    const Slot *slot = slots_.data();
    for (int g = 0; g < r_.guides; ++g) {
      const auto found = energy_at(ends<Dual2<double, 6>>(x, g), g);
      double second[36];
      for (int i = 0; i < 6; ++i)
        for (int j = 0; j < 6; ++j) second[6 * i + j] = found.second(i, j);
      if (!exact) make_semidefinite<6>(second);
      for (int i = 0; i < corners; ++i)
        for (int j = i; j < corners; ++j, ++slot) {
          Mat3 block{};
          for (int a = 0; a < 2; ++a)
            for (int b = 0; b < 2; ++b)
              for (int k = 0; k < 9; ++k)
                block.a[k] += weight(g, i, a) * weight(g, j, b) * second[6 * (3 * a + k / 3) + 3 * b + k % 3];
          h.add(*slot, block);
        }
    }
  }

 private:
  template <class F> void each_pair(F &&f) const {
    for (int g = 0; g < r_.guides; ++g)
      for (int i = 0; i < corners; ++i)
        for (int j = i; j < corners; ++j) f(g, i, j);
  }
  int node(int g, int i) const { return r_.guide_node[corners * g + i]; }
  double weight(int g, int i, int which) const { return r_.guide_weight[2 * (corners * g + i) + which]; }

  template <class D> struct Ends {
    Vec<D, 3> r, d;
  };
  template <class D> Ends<D> ends(const double *x, int g) const {
    Vec3 found[2] = {};
    for (int i = 0; i < corners; ++i)
      for (int a = 0; a < 2; ++a) found[a] += weight(g, i, a) * point(x, node(g, i));
    Ends<D> out;
    for (int k = 0; k < 3; ++k) {
      out.r[k] = D::variable(found[0][k], k);
      out.d[k] = D::variable(found[1][k], 3 + k);
    }
    return out;
  }
  template <class D> D energy_at(const Ends<D> &at, int g) const {
    return 0.5 * r_.guide_stiffness[g] * at.r.cross(at.d).norm_sqr();
  }

  const Record &r_;
  std::vector<Slot> slots_;
};

}  // namespace thinshell
