// Contact of sampled surfaces with rigid shapes, and friction with an elastic slip that is remembered.
//
// With the sample p = sum_i w_i x_i, the body's node c and its rotation R, at the start of the step p_n, c_n, R_n, the
// slip e_n that is remembered and the load l_n that was carried (sim_core/contact/rigid.py):
//
//     g = phi(R^T (p - c)) - offset,    y = R_n^T (p_n - c_n),    m = R n(y),    w = R (e_n - y) + p - c
//     force on the sample   A p(g) R n  -  dD/du (u; mu l_n, k A),    u = w - m (m . w)
//
// The laws are those of sim_core/contact/pressure_and_friction.py. Derivatives by parameters are those of dual numbers,
// a few columns at a time.
#pragma once

#include <limits>
#include <vector>

#include "blocks.hpp"
#include "dual.hpp"
#include "elements.hpp"
#include "laws.hpp"
#include "record.hpp"

namespace thinshell {

constexpr int lanes = 8;  // columns that are differentiated at once
using Lanes = Dual<double, lanes>;

// Places in the law's numbers, as sim_core/contact/pressure_and_friction.py has them.
enum : int { STIFFNESS, RANGE, CORE, MU, OFFSET, BLEND, GUARD, REACH };

// Share of the range below which the law is straight (sim_core/contact/pressure_and_friction.py).
constexpr double core_guarded = 1e-3, core_free = 0.2;
// Elastic slip [m] that a spring without stiffness never reaches.
constexpr double far_slip = 1e300;

// The law itself, or one whose iterates may overlap.
inline void set_guard(double *law, bool on) {
  law[GUARD] = on;
  law[CORE] = on ? core_guarded : core_free;
}

// A number with its derivatives in some columns.
inline Lanes seeded(double value, const double *d) {
  Lanes out(value);
  for (int l = 0; l < lanes; ++l) out.d[l] = d[l];
  return out;
}

// What samples and bodies remember, and its derivatives with columns innermost.
struct Memory {
  std::vector<double> anchor, load, speed, rotation;          // (s, 3), (s), (s), (contacts, 9)
  std::vector<double> d_anchor, d_load, d_speed, d_rotation;  // (., columns) each
};

template <class S> struct Friction {
  Vec<S, 3> y, normal, anchor;  // body point under the sample, lagged normal, remembered slip
  S limit;
};

template <class S> Mat<S, 3, 3> rotation_of(const S *r) {
  Mat<S, 3, 3> out;
  for (int k = 0; k < 9; ++k) out[k] = r[k];
  return out;
}

// Friction's start: `arm` is p_n - c_n, `turned` R_n, `rotation` R.
template <class S, class C>
Friction<S> friction_start(const Vec<S, 3> &arm, const Mat<S, 3, 3> &turned, const Mat<S, 3, 3> &rotation,
                           const Vec<S, 3> &anchor, const S &load, const C *law, const double *shape) {
  Friction<S> out;
  out.y = matmul(turned.transpose(), arm);
  const auto [distance, n, second] = laws::shapes::signed_distance(out.y, shape);
  (void)distance;
  (void)second;
  out.normal = matmul(rotation, n);
  out.anchor = anchor;
  out.limit = law[MU] * load;
  return out;
}

template <class S> Vec<S, 3> slip_of(const Friction<S> &f, const Vec<S, 3> &arm, const Mat<S, 3, 3> &rotation) {
  const Vec<S, 3> w = matmul(rotation, Vec<S, 3>(f.anchor - f.y)) + arm;
  return w - f.normal * f.normal.dot(w);
}

// Whether friction acts, or would with a little more of a parameter.
inline bool rubs(double limit) { return limit > 0.0; }
inline bool rubs(const Lanes &limit) {
  if (limit.v > 0.0) return true;
  for (double d : limit.d)
    if (d != 0.0) return true;
  return false;
}

template <class S> struct Pressed {
  S gap, load;      // [m], [N]
  Vec<S, 3> force;  // on the sample, friction included [N]
};

template <class S, class C>
Pressed<S> press(const Friction<S> &f, const Vec<S, 3> &arm, const Mat<S, 3, 3> &rotation, double area, const C *law,
                 const double *shape) {
  const auto [distance, n, second] =
      laws::shapes::signed_distance(Vec<S, 3>(matmul(rotation.transpose(), arm)), shape);
  (void)second;
  Pressed<S> out{};
  out.gap = distance - law[OFFSET];
  if (!(out.gap < law[REACH]) && !rubs(f.limit)) return out;
  out.load = area * laws::pressure_and_friction::pressure(out.gap, law);
  out.force = out.load * matmul(rotation, n);
  if (rubs(f.limit)) {
    const Vec<S, 3> u = slip_of(f, arm, rotation);
    if (value(u.norm_sqr()) > 0.0)
      out.force -= laws::pressure_and_friction::friction_force(u, f.limit, S(law[STIFFNESS] * area));
  }
  return out;
}

// What is kept of the elastic slip u that there would be without sliding, and the slip speed.
template <class S> Vec<S, 3> kept_slip(const Vec<S, 3> &u, const S &limit, const S &stiffness, double dt, S &speed) {
  const S length = u.norm(), longest = stiffness > 0.0 ? S(2.0 * limit / stiffness) : S(limit > 0.0 ? far_slip : 0.0);
  const bool beyond = length > longest;
  speed = beyond ? S((length - longest) / dt) : S(0.0);
  return beyond ? Vec<S, 3>((longest / length) * u) : u;
}

// Elastic slip and slip speed after the step.
template <class S, class C>
void slide(const Friction<S> &f, const Vec<S, 3> &arm, const Mat<S, 3, 3> &rotation, double area, const C *law,
           double dt, Vec<S, 3> &anchor, S &speed) {
  const Vec<S, 3> u = slip_of(f, arm, rotation);
  anchor = matmul(rotation.transpose(), kept_slip(u, f.limit, S(law[STIFFNESS] * area), dt, speed));
}

class Contacts {
 public:
  explicit Contacts(const Record &record) : r_(record) {
    laws_.assign(r_.law, r_.law + 8 * r_.contacts);
    rotation_.assign(9 * r_.contacts, 0.0);
    friction_.resize(r_.samples);
    gap_.assign(r_.samples, std::numeric_limits<double>::infinity());
    load_.assign(r_.samples, 0.0);
  }

