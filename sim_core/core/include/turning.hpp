// Frames between two frames: straight lines of origins, turns about one axis.
#pragma once

#include "small.hpp"

namespace thinshell {

// Vector of a rotation, axis times angle below pi (Shepperd, J. Guid. Control 1, 1978).
THINSHELL_FN Vec<double, 3> turn_of(const Mat<double, 3, 3> &r) {
  const double trace = r(0, 0) + r(1, 1) + r(2, 2);
  double w, v[3];
  int most = 0;
  for (int k = 1; k < 3; ++k)
    if (r(k, k) > r(most, most)) most = k;
  if (trace >= r(most, most)) {
    w = 1.0 + trace;
    v[0] = r(2, 1) - r(1, 2);
    v[1] = r(0, 2) - r(2, 0);
    v[2] = r(1, 0) - r(0, 1);
  } else {
    const int i = most, j = (i + 1) % 3, k = (i + 2) % 3;
    v[i] = 1.0 - trace + 2.0 * r(i, i);
    v[j] = r(j, i) + r(i, j);
    v[k] = r(k, i) + r(i, k);
    w = r(k, j) - r(j, k);
  }
  const double length = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  const double share = length > 0.0 ? 2.0 * atan2(length, abs(w)) / length : 0.0;
  return (w < 0.0 ? -share : share) * Vec<double, 3>{{v[0], v[1], v[2]}};
}

// Rotation by a vector (Rodrigues).
THINSHELL_FN Mat<double, 3, 3> rotation_by(const Vec<double, 3> &turn) {
  const double angle = turn.norm();
  const double a = angle > 1e-8 ? sin(angle) / angle : 1.0;
  const double half = sin(0.5 * angle), b = angle > 1e-8 ? 2.0 * half * half / (angle * angle) : 0.5;
  const Mat<double, 3, 3> cross = {{0.0, -turn[2], turn[1], turn[2], 0.0, -turn[0], -turn[1], turn[0], 0.0}};
  Mat<double, 3, 3> out = a * cross + b * matmul(cross, cross);
  for (int k = 0; k < 3; ++k) out(k, k) += 1.0;
  return out;
}

THINSHELL_FN bool same(const double *a, const double *b) {
  bool out = true;
  for (int k = 0; k < 9; ++k) out = out && a[k] == b[k];
  return out;
}

// Rotation (9) that has gone a share of the way from one to another.
THINSHELL_FN void turn_between(const double *from, const double *to, double share, double *out) {
  if (share >= 1.0 || same(from, to)) {
    for (int k = 0; k < 9; ++k) out[k] = to[k];
    return;
  }
  Mat<double, 3, 3> a, b;
  for (int k = 0; k < 9; ++k) {
    a[k] = from[k];
    b[k] = to[k];
  }
  const Mat<double, 3, 3> there = matmul(a, rotation_by(share * turn_of(matmul(a.transpose(), b))));
  for (int k = 0; k < 9; ++k) out[k] = there[k];
}

// How the motion of a frame in its own axes, a share of the way from one to another, follows from those of the two ends:
// shift = shift_from a + shift_to b and turn = turn_from a + turn_to b. With the turn v between the ends and w = share v,
//
//     shift_from = (1 - share) exp(-w),    shift_to = share exp(v - w),
//     turn_to = share J(w) J(v)^-1,        turn_from = exp(-w) - turn_to exp(-v)
//
// where exp(v + dv) = exp(v) exp(J(v) dv), the right Jacobian (Chirikjian, Stochastic Models, Information Theory, and Lie
// Groups 2, 2012, 10.5).
struct MotionBetween {
  Mat<double, 3, 3> shift_from, shift_to, turn_from, turn_to;
};

THINSHELL_FN Mat<double, 3, 3> polynomial_of(const Vec<double, 3> &turn, double first, double second) {
  const Mat<double, 3, 3> cross = {{0.0, -turn[2], turn[1], turn[2], 0.0, -turn[0], -turn[1], turn[0], 0.0}};
  Mat<double, 3, 3> out = first * cross + second * matmul(cross, cross);
  for (int k = 0; k < 3; ++k) out(k, k) += 1.0;
  return out;
}

// J(v), and its inverse. Below 0.03 rad by their series, to 1e-14.
THINSHELL_FN Mat<double, 3, 3> right_jacobian(const Vec<double, 3> &v) {
  const double square = v.dot(v), angle = sqrt(square), half = sin(0.5 * angle);
  if (angle < 0.03) return polynomial_of(v, -(0.5 - square * (1.0 - square / 30.0) / 24.0), (1.0 - square * (1.0 - square / 42.0) / 20.0) / 6.0);
  return polynomial_of(v, -2.0 * half * half / square, (angle - sin(angle)) / (square * angle));
}
THINSHELL_FN Mat<double, 3, 3> inverse_jacobian(const Vec<double, 3> &v) {
  const double square = v.dot(v), angle = sqrt(square);
  if (angle < 0.03) return polynomial_of(v, 0.5, (1.0 + square * (1.0 + square / 42.0) / 60.0) / 12.0);
  return polynomial_of(v, 0.5, (1.0 - 0.5 * angle * cos(0.5 * angle) / sin(0.5 * angle)) / square);
}

// `from`, `to`: rotations (9).
THINSHELL_FN MotionBetween motion_between(const double *from, const double *to, double share) {
  Mat<double, 3, 3> a, b;
  for (int k = 0; k < 9; ++k) {
    a[k] = from[k];
    b[k] = to[k];
  }
  const Vec<double, 3> turn = turn_of(matmul(a.transpose(), b)), part = share * turn;
  const Mat<double, 3, 3> back = rotation_by(-part), turn_to = share * matmul(right_jacobian(part), inverse_jacobian(turn));
  return {(1.0 - share) * back, share * rotation_by(turn - part), back - matmul(turn_to, rotation_by(-turn)), turn_to};
}

}  // namespace thinshell
