// Contact of samples with rigid shapes in a thread block: what Contacts of sim_core/core/include/contact.hpp does, of the
// same points (contact_point.hpp), a thread a sample.
#pragma once

#include "block_values.hpp"
#include "contact_point.hpp"
#include "plan.hpp"
#include "sheet_point.hpp"
#include "turning.hpp"

namespace thinshell {

// What samples and bodies remember, in the rollout's own arrays: (s, 3), (s), (s), (contacts, 9).
struct BlockMemory {
  double *anchor, *load, *speed, *rotation;
};

class BlockContacts {
 public:
  // Room for what a step knows of samples and contacts.
  static constexpr int each_sample = 10 + 2 + 3 + 9, each_contact = 8 + 9 + 9 + 18;

  BlockContacts(const Team &team, const Record &record, const Plan &plan, double *room)
      : team_(team), r_(record), p_(plan), samples_(int(record.samples)), contacts_(int(record.contacts)) {
    auto take = [&](int each, int count) {
      double *at = room;
      room += each * count;
      return at;
    };
    friction_ = take(10, samples_);
    gap_ = take(1, samples_);
    load_ = take(1, samples_);
    force_ = take(3, samples_);
    stiffness_ = take(9, samples_);
    laws_ = take(8, contacts_);
    rotation_ = take(9, contacts_);
    target_ = take(9, contacts_);
    way_ = take(18, contacts_);
    team_.each(8 * contacts_, [&](int k) { laws_[k] = r_.law[k]; });
  }

  bool any() const { return contacts_ > 0; }

  THINSHELL_APART void guard(bool on) {
    team_.each(contacts_, [&](int c) { set_guard(laws_ + 8 * c, on); });
  }
  THINSHELL_APART bool guard_matters() const {
    return team_.most(samples_, [&](int s) { return gap_[s] < core_free * law(of(s))[RANGE] ? 1.0 : 0.0; }) > 0.0;
  }

  THINSHELL_APART void begin(const double *x_start, const double *turned, const BlockMemory &memory) {
    team_.each(9 * contacts_, [&](int k) { rotation_[k] = target_[k] = turned[k]; });
    team_.each(samples_, [&](int s) {
      const int c = of(s);
      const double limit = law(c)[MU] * memory.load[s];
      put(s, friction_start<double>(arm(x_start, c, s), rotation_of(memory.rotation + 9 * c), rotation(c),
                                    point(memory.anchor, s), limit, shape(c)));
    });
  }
  THINSHELL_APART void turn(double share, const BlockMemory &memory) {
    team_.each(contacts_, [&](int c) { turn_between(memory.rotation + 9 * c, target_ + 9 * c, share, rotation_ + 9 * c); });
  }
  THINSHELL_APART bool turns(const BlockMemory &memory) const {
    return team_.most(9 * contacts_, [&](int k) { return target_[k] != memory.rotation[k] ? 1.0 : 0.0; }) > 0.0;
  }

  THINSHELL_APART double energy(const double *x) const {
    return team_.sum(samples_, [&](int s) {
      const int c = of(s);
      const Vec3 d = arm(x, c, s);
      const auto found = laws::shapes::signed_distance(Vec3(matmul(rotation(c).transpose(), d)), shape(c));
      const double gap = found.a0 - law(c)[OFFSET];
      double out = gap < law(c)[REACH] ? r_.sample_area[s] * laws::pressure_and_friction::potential(gap, law(c)) : 0.0;
      const Friction<double> f = friction(s);
      if (f.limit > 0.0)
        out += laws::pressure_and_friction::friction_potential(slip_of(f, d, rotation(c)), f.limit,
                                                               law(c)[STIFFNESS] * r_.sample_area[s]);
      return out;
    });
  }