  bool any() const { return r_.contacts > 0; }

  void couple(Blocks &h) const {
    for (int s = 0; s < r_.samples; ++s)
      for (int a = 0; a < r_.corners; ++a)
        for (int b = a; b < r_.corners; ++b) h.couple(node(s, a), node(s, b));
  }
  void bind(const Blocks &h) {
    slots_.clear();
    for (int s = 0; s < r_.samples; ++s)
      for (int a = 0; a < r_.corners; ++a)
        for (int b = a; b < r_.corners; ++b) slots_.push_back(h.slot(node(s, a), node(s, b)));
  }

  // The law itself, or one whose iterates may overlap.
  void guard(bool on) {
    for (int c = 0; c < r_.contacts; ++c) set_guard(&laws_[8 * c], on);
  }

  // Whether the guard changes the law at the gaps that were found last.
  bool guard_matters() const {
    bool out = false;
    each([&](int c, int s) { out = out || gap_[s] < core_free * law(c)[RANGE]; });
    return out;
  }

  // `turned`: rotations at the end of the step (contacts, 9).
  void begin(const double *x_start, const double *turned, const Memory &memory) {
    std::copy(turned, turned + 9 * r_.contacts, rotation_.begin());
    each([&](int c, int s) {
      friction_[s] = friction_start<double>(arm(x_start, c, s), rotation_of(&memory.rotation[9 * c]), rotation(c),
                                            point(memory.anchor.data(), s), memory.load[s], law(c), shape(c));
    });
  }

