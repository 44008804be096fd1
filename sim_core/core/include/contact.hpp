// Contact of sampled surfaces with rigid shapes, and friction with an elastic slip that is remembered.
//
// What a sample does is contact_point.hpp; laws that effects add (added_laws.hpp) let A p(g) and mu l_n grow. Derivatives
// by parameters are those of dual numbers, a few columns at a time.
#pragma once

#include <limits>
#include <vector>

#include "added_laws.hpp"
#include "blocks.hpp"
#include "contact_point.hpp"
#include "elements.hpp"
#include "lanes.hpp"
#include "record.hpp"
#include "turning.hpp"

namespace thinshell {

// What samples and bodies remember, and its derivatives with columns innermost.
struct Memory {
  std::vector<double> anchor, load, speed, bonded, rotation;  // (s, 3), (s), (s), (s), (contacts, 9)
  std::vector<double> d_anchor, d_load, d_speed, d_rotation;  // (., columns) each
};

// Whether friction acts, or would with a little more of a parameter.
inline bool rubs(const Lanes &limit) {
  if (limit.v > 0.0) return true;
  for (double d : limit.d)
    if (d != 0.0) return true;
  return false;
}
inline bool rubs(const Noted &limit) { return limit.v > 0.0 || limit.at; }

class Contacts {
 public:
  explicit Contacts(const Record &record) : r_(record) {
    laws_.assign(r_.law, r_.law + 8 * r_.contacts);
    rotation_.assign(9 * r_.contacts, 0.0);
    friction_.resize(r_.samples);
    gap_.assign(r_.samples, std::numeric_limits<double>::infinity());
    load_.assign(r_.samples, 0.0);
    stiffness_.assign(r_.samples, Mat3{});
    bonded_.assign(r_.samples, 0.0);
    for (int c = 0; c < r_.contacts; ++c) added_.emplace_back(r_, c);
  }

  bool any() const { return r_.contacts > 0; }

  void couple(Blocks &h) const {
    each([&](int c, int s) {
      for (int a = 0; a < members(c); ++a)
        for (int b = a; b < members(c); ++b) h.couple(member(c, s, a), member(c, s, b));
    });
  }
  void bind(const Blocks &h) {
    slots_.clear();
    first_slot_.clear();
    each([&](int c, int s) {
      first_slot_.push_back(slots_.size());
      for (int a = 0; a < members(c); ++a)
        for (int b = a; b < members(c); ++b) slots_.push_back(h.slot(member(c, s, a), member(c, s, b)));
    });
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
    target_ = rotation_;
    bonded_ = memory.bonded;
    each([&](int c, int s) {
      const double limit = added_[c].bound(law(c)[MU], memory.load[s], r_.sample_area[s], memory.speed[s], 0);
      friction_[s] = friction_start<double>(arm(x_start, c, s), rotation_of(&memory.rotation[9 * c]), rotation(c),
                                            point(memory.anchor.data(), s), limit, shape(c));
    });
  }

  // Turn the bodies to where they are after a share of the step.
  void turn(double share, const Memory &memory) {
    for (int c = 0; c < r_.contacts; ++c) turned(c, share, memory, &rotation_[9 * c]);
  }
  // Whether any of them turns in this step.
  bool turns(const Memory &memory) const { return target_ != memory.rotation; }

  double energy(const double *x) const {
    double out = 0.0;
    each([&](int c, int s) {
      const Vec3 d = arm(x, c, s);
      const auto [distance, n, second] = laws::shapes::signed_distance(Vec3(matmul(rotation(c).transpose(), d)), shape(c));
      (void)n;
      (void)second;
      const double gap = distance - law(c)[OFFSET];
      if (gap < law(c)[REACH])
        out += r_.sample_area[s] * (laws::pressure_and_friction::potential(gap, law(c)) + added_[c].normal(gap, bonded_[s]).energy);
      if (friction_[s].limit > 0.0)
        out += laws::pressure_and_friction::friction_potential(slip_of(friction_[s], d, rotation(c)),
                                                               friction_[s].limit, law(c)[STIFFNESS] * r_.sample_area[s]);
    });
    return out;
  }