  // Forces on all samples.
  THINSHELL_APART void measure(const double *x) {
    team_.each(samples_, [&](int s) {
      const auto at = pressed(s, arm(x, of(s), s));
      gap_[s] = at.gap;
      load_[s] = at.load;
      for (int k = 0; k < 3; ++k) force_[3 * s + k] = at.force[k];
    });
  }
  // Of forces that were measured last: on a node, from its samples; on the bodies' nodes, into (nodes, 3).
  Vec3 on_node(int i) const {
    Vec3 out{};
    for (int k = p_.sample_start[i]; k < p_.sample_start[i + 1]; ++k)
      out += p_.sample_weight[k] * point(force_, p_.sample_at[k]);
    return out;
  }
  THINSHELL_APART void add_on_bodies(double *out) {
    if (team_.most(3 * samples_, [&](int k) { return abs(force_[k]); }) == 0.0) return;
    for (int c = 0; c < contacts_; ++c) {
      const int first = r_.sample_start[c];
      const Vec3 total = team_.sum_of_vectors(r_.sample_start[c + 1] - first, [&](int k) { return point(force_, first + k); });
      team_.each(1, [&](int) { add(out, r_.body_node[c], total); });
    }
  }
  // Work along a direction of the unknowns.
  THINSHELL_APART double along(const double *direction) const {
    return team_.sum(samples_, [&](int s) {
      double out = 0.0;
      for (int a = 0; a < r_.corners; ++a)
        for (int k = 0; k < 3; ++k) {
          const int at = p_.number[3 * node(s, a) + k];
          if (at >= 0) out -= weight(s, a) * force_[3 * s + k] * direction[at];
        }
      return out;
    });
  }
  // Largest force on a node.
  THINSHELL_APART double largest_force() const {
    const double free = team_.most(int(r_.nodes), [&](int i) {
      const Vec3 f = on_node(i);
      return max(abs(f[0]), abs(f[1]), abs(f[2]));
    });
    double most = free;
    for (int c = 0; c < contacts_; ++c) {
      const int first = r_.sample_start[c];
      const Vec3 total = team_.sum_of_vectors(r_.sample_start[c + 1] - first, [&](int k) { return point(force_, first + k); });
      most = max(most, abs(total[0]), abs(total[1]), abs(total[2]));
    }
    return most;
  }

  THINSHELL_APART void measure_stiffness(const double *x, bool exact) {
    team_.each(samples_, [&](int s) {
      const int c = of(s);
      const Vec3 d = arm(x, c, s);
      const Mat3 turn = rotation(c);
      const auto found = laws::shapes::signed_distance(Vec3(matmul(turn.transpose(), d)), shape(c));
      const double gap = found.a0 - law(c)[OFFSET];
      const Friction<double> f = friction(s);
      Mat3 k{};
      if (gap < law(c)[REACH] || f.limit > 0.0)
        k = stiffness_of(f, d, turn, r_.sample_area[s], gap, Vec3(found.a1), Mat3(found.a2), law(c), 0.0, 0.0, exact);
      for (int i = 0; i < 9; ++i) stiffness_[9 * s + i] = k[i];
    });
  }
  const double *stiffness(int s) const { return stiffness_ + 9 * s; }
  // What forces on a node change by, with that stiffness, where the bodies' nodes move (nodes, 3).
  Vec3 follow(int i, const double *move) const {
    Vec3 out{};
    for (int k = p_.sample_start[i]; k < p_.sample_start[i + 1]; ++k) {
      const int s = p_.sample_at[k];
      out -= p_.sample_weight[k] * matmul(rotation_of(stiffness_ + 9 * s), point(move, r_.body_node[of(s)]));
    }
    return out;
  }

  THINSHELL_APART double free_way(const BlockValues &from, const BlockValues &by, double keep, double since, double till,
                                  const BlockMemory &memory) const {
    const double *x = from.data(), *move = by.data();
    team_.each(contacts_, [&](int c) {
      turn_between(memory.rotation + 9 * c, target_ + 9 * c, since, way_ + 18 * c);
      turn_between(memory.rotation + 9 * c, target_ + 9 * c, till, way_ + 18 * c + 9);
    });
    return team_.least(samples_, 1.0, [&](int s) {
      const int c = of(s);
      const Mat3 first = rotation_of(way_ + 18 * c), last = rotation_of(way_ + 18 * c + 9);
      const Vec3 start = matmul(first.transpose(), arm(x, c, s)), d = arm(x, c, s) + arm(move, c, s);
      const Vec3 along = matmul(last.transpose(), d) - start;
      return double(laws::continuous_collision::point_shape_way(start, along, shape(c), law(c)[OFFSET], keep));
    });
  }