  double energy(const double *x) const {
    double out = 0.0;
    each([&](int c, int s) {
      const Vec3 d = arm(x, c, s);
      const auto [distance, n, second] = laws::shapes::signed_distance(Vec3(matmul(rotation(c).transpose(), d)), shape(c));
      (void)n;
      (void)second;
      out += r_.sample_area[s] * laws::pressure_and_friction::potential(distance - law(c)[OFFSET], law(c));
      if (friction_[s].limit > 0.0)
        out += laws::pressure_and_friction::friction_potential(slip_of(friction_[s], d, rotation(c)),
                                                               friction_[s].limit, law(c)[STIFFNESS] * r_.sample_area[s]);
    });
    return out;
  }

  void add_gradient(const double *x, double *out) {
    each([&](int c, int s) {
      const auto at = press<double>(friction_[s], arm(x, c, s), rotation(c), r_.sample_area[s], law(c), shape(c));
      gap_[s] = at.gap;
      load_[s] = at.load;
      for (int a = 0; a < r_.corners; ++a) add(out, node(s, a), -weight(s, a) * at.force);
      add(out, r_.body_node[c], at.force);
    });
  }

  void add_hessian(const double *x, bool exact, Blocks &h) const {
    each([&](int c, int s) {
      const Vec3 d = arm(x, c, s);
      const Mat3 turn = rotation(c);
      const auto [distance, n, second] = laws::shapes::signed_distance(Vec3(matmul(turn.transpose(), d)), shape(c));
      const double gap = distance - law(c)[OFFSET], area = r_.sample_area[s];
      if (!(gap < law(c)[REACH] || friction_[s].limit > 0.0)) return;
      const Vec3 m = matmul(turn, n);
      Mat3 k = (area * laws::pressure_and_friction::slope(gap, law(c))) * m.outer_product(m);
      if (exact)
        k -= area * laws::pressure_and_friction::pressure(gap, law(c)) * matmul(matmul(turn, second), turn.transpose());
      if (friction_[s].limit > 0.0) {
        const Mat3 t = laws::pressure_and_friction::tangent_projector(friction_[s].normal);
        const Mat3 stiff = laws::pressure_and_friction::friction_stiffness(
            slip_of(friction_[s], d, turn), friction_[s].limit, law(c)[STIFFNESS] * area, t);
        k += matmul(matmul(t, stiff), t);
      }
      const Slot *slot = &slots_[s * r_.corners * (r_.corners + 1) / 2];
      for (int a = 0; a < r_.corners; ++a)
        for (int b = a; b < r_.corners; ++b, ++slot) {
          const double w = weight(s, a) * weight(s, b);
          if (w != 0.0) h.add(*slot, w * k);
        }
    });
  }

  // Share of the straight way from `x` by `move` on which every gap keeps the share `keep` (conservative advancement,
  // sim_core/contact/continuous_collision.py), while bodies turn from where they were at the start of the step.
  double free_way(const double *x, const double *move, double keep, const Memory &memory) const {
    double way = 1.0;
    each([&](int c, int s) {
      const Vec3 from = matmul(rotation_of(&memory.rotation[9 * c]).transpose(), arm(x, c, s));
      Vec3 d = arm(x, c, s) + arm(move, c, s);
      const Vec3 by = matmul(rotation(c).transpose(), d) - from;
      way = std::min(way, double(laws::continuous_collision::point_shape_way(from, by, shape(c), law(c)[OFFSET], keep)));
    });
    return way;
  }

  // Memory after the step that ended at `x`, from forces that were evaluated last.
  void end(const double *x, double dt, Memory &memory) const {
    each([&](int c, int s) {
      Vec3 anchor{};
      double speed = 0.0;
      if (load_[s] > 0.0)
        slide<double>(friction_[s], arm(x, c, s), rotation(c), r_.sample_area[s], law(c), dt, anchor, speed);
      for (int k = 0; k < 3; ++k) memory.anchor[3 * s + k] = anchor[k];
      memory.load[s] = load_[s];
      memory.speed[s] = speed;
    });
    std::copy(rotation_.begin(), rotation_.end(), memory.rotation.begin());
  }