  // `apart`: how far the gradients of contacts are from each other in `out`.
  void add_gradient(const double *x, double *whole, std::size_t apart = 0) {
    each([&](int c, int s) {
      double *out = whole + apart * c;
      const auto at = pressed(c, s, arm(x, c, s));
      gap_[s] = at.gap;
      load_[s] = at.load;
      for (int a = 0; a < r_.corners; ++a) add(out, node(s, a), -weight(s, a) * at.force);
      add(out, r_.body_node[c], at.force);
    });
  }

  void add_hessian(const double *x, bool exact, Blocks &h) {
    each([&](int c, int s) {
      const Vec3 d = arm(x, c, s);
      const Mat3 turn = rotation(c);
      const auto [distance, n, second] = laws::shapes::signed_distance(Vec3(matmul(turn.transpose(), d)), shape(c));
      const double gap = distance - law(c)[OFFSET], area = r_.sample_area[s];
      stiffness_[s] = Mat3{};
      if (!(gap < law(c)[REACH] || friction_[s].limit > 0.0)) return;
      const auto pressed_at = normal(c, s, gap);
      const Mat3 k = stiffness_of(friction_[s], d, turn, area, gap, n, second, law(c), pressed_at.pressure, pressed_at.slope, exact);
      stiffness_[s] = k;
      const Slot *slot = &slots_[first_slot_[s]];
      for (int a = 0; a < members(c); ++a)
        for (int b = a; b < members(c); ++b, ++slot) {
          const double w = share(s, a) * share(s, b);
          if (w != 0.0) h.add(*slot, w * k);
        }
    });
  }

  // What forces change by, with the stiffness that was added last, where the nodes of bodies move that the Hessian does not
  // have (nodes, 3).
  void follow(const double *move, double *out) const {
    each([&](int c, int s) {
      if (gives(c)) return;
      const Vec3 by = matmul(stiffness_[s], point(move, r_.body_node[c]));
      for (int a = 0; a < r_.corners; ++a) add(out, node(s, a), -weight(s, a) * by);
    });
  }

