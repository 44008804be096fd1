// What keeps a free rigid body rigid (sim_core/energies/affine.py): with A = sum_k x_k (x) b_k of its control nodes,
//
//     E = 1/2 K |G|^2,    G = (A^T A - 1) / 2,    K = 8 V kappa
//
// and nodes that are linear combinations of others (sim_core/solve/embedding.py): x_i = sum_k w_ik x_k.
#pragma once

#include <cmath>
#include <vector>

#include "blocks.hpp"
#include "elements.hpp"
#include "laws.hpp"
#include "record.hpp"

namespace thinshell {

class Bodies {
 public:
  explicit Bodies(const Record &record) : r_(record) {}

  void couple(Blocks &h) const {
    for (int e = 0; e < r_.bodies; ++e)
      for (int k = 0; k < 4; ++k)
        for (int m = k; m < 4; ++m) h.couple(node(e, k), node(e, m));
  }
  void bind(const Blocks &h) {
    slots_.clear();
    for (int e = 0; e < r_.bodies; ++e)
      for (int k = 0; k < 4; ++k)
        for (int m = k; m < 4; ++m) slots_.push_back(h.slot(node(e, k), node(e, m)));
  }

  double energy(const double *x) const {
    double out = 0.0;
    for (int e = 0; e < r_.bodies; ++e) out += 0.5 * stiffness(e) * strain(gradient_of(x, e)).norm_sqr();
    return out;
  }
  void add_gradient(const double *x, double *out) const {
    for (int e = 0; e < r_.bodies; ++e) {
      const Mat3 a = gradient_of(x, e), p = stiffness(e) * matmul(a, strain(a));
      for (int k = 0; k < 4; ++k) add(out, node(e, k), matmul(p, slope(e, k)));
    }
  }
  // `move`: by which the stress is foreseen, null: the true one.
  void add_hessian(const double *x, const double *move, bool exact, Blocks &h) const {
    const Slot *slot = slots_.data();
    for (int e = 0; e < r_.bodies; ++e) {
      const Mat3 a = gradient_of(x, e);
      Mat3 s = stiffness(e) * strain(a);
      if (move) {
        const Mat3 change = gradient_of(move, e);
        s -= 0.5 * stiffness(e) * matmul(change.transpose(), change);
      }
      if (!exact) {
        const auto [values, axes] = laws::projection::symmetric_eigen(s);
        s = Mat3{};
        for (int k = 0; k < 3; ++k) {
          const Vec3 axis = {{axes(0, k), axes(1, k), axes(2, k)}};
          s += std::max(values[k], 0.0) * axis.outer_product(axis);
        }
      }
      const Mat3 left = matmul(a, a.transpose());
      for (int k = 0; k < 4; ++k)
        for (int m = k; m < 4; ++m, ++slot) {
          const Vec3 bk = slope(e, k), bm = slope(e, m);
          Mat3 block = 0.5 * stiffness(e) * (bk.dot(bm) * left + Vec3(matmul(a, bm)).outer_product(Vec3(matmul(a, bk))));
          const double geometric = bk.dot(Vec3(matmul(s, bm)));
          for (int i = 0; i < 3; ++i) block(i, i) += geometric;
          h.add(*slot, block);
        }
    }
  }

  // Give bodies whose control nodes are all free (bool by component), where they are in `x`, the strain that the move of
  // their nodes from `start` has to first order (AffineShape.straighten); false when there are none.
  bool straighten(const double *start, const std::vector<bool> &free, double *x) const {
    for (int e = 0; e < r_.bodies; ++e) {
      bool all = true;
      for (int k = 0; k < 4; ++k)
        for (int i = 0; i < 3; ++i) all = all && free[3 * node(e, k) + i];
      if (!all) continue;
      const Mat3 before = gradient_of(start, e), now = gradient_of(x, e);
      const Mat3 half = matmul(before.transpose(), Mat3(now - 0.5 * before));
      const Mat3 stretch = root(Mat3(half + half.transpose()), 0.5);
      const Mat3 turn = matmul(now, root(Mat3(matmul(now.transpose(), now)), -0.5)), put = matmul(turn, stretch);
      Vec3 middle{}, rest{};
      for (int k = 0; k < 4; ++k) {
        middle += 0.25 * point(x, node(e, k));
        rest += 0.25 * point(r_.rest, node(e, k));
      }
      for (int k = 0; k < 4; ++k) {
        const Vec3 there = middle + matmul(put, Vec3(point(r_.rest, node(e, k)) - rest));
        std::copy(there.a, there.a + 3, x + 3 * node(e, k));
      }
    }
    return r_.bodies > 0;
  }

 private:
  int node(int e, int k) const { return r_.body_control[4 * e + k]; }
  double stiffness(int e) const { return r_.body_stiffness[e]; }
  Vec3 slope(int e, int k) const { return point(r_.body_slope, 4 * e + k); }

  Mat3 gradient_of(const double *x, int e) const {
    Mat3 out{};
    for (int k = 0; k < 4; ++k) out += Vec3(point(x, node(e, k))).outer_product(slope(e, k));
    return out;
  }
  static Mat3 strain(const Mat3 &a) {
    Mat3 out = 0.5 * matmul(a.transpose(), a);
    for (int i = 0; i < 3; ++i) out(i, i) -= 0.5;
    return out;
  }
  // Power of a symmetric matrix, negative eigenvalues taken as zero.
  static Mat3 root(const Mat3 &m, double power) {
    const auto [values, axes] = laws::projection::symmetric_eigen(m);
    Mat3 out{};
    for (int k = 0; k < 3; ++k) {
      const Vec3 axis = {{axes(0, k), axes(1, k), axes(2, k)}};
      out += std::pow(std::max(values[k], 0.0), power) * axis.outer_product(axis);
    }
    return out;
  }

  const Record &r_;
  std::vector<Slot> slots_;
};

class Embedding {
 public:
  explicit Embedding(const Record &record) : r_(record) {}

  bool any() const { return r_.embedded > 0; }
  int count() const { return int(r_.embedded); }
  int node(int e) const { return r_.embedded_node[e]; }
  int begin(int e) const { return r_.embedded_start[e]; }
  int end(int e) const { return r_.embedded_start[e + 1]; }
  int in(int k) const { return r_.embedded_in[k]; }
  double weight(int k) const { return r_.embedded_weight[k]; }

  // Write positions or motions of the embedded nodes from those of the others, `width` columns, innermost.
  void fill(double *x, int width = 1) const {
    for (int e = 0; e < count(); ++e) {
      double *to = x + 3 * std::size_t(width) * node(e);
      std::fill_n(to, 3 * width, 0.0);
      for (int k = begin(e); k < end(e); ++k) {
        const double *from = x + 3 * std::size_t(width) * in(k);
        for (int c = 0; c < 3 * width; ++c) to[c] += weight(k) * from[c];
      }
    }
  }
  // Carry forces on the embedded nodes to the others; those that act on the embedded ones stay there as well.
  void fold(double *force, int width = 1) const {
    for (int e = 0; e < count(); ++e) {
      const double *from = force + 3 * std::size_t(width) * node(e);
      for (int k = begin(e); k < end(e); ++k) {
        double *to = force + 3 * std::size_t(width) * in(k);
        for (int c = 0; c < 3 * width; ++c) to[c] += weight(k) * from[c];
      }
    }
  }

 private:
  const Record &r_;
};

}  // namespace thinshell