  // Moments of the forces on the samples about the bodies' nodes (contacts, 3).
  void moments(const double *x, double *out) const {
    std::fill(out, out + 3 * r_.contacts, 0.0);
    each([&](int c, int s) {
      const Vec3 d = arm(x, c, s);
      const auto at = press<double>(friction_[s], d, rotation(c), r_.sample_area[s], law(c), shape(c));
      add(out, c, d.cross(at.force));
    });
  }

  // What forces change by, into (nodes, 3, columns). `dx_start`: of positions at the start; `dx`: at the end, of the
  // bodies' nodes alone; `d_rotation`: of the rotations at the end.
  void add_columns(const double *x_start, const double *x, const double *dx_start, const double *dx,
                   const double *d_rotation, const Memory &memory, double *out) const {
    for (int first = 0; first < r_.columns; first += lanes)
      each([&](int c, int s) {
        if (!acts(c, s)) return;
        const auto law_at = seeded_law(c, first);
        const Mat<Lanes, 3, 3> turn = seeded_rotation(rotation_.data(), d_rotation, c, first);
        const Friction<Lanes> f = seeded_friction(x_start, dx_start, memory, turn, law_at.data(), c, s, first);
        const Vec<Lanes, 3> d = seeded_arm(x, nullptr, dx, c, s, first);
        const auto at = press<Lanes>(f, d, turn, r_.sample_area[s], law_at.data(), shape(c));
        for (int a = 0; a < r_.corners; ++a) spread(at.force, -weight(s, a), node(s, a), first, out);
      });
  }

  // Derivatives of the memory after the step, of the moments (contacts, 3, columns) and of the forces on the bodies'
  // nodes, into (nodes, 3, columns), which are set.
  void end_columns(const double *x_start, const double *x, const double *dx_start, const double *dx, double dt,
                   const double *d_rotation, Memory &memory, double *d_moments, double *d_force) const {
    const Memory before = memory;
    std::fill(memory.d_anchor.begin(), memory.d_anchor.end(), 0.0);
    std::fill(memory.d_load.begin(), memory.d_load.end(), 0.0);
    std::fill(memory.d_speed.begin(), memory.d_speed.end(), 0.0);
    std::fill(d_moments, d_moments + 3 * r_.contacts * r_.columns, 0.0);
    for (int c = 0; c < r_.contacts; ++c)
      std::fill_n(d_force + 3 * r_.body_node[c] * r_.columns, 3 * r_.columns, 0.0);
    for (int first = 0; first < r_.columns; first += lanes)
      each([&](int c, int s) {
        if (!acts(c, s)) return;
        const auto law_at = seeded_law(c, first);
        const Mat<Lanes, 3, 3> turn = seeded_rotation(rotation_.data(), d_rotation, c, first);
        const Friction<Lanes> f = seeded_friction(x_start, dx_start, before, turn, law_at.data(), c, s, first);
        const Vec<Lanes, 3> d = seeded_arm(x, dx, dx, c, s, first);
        const auto at = press<Lanes>(f, d, turn, r_.sample_area[s], law_at.data(), shape(c));
        const Vec<Lanes, 3> m = d.cross(at.force);
        spread(at.force, 1.0, r_.body_node[c], first, d_force);
        spread(m, 1.0, c, first, d_moments);
        if (!(at.load.v > 0.0)) return;
        Vec<Lanes, 3> anchor;
        Lanes speed;
        slide<Lanes>(f, d, turn, r_.sample_area[s], law_at.data(), dt, anchor, speed);
        spread(anchor, 1.0, s, first, memory.d_anchor.data());
        for (int l = 0; l < lanes; ++l) {
          memory.d_load[s * r_.columns + first + l] = at.load.d[l];
          memory.d_speed[s * r_.columns + first + l] = speed.d[l];
        }
      });
    std::copy(d_rotation, d_rotation + 9 * r_.contacts * r_.columns, memory.d_rotation.begin());
  }

  // Loaded samples, the smallest gap [m] and the contact that has it, at the last gradient.
  void report(StepCounts &out) const {
    out.contacts = 0;
    out.gap = std::numeric_limits<double>::infinity();
    out.tightest = -1;
    each([&](int c, int s) {
      out.contacts += load_[s] > 0.0;
      if (gap_[s] < out.gap) {
        out.gap = gap_[s];
        out.tightest = c;
      }
    });
  }