  // Share of the straight way from `x` by `move` on which every gap keeps the share `keep` (conservative advancement,
  // sim_core/contact/continuous_collision.py), while bodies turn from where they are after the share `since` of the step
  // to where they are after the share `till`. Paths are straight in the bodies' frames.
  double free_way(const double *x, const double *move, double keep, double since, double till, const Memory &memory) const {
    double way = 1.0;
    for (int c = 0; c < r_.contacts; ++c) {
      Mat3 first, last;
      turned(c, since, memory, first.a);
      turned(c, till, memory, last.a);
      for (int s = r_.sample_start[c]; s < r_.sample_start[c + 1]; ++s) {
        const Vec3 from = matmul(first.transpose(), arm(x, c, s)), d = arm(x, c, s) + arm(move, c, s);
        const Vec3 by = matmul(last.transpose(), d) - from;
        way = std::min(way, double(laws::continuous_collision::point_shape_way(from, by, shape(c), law(c)[OFFSET], keep)));
      }
    }
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
      memory.bonded[s] = added_[c].bonded_after(gap_[s], load_[s] > 0.0, bonded_[s]);
    });
    std::copy(rotation_.begin(), rotation_.end(), memory.rotation.begin());
  }

  // Moments of the forces on the samples about the bodies' nodes (contacts, 3).
  void moments(const double *x, double *out) const {
    std::fill(out, out + 3 * r_.contacts, 0.0);
    each([&](int c, int s) {
      const Vec3 d = arm(x, c, s);
      const auto at = pressed(c, s, d);
      add(out, c, d.cross(at.force));
    });
  }

  // What forces change by, into (nodes, 3, columns). `dx_start`: of positions at the start; `dx`: at the end, of the
  // nodes of bodies alone that the Hessian does not have; `d_rotation`: of the rotations at the end.
  void add_columns(const double *x_start, const double *x, const double *dx_start, const double *dx,
                   const double *d_rotation, const Memory &memory, double *out) const {
    for (int first = 0; first < r_.columns; first += lanes)
      each([&](int c, int s) {
        if (!acts(c, s)) return;
        const auto law_at = seeded_law(c, first);
        const Mat<Lanes, 3, 3> turn = seeded_rotation(rotation_.data(), d_rotation, c, first);
        const Friction<Lanes> f = seeded_friction(x_start, dx_start, memory, turn, law_at.data(), c, s, first);
        const Vec<Lanes, 3> d = seeded_arm(x, nullptr, gives(c) ? nullptr : dx, c, s, first);
        const auto at = press<Lanes>(f, d, turn, r_.sample_area[s], law_at.data(), shape(c),
                                     AddedPressure{*this, c, s, first});
        for (int a = 0; a < members(c); ++a) spread(at.force, -share(s, a), member(c, s, a), first, out);
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
        const auto at = press<Lanes>(f, d, turn, r_.sample_area[s], law_at.data(), shape(c),
                                     AddedPressure{*this, c, s, first});
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
  template <class> friend struct Pull;

  template <class F> void each(F &&f) const {
    for (int c = 0; c < r_.contacts; ++c)
      for (int s = r_.sample_start[c]; s < r_.sample_start[c + 1]; ++s) f(c, s);
  }
  void turned(int c, double share, const Memory &memory, double *out) const {
    turn_between(&memory.rotation[9 * c], &target_[9 * c], share, out);
  }
  int node(int s, int a) const { return r_.sample_node[s * r_.corners + a]; }
  double weight(int s, int a) const { return r_.sample_weight[s * r_.corners + a]; }
  // Whether the mount of a body gives way: its node is then one more of each sample, which the gap goes against.
  bool gives(int c) const {
    if (!r_.yielding) return false;
    const int32_t *of = r_.yield_of + 3 * r_.body_node[c];
    return of[0] >= 0 || of[1] >= 0 || of[2] >= 0;
  }
  int members(int c) const { return int(r_.corners) + gives(c); }
  int member(int c, int s, int a) const { return a < r_.corners ? node(s, a) : r_.body_node[c]; }
  double share(int s, int a) const { return a < r_.corners ? weight(s, a) : -1.0; }
  const double *law(int c) const { return &laws_[8 * c]; }
  const double *shape(int c) const { return r_.shape + 5 * c; }
  Mat3 rotation(int c) const { return rotation_of(&rotation_[9 * c]); }
  bool acts(int c, int s) const { return gap_[s] < law(c)[REACH] || friction_[s].limit > 0.0; }

  // What effects add at a gap.
  AddedLaws::Normal normal(int c, int s, double gap) const {
    return gap < law(c)[REACH] ? added_[c].normal(gap, bonded_[s]) : AddedLaws::Normal{};
  }
  struct AddedPressure {
    const Contacts &of;
    int c, s, first;
    template <class S> S operator()(const S &gap) const {
      return value(gap) < of.law(c)[REACH] ? of.added_[c].pressure(gap, of.bonded_[s], first) : S(0.0);
    }
  };
  Pressed<double> pressed(int c, int s, const Vec3 &d) const {
    return press<double>(friction_[s], d, rotation(c), r_.sample_area[s], law(c), shape(c), AddedPressure{*this, c, s, 0});
  }

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
      if (dx_body) {
        const double *body = dx_body + (3 * std::size_t(r_.body_node[c]) + i) * r_.columns + first;
        for (int l = 0; l < lanes; ++l) out[i].d[l] = -body[l];
      }
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
    const std::size_t at = std::size_t(s) * r_.columns + first;
    const Lanes limit = added_[c].bound(law_at[MU], seeded(memory.load[s], &memory.d_load[at]), r_.sample_area[s],
                                        seeded(memory.speed[s], &memory.d_speed[at]), first);
    return friction_start<Lanes>(seeded_arm(x_start, dx_start, dx_start, c, s, first),
                                 seeded_rotation(memory.rotation.data(), memory.d_rotation.data(), c, first), turn, anchor,
                                 limit, shape(c));
  }
  void spread(const Vec<Lanes, 3> &v, double by, int at, int first, double *out) const {
    for (int i = 0; i < 3; ++i)
      for (int l = 0; l < lanes; ++l) out[(3 * std::size_t(at) + i) * r_.columns + first + l] += by * v[i].d[l];
  }

  const Record &r_;
  std::vector<AddedLaws> added_;
  std::vector<double> laws_, rotation_, target_, gap_, load_, bonded_;
  std::vector<Friction<double>> friction_;
  std::vector<Mat3> stiffness_;  // of each sample, as the Hessian has it
  std::vector<Slot> slots_;
  std::vector<std::size_t> first_slot_;  // of each sample
};

}  // namespace thinshell