  // Memory after the step that ended at `x`, from forces that were measured last.
  THINSHELL_APART void end(const double *x, double dt, const BlockMemory &memory) const {
    team_.each(samples_, [&](int s) {
      Vec3 anchor{};
      double speed = 0.0;
      if (load_[s] > 0.0)
        slide<double>(friction(s), arm(x, of(s), s), rotation(of(s)), r_.sample_area[s], law(of(s)), dt, anchor, speed);
      for (int k = 0; k < 3; ++k) memory.anchor[3 * s + k] = anchor[k];
      memory.load[s] = load_[s];
      memory.speed[s] = speed;
    });
    team_.each(9 * contacts_, [&](int k) { memory.rotation[k] = rotation_[k]; });
  }

  // Moments of the forces on the samples about the bodies' nodes (contacts, 3).
  THINSHELL_APART void moments(const double *x, double *out) const {
    for (int c = 0; c < contacts_; ++c) {
      const int first = r_.sample_start[c];
      const Vec3 total = team_.sum_of_vectors(r_.sample_start[c + 1] - first, [&](int k) {
        return arm(x, c, first + k).cross(pressed(first + k, arm(x, c, first + k)).force);
      });
      team_.each(3, [&](int k) { out[3 * c + k] = total[k]; });
    }
  }

  THINSHELL_APART double gap() const { return team_.least(samples_, infinity(), [&](int s) { return gap_[s]; }); }

  THINSHELL_APART void report(StepCounts &out) const {
    out.contacts = int64_t(team_.sum(samples_, [&](int s) { return load_[s] > 0.0 ? 1.0 : 0.0; }));
    out.gap = gap();
    const double all = contacts_;
    const double at = team_.least(samples_, all, [&](int s) { return gap_[s] == out.gap ? double(of(s)) : all; });
    out.tightest = at < all ? int64_t(at) : -1;
  }

 private:
  int of(int s) const { return p_.sample_contact[s]; }
  int node(int s, int a) const { return r_.sample_node[s * r_.corners + a]; }
  double weight(int s, int a) const { return r_.sample_weight[s * r_.corners + a]; }
  const double *law(int c) const { return laws_ + 8 * c; }
  const double *shape(int c) const { return r_.shape + 5 * c; }
  Mat3 rotation(int c) const { return rotation_of(rotation_ + 9 * c); }

  Vec3 arm(const double *x, int c, int s) const {
    Vec3 out = -point(x, r_.body_node[c]);
    for (int a = 0; a < r_.corners; ++a) out += weight(s, a) * point(x, node(s, a));
    return out;
  }
  Pressed<double> pressed(int s, const Vec3 &d) const {
    const int c = of(s);
    return press<double>(friction(s), d, rotation(c), r_.sample_area[s], law(c), shape(c), [](double) { return 0.0; });
  }
  Friction<double> friction(int s) const {
    const double *f = friction_ + 10 * s;
    return {point(f, 0), point(f, 1), point(f, 2), f[9]};
  }
  void put(int s, const Friction<double> &f) {
    for (int k = 0; k < 3; ++k) {
      friction_[10 * s + k] = f.y[k];
      friction_[10 * s + 3 + k] = f.normal[k];
      friction_[10 * s + 6 + k] = f.anchor[k];
    }
    friction_[10 * s + 9] = f.limit;
  }

  const Team &team_;
  const Record &r_;
  const Plan &p_;
  int samples_, contacts_;
  double *friction_, *gap_, *load_, *force_, *stiffness_, *laws_, *rotation_, *target_, *way_;
};

}  // namespace thinshell