 private:
  template <class F> void each(F &&f) const {
    for (int c = 0; c < r_.contacts; ++c)
      for (int s = r_.sample_start[c]; s < r_.sample_start[c + 1]; ++s) f(c, s);
  }
  int node(int s, int a) const { return r_.sample_node[s * r_.corners + a]; }
  double weight(int s, int a) const { return r_.sample_weight[s * r_.corners + a]; }
  const double *law(int c) const { return &laws_[8 * c]; }
  const double *shape(int c) const { return r_.shape + 5 * c; }
  Mat3 rotation(int c) const { return rotation_of(&rotation_[9 * c]); }
  bool acts(int c, int s) const { return gap_[s] < law(c)[REACH] || friction_[s].limit > 0.0; }

  Vec3 arm(const double *x, int c, int s) const {
    Vec3 out = -point(x, r_.body_node[c]);
    for (int a = 0; a < r_.corners; ++a) out += weight(s, a) * point(x, node(s, a));
    return out;
  }

  // `dx`: of the samples, `dx_body`: of the body's node, null where held.
  Vec<Lanes, 3> seeded_arm(const double *x, const double *dx, const double *dx_body, int c, int s, int first) const {
    Vec<Lanes, 3> out;
    const Vec3 at = arm(x, c, s);
    for (int i = 0; i < 3; ++i) {
      out[i] = Lanes(at[i]);
      const double *body = dx_body + (3 * std::size_t(r_.body_node[c]) + i) * r_.columns + first;
      for (int l = 0; l < lanes; ++l) out[i].d[l] = -body[l];
      if (dx)
        for (int a = 0; a < r_.corners; ++a) {
          const double *from = dx + (3 * std::size_t(node(s, a)) + i) * r_.columns + first;
          for (int l = 0; l < lanes; ++l) out[i].d[l] += weight(s, a) * from[l];
        }
    }
    return out;
  }
  Mat<Lanes, 3, 3> seeded_rotation(const double *r, const double *dr, int c, int first) const {
    Mat<Lanes, 3, 3> out;
    for (int k = 0; k < 9; ++k) out[k] = seeded(r[9 * c + k], dr + (9 * std::size_t(c) + k) * r_.columns + first);
    return out;
  }
  struct Law {
    Lanes a[8];
    const Lanes *data() const { return a; }
  };
  Law seeded_law(int c, int first) const {
    Law out;
    for (int k = 0; k < 8; ++k) out.a[k] = seeded(law(c)[k], r_.d_law + (8 * std::size_t(c) + k) * r_.columns + first);
    return out;
  }
  Friction<Lanes> seeded_friction(const double *x_start, const double *dx_start, const Memory &memory,
                                  const Mat<Lanes, 3, 3> &turn, const Lanes *law_at, int c, int s, int first) const {
    Vec<Lanes, 3> anchor;
    for (int i = 0; i < 3; ++i)
      anchor[i] = seeded(memory.anchor[3 * s + i], &memory.d_anchor[(3 * std::size_t(s) + i) * r_.columns + first]);
    return friction_start<Lanes>(seeded_arm(x_start, dx_start, dx_start, c, s, first),
                                 seeded_rotation(memory.rotation.data(), memory.d_rotation.data(), c, first), turn, anchor,
                                 seeded(memory.load[s], &memory.d_load[std::size_t(s) * r_.columns + first]), law_at,
                                 shape(c));
  }
  void spread(const Vec<Lanes, 3> &v, double by, int at, int first, double *out) const {
    for (int i = 0; i < 3; ++i)
      for (int l = 0; l < lanes; ++l) out[(3 * std::size_t(at) + i) * r_.columns + first + l] += by * v[i].d[l];
  }

  const Record &r_;
  std::vector<double> laws_, rotation_, gap_, load_;
  std::vector<Friction<double>> friction_;
  std::vector<Slot> slots_;
};

}  // namespace thinshell
