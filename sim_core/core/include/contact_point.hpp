// One sample of contact with a rigid shape: pressure, friction with an elastic slip that is remembered, stiffness.
//
// With the sample p = sum_i w_i x_i, the body's node c and its rotation R, at the start of the step p_n, c_n, R_n, the
// slip e_n that is remembered and the load l_n that was carried (sim_core/contact/rigid.py):
//
//     g = phi(R^T (p - c)) - offset,    y = R_n^T (p_n - c_n),    m = R n(y),    w = R (e_n - y) + p - c
//     force on the sample   A p(g) R n  -  dD/du (u; mu l_n, k A),    u = w - m (m . w)
//
// The laws are those of sim_core/contact/pressure_and_friction.py. For doubles and dual numbers, CPUs and GPUs.
#pragma once

#include "laws.hpp"
#include "small.hpp"

namespace thinshell {

// Places in the law's numbers, as sim_core/contact/pressure_and_friction.py has them.
enum : int { STIFFNESS, RANGE, CORE, MU, OFFSET, BLEND, GUARD, REACH };

// Share of the range below which the law is straight (sim_core/contact/pressure_and_friction.py).
constexpr double core_guarded = 1e-3, core_free = 0.2;
// Elastic slip [m] that a spring without stiffness never reaches.
constexpr double far_slip = 1e300;

// The law itself, or one whose iterates may overlap.
THINSHELL_FN void set_guard(double *law, bool on) {
  law[GUARD] = on;
  law[CORE] = on ? core_guarded : core_free;
}

template <class S> struct Friction {
  Vec<S, 3> y, normal, anchor;  // body point under the sample, lagged normal, remembered slip
  S limit;
};

template <class S> THINSHELL_FN Mat<S, 3, 3> rotation_of(const S *r) {
  Mat<S, 3, 3> out;
  for (int k = 0; k < 9; ++k) out[k] = r[k];
  return out;
}

// Friction's start: `arm` is p_n - c_n, `turned` R_n, `rotation` R.
template <class S>
THINSHELL_FN Friction<S> friction_start(const Vec<S, 3> &arm, const Mat<S, 3, 3> &turned, const Mat<S, 3, 3> &rotation,
                           const Vec<S, 3> &anchor, const S &limit, const double *shape) {
  Friction<S> out;
  out.y = matmul(turned.transpose(), arm);
  const auto [distance, n, second] = laws::shapes::signed_distance(out.y, shape);
  (void)distance;
  (void)second;
  out.normal = matmul(rotation, n);
  out.anchor = anchor;
  out.limit = limit;
  return out;
}

template <class S> THINSHELL_FN Vec<S, 3> slip_of(const Friction<S> &f, const Vec<S, 3> &arm, const Mat<S, 3, 3> &rotation) {
  const Vec<S, 3> w = matmul(rotation, Vec<S, 3>(f.anchor - f.y)) + arm;
  return w - f.normal * f.normal.dot(w);
}

// Whether friction acts, or would with a little more of a parameter.
THINSHELL_FN bool rubs(double limit) { return limit > 0.0; }

template <class S> struct Pressed {
  S gap, load;      // [m], [N]
  Vec<S, 3> force;  // on the sample, friction included [N]
};

// `added_pressure`: pressure that effects add at a gap.
template <class S, class C, class P, class A>
THINSHELL_FN Pressed<S> press(const Friction<S> &f, const Vec<S, 3> &arm, const Mat<S, 3, 3> &rotation, const A &area,
                 const C *law, const double *shape, P &&added_pressure) {
  const auto [distance, n, second] =
      laws::shapes::signed_distance(Vec<S, 3>(matmul(rotation.transpose(), arm)), shape);
  (void)second;
  Pressed<S> out{};
  out.gap = distance - law[OFFSET];
  if (!(out.gap < law[REACH]) && !rubs(f.limit)) return out;
  out.load = area * laws::pressure_and_friction::pressure(out.gap, law);
  out.force = (out.load + area * added_pressure(out.gap)) * matmul(rotation, n);
  if (rubs(f.limit)) {
    const Vec<S, 3> u = slip_of(f, arm, rotation);
    if (value(u.norm_sqr()) > 0.0)
      out.force -= laws::pressure_and_friction::friction_force(u, f.limit, S(law[STIFFNESS] * area));
  }
  return out;
}

// What is kept of the elastic slip u that there would be without sliding, and the slip speed.
template <class S> THINSHELL_FN Vec<S, 3> kept_slip(const Vec<S, 3> &u, const S &limit, const S &stiffness, double dt, S &speed) {
  const S length = u.norm(), longest = stiffness > 0.0 ? S(2.0 * limit / stiffness) : S(limit > 0.0 ? far_slip : 0.0);
  const bool beyond = length > longest;
  speed = beyond ? S((length - longest) / dt) : S(0.0);
  return beyond ? Vec<S, 3>((longest / length) * u) : u;
}

// Elastic slip and slip speed after the step.
template <class S, class C, class A>
THINSHELL_FN void slide(const Friction<S> &f, const Vec<S, 3> &arm, const Mat<S, 3, 3> &rotation, const A &area, const C *law,
           double dt, Vec<S, 3> &anchor, S &speed) {
  const Vec<S, 3> u = slip_of(f, arm, rotation);
  anchor = matmul(rotation.transpose(), kept_slip(u, f.limit, S(law[STIFFNESS] * area), dt, speed));
}

// Stiffness of a sample [N/m] at the gap and the normal `n` of the body, turned by `rotation`; `second`: how the normal
// turns with the place. `pressure`, `slope`: what effects add. Without `exact` semidefinite.
template <class C>
THINSHELL_FN Mat<double, 3, 3> stiffness_of(const Friction<double> &f, const Vec<double, 3> &arm,
                                            const Mat<double, 3, 3> &rotation, double area, double gap,
                                            const Vec<double, 3> &n, const Mat<double, 3, 3> &second, const C *law,
                                            double pressure, double slope, bool exact) {
  const Vec<double, 3> m = matmul(rotation, n);
  const double steep = laws::pressure_and_friction::slope(gap, law) + slope;
  Mat<double, 3, 3> k = (area * (exact ? steep : max(steep, 0.0))) * m.outer_product(m);
  if (exact)
    k -= area * (laws::pressure_and_friction::pressure(gap, law) + pressure) *
         matmul(matmul(rotation, second), rotation.transpose());
  if (f.limit > 0.0) {
    const Mat<double, 3, 3> t = laws::pressure_and_friction::tangent_projector(f.normal);
    const Mat<double, 3, 3> stiff = laws::pressure_and_friction::friction_stiffness(slip_of(f, arm, rotation), f.limit,
                                                                                   law[STIFFNESS] * area, t);
    k += matmul(matmul(t, stiff), t);
  }
  return k;
}

}  // namespace thinshell
