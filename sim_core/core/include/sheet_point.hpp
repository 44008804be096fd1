// One triangle that stretches and one hinge that bends: strains, stresses and blocks of the Hessian.
//
// elements.hpp says what of; for CPUs and GPUs. The laws are those of sim_core/energies/membrane.py and dihedral.py.
#pragma once

#include "laws.hpp"
#include "record.hpp"
#include "small.hpp"

namespace thinshell {

using Vec3 = Vec<double, 3>;
using Mat3 = Mat<double, 3, 3>;

THINSHELL_FN Vec3 point(const double *x, int i) { return {{x[3 * i], x[3 * i + 1], x[3 * i + 2]}}; }
THINSHELL_FN void add(double *x, int i, const Vec3 &v) {
  for (int k = 0; k < 3; ++k) x[3 * i + k] += v[k];
}

// The two columns of the deformation gradient of a triangle; `b`: gradients of its hat functions (3, 2).
THINSHELL_FN Mat<double, 3, 2> deformation(const double *x, const int32_t *nodes, const double *b) {
  Mat<double, 3, 2> f{};
  for (int a = 0; a < 3; ++a)
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 2; ++j) f(i, j) += x[3 * nodes[a] + i] * b[2 * a + j];
  return f;
}
THINSHELL_FN Vec3 green_strain(const Mat<double, 3, 2> &f) {
  return laws::membrane::green_strain(Vec3{{f(0, 0), f(1, 0), f(2, 0)}}, Vec3{{f(0, 1), f(1, 1), f(2, 1)}});
}
// The strain to first order in a move, of which `d` is the deformation, at whose end it is `e`.
THINSHELL_FN Vec3 foreseen_strain(Vec3 e, const Mat<double, 3, 2> &d) {
  for (int i = 0; i < 3; ++i) {
    e[0] -= 0.5 * d(i, 0) * d(i, 0);
    e[1] -= 0.5 * d(i, 1) * d(i, 1);
    e[2] -= d(i, 0) * d(i, 1);
  }
  return e;
}
// A stiffness (9) times a strain.
THINSHELL_FN Vec3 stiff_times(const double *k, const Vec3 &e) {
  Vec3 out;
  for (int i = 0; i < 3; ++i) out[i] = k[3 * i] * e[0] + k[3 * i + 1] * e[1] + k[3 * i + 2] * e[2];
  return out;
}
// Force on a corner of a triangle with the stress `s`.
THINSHELL_FN Vec3 corner_force(const Mat<double, 3, 2> &f, const Vec3 &s, const double *b, int a) {
  const double u = s[0] * b[2 * a] + s[2] * b[2 * a + 1], v = s[2] * b[2 * a] + s[1] * b[2 * a + 1];
  return {{f(0, 0) * u + f(0, 1) * v, f(1, 0) * u + f(1, 1) * v, f(2, 0) * u + f(2, 1) * v}};
}
// Block of corners a and d of the Hessian of a triangle with the stress `s` and the tangent `k` (9).
THINSHELL_FN Mat3 triangle_block(const Mat<double, 3, 2> &f, const Vec3 &s, const double *k, const double *b, int a, int d) {
  double left[2][3];
  for (int j = 0; j < 3; ++j) {
    left[0][j] = b[2 * a] * k[j] + b[2 * a + 1] * k[6 + j];
    left[1][j] = b[2 * a + 1] * k[3 + j] + b[2 * a] * k[6 + j];
  }
  const double p = b[2 * d], q = b[2 * d + 1];
  const double geometric = s[0] * b[2 * a] * p + s[1] * b[2 * a + 1] * q + s[2] * (b[2 * a] * q + b[2 * a + 1] * p);
  double w[2][2];
  for (int m = 0; m < 2; ++m) {
    w[m][0] = left[m][0] * p + left[m][2] * q;
    w[m][1] = left[m][1] * q + left[m][2] * p;
  }
  Mat3 block;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      block(i, j) = f(i, 0) * (w[0][0] * f(j, 0) + w[0][1] * f(j, 1)) + f(i, 1) * (w[1][0] * f(j, 0) + w[1][1] * f(j, 1)) +
                    (i == j ? geometric : 0.0);
  return block;
}
// Moment times the second derivative of the angle of a hinge by corners i <= j of one side, from what `side_curvature` of
// dihedral.py returns.
template <class S, class Curvature>
THINSHELL_FN Mat<S, 3, 3> side_block(const S &moment, const Curvature &side, int i, int j) {
  const auto &n = side.a0, &along = side.a1, &up = side.a2;
  const auto &dc = side.a3;
  const auto &dphi = side.a4;
  const Vec<S, 3> left = moment * (dc(i, 2 * j) * along + dc(i, 2 * j + 1) * up);
  const Vec<S, 3> right = (moment * dphi(i, 2)) * (dphi(j, 0) * along + dphi(j, 1) * up);
  Mat<S, 3, 3> block;
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) block(a, b) = n[a] * left[b] - right[a] * n[b];
  if (i == j) block = 0.5 * (block + block.transpose());
  return block;
}

}  // namespace thinshell
