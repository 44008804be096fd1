// The incremental potential of one step in a thread block: what System of sim_core/core/include/system.hpp does for sheets,
// with the same points (sheet_point.hpp, contact_point.hpp) and under the same searches.
//
// A thread has an element, and leaves what it works out; a thread has a node or a block of two nodes, and adds up what the
// elements around left, in the order of the plan's lists.
#pragma once

#include "band_factor.hpp"
#include "block_contact.hpp"

namespace thinshell {

// Room of one thread block in global memory, numbers each (sim_core/gpu/engine.py makes it as large).
struct Rooms {
  double *arena, *contact, *stretched, *stretch_base, *angle, *angle_base, *moment, *slope, *row, *part, *value, *factor;
};

// From what velocity and acceleration at the end of a step are measured.
struct BlockStep {
  double dt, tau, now, before;
};

class BlockSystem {
 public:
  using Values = BlockValues;
  using Corrections = BlockCorrections;
  using Memory = BlockMemory;

  BlockSystem(Arena &arena, const Record &record, const Plan &plan, const Rooms &rooms, double *window, double *panel,
              double *area)
      : contacts(arena.team, record, plan, rooms.contact), factor(arena.team, plan, window, panel, area, rooms.factor),
        x(arena, 3 * int(record.nodes), 0.0), gradient(arena, 3 * int(record.nodes), 0.0), arena_(arena), team_(arena.team),
        r_(record), p_(plan), o_(rooms), whole_(3 * int(record.nodes)), nodes_(int(record.nodes)),
        triangles_(int(record.triangles)), hinges_(int(record.hinges)), unknowns_(int(plan.unknowns)),
        base_(arena, whole_, 0.0), velocity_(arena, whole_, 0.0), predicted_(arena, whole_, 0.0) {
    team_.each(2, [&](int k) { o_.value[9 * p_.blocks + k] = k; });  // what tiles have where there is no block
    load_ = team_.most(whole_, [&](int k) { return abs(r_.external[k]); });
  }

  BlockContacts contacts;
  BandFactor factor;
  Values x, gradient;
  int64_t residuals = 0;

  int whole() const { return whole_; }
  Values vector() const { return Values(arena_, whole_); }
  bool exhausted() const { return arena_.overflow; }

  // `x_past`: null where there is none.
  THINSHELL_APART void begin(const BlockStep &step, const Values &start, const Values &velocity, const double *x_past,
                             const double *v_past, const double *turned, const Memory &memory, bool inertia) {
    tau_ = step.tau;
    pull_ = inertia ? 1.0 / (tau_ * tau_) : 0.0;
    const double *x0 = start.data(), *v0 = velocity.data();
    double *base = base_.data(), *v = velocity_.data(), *predicted = predicted_.data();
    team_.each(whole_, [&](int k) {
      base[k] = x_past ? step.now * x0[k] + step.before * x_past[k] : x0[k];
      v[k] = x_past ? step.now * v0[k] + step.before * v_past[k] : v0[k];
      predicted[k] = base[k] + step.tau * v[k];
    });
    team_.each(triangles_, [&](int t) {
      Vec3 e = step.now * green_strain(columns_of(x0, t));
      if (x_past) e += step.before * green_strain(columns_of(x_past, t));
      for (int i = 0; i < 3; ++i) o_.stretch_base[3 * t + i] = e[i];
    });
    team_.each(hinges_, [&](int e) {
      double angle = step.now * turned_by(x0, e);
      if (x_past) angle += step.before * turned_by(x_past, e);
      o_.angle_base[e] = angle;
    });
    contacts.begin(x0, turned, memory);
    measured_ = false;
  }
  // Velocities at the end of the step, into (nodes, 3).
  THINSHELL_APART void velocities(double *out, bool inertia) const {
    const double *there = x.data(), *base = base_.data();
    team_.each(whole_, [&](int k) { out[k] = inertia ? (there[k] - base[k]) / tau_ : 0.0; });
  }

  bool cover() { return false; }  // rigid shapes are looked at always
  bool straighten(const Values &) { return false; }
  bool turns_over(const Values &) const { return false; }

  void tether(double tau) {
    free_pull_ = pull_;
    free_predicted_ = predicted_;
    pull_ = 1.0 / (tau * tau);
    predicted_ = x;
  }
  void untether() {
    pull_ = free_pull_;
    predicted_ = free_predicted_;
  }

  THINSHELL_APART Values unknowns() const {
    Values out(arena_, unknowns_);
    gather(x.data(), out.data());
    return out;
  }
  THINSHELL_APART void go(const Values &start, double share, const Values &direction) {
    double *to = x.data();
    const double *from = start.data(), *by = direction.data();
    team_.each(unknowns_, [&](int k) { to[p_.own[k]] = from[k] + share * by[k]; });
    measured_ = false;
  }
  THINSHELL_APART void put(const Values &where) {
    x = where;
    measured_ = false;
  }
  THINSHELL_APART void hold(const double *targets) {
    double *to = x.data();
    team_.each(whole_, [&](int k) {
      if (r_.prescribed[k]) to[k] = targets[k];
    });
    measured_ = false;
  }
  // No mount gives way.
  const Values &stripped(const Values &there) const { return there; }
  THINSHELL_APART Values prescribed_move(const Values &from, const Values &targets) const {
    Values out(arena_, whole_);
    double *to = out.data();
    const double *there = targets.data(), *here = from.data();
    team_.each(whole_, [&](int k) { to[k] = r_.prescribed[k] ? there[k] - here[k] : 0.0; });
    return out;
  }
  THINSHELL_APART Values spread(const Values &direction) const {
    Values out(arena_, whole_);
    double *to = out.data();
    const double *from = direction.data();
    team_.each(whole_, [&](int k) { to[k] = p_.number[k] >= 0 ? from[p_.number[k]] : 0.0; });
    return out;
  }

  THINSHELL_APART double energy() {
    const double *at = x.data(), *predicted = predicted_.data(), *base = base_.data();
    const double loads = team_.sum(nodes_, [&](int i) {
      double out = 0.0;
      for (int c = 0; c < 3; ++c) out -= r_.external[3 * i + c] * at[3 * i + c];
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double pull = pull_ * r_.mass[k], rub = r_.mass_damping[k] / tau_;
        for (int c = 0; c < 3; ++c)
          out += 0.5 * pull * (at[3 * i + c] - predicted[3 * i + c]) * (at[3 * j + c] - predicted[3 * j + c]) +
                 0.5 * rub * (at[3 * i + c] - base[3 * i + c]) * (at[3 * j + c] - base[3 * j + c]);
      }
      return out;
    });
    const double stretch = team_.sum(triangles_, [&](int t) {
      const Vec3 e = green_strain(columns_of(at, t)), since = e - point(o_.stretch_base, t);
      const double *k = r_.stretch_stiffness + 9 * t;
      return 0.5 * e.dot(stiff_times(k, e)) + 0.5 * rate(t) * since.dot(stiff_times(k, since));
    });
    team_.each(hinges_, [&](int e) { o_.angle[e] = turned_by(at, e); });
    measured_ = false;
    const double bend = team_.sum(hinges_, [&](int e) {
      double held = 0.0, rubbed = 0.0;
      for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k) {
        const int o = r_.coupling_column[k];
        held += r_.bend_stiffness[k] * o_.angle[o];
        rubbed += r_.bend_damping[k] * (o_.angle[o] - o_.angle_base[o]);
      }
      return 0.5 * o_.angle[e] * held + 0.5 * (o_.angle[e] - o_.angle_base[e]) * rubbed / tau_;
    });
    return loads + stretch + bend + (contacts.any() ? contacts.energy(at) : 0.0);
  }

  THINSHELL_APART Values residual() {
    ++residuals;
    const double *at = x.data();
    if (contacts.any()) contacts.measure(at);
    measure();
    assemble_gradient();
    if (contacts.any()) contacts.add_on_bodies(gradient.data());
    Values out(arena_, unknowns_);
    gather(gradient.data(), out.data());
    return out;
  }

  THINSHELL_APART double contact_along(const Values &direction) {
    contacts.measure(x.data());
    return contacts.along(direction.data());
  }
  THINSHELL_APART double contact_load() {
    if (!contacts.any()) return 0.0;
    contacts.measure(x.data());
    return contacts.largest_force();
  }

  double largest_load() const { return load_; }
  THINSHELL_APART double force_scale() const { return max(largest(gradient), load_); }
  THINSHELL_APART double force_noise() const { return 2.220446049250313e-16 * stiffest_ * largest(x); }

  THINSHELL_APART void assemble(bool exact, const double *move) {
    ++stamp_;
    const double *at = x.data();
    measure();
    const Rooms o_ = this->o_;  // a copy stays in registers
    team_.each(triangles_, [&](int t) {
      const Mat<double, 3, 2> f = columns_of(at, t);
      Vec3 e = green_strain(f);
      if (move) e = foreseen_strain(e, columns_of(move, t));
      Vec3 s = stress(t, e);
      if (!exact) s = laws::membrane::tension_of(s);
      double stiff[9];
      for (int i = 0; i < 9; ++i) stiff[i] = (1.0 + rate(t)) * r_.stretch_stiffness[9 * t + i];
      double *to = o_.part + 54 * t;
      for (int a = 0; a < 3; ++a)
        for (int d = a; d < 3; ++d, to += 9) {
          const Mat3 block = triangle_block(f, s, stiff, r_.hats + 6 * t, a, d);
          for (int i = 0; i < 9; ++i) to[i] = block[i];
        }
    });
    team_.each(int(p_.row_nodes), [&](int q) {
      Vec3 total{};
      THINSHELL_AHEAD for (int k = p_.row_start[q]; k < p_.row_start[q + 1]; ++k) {
        const int at = p_.row_coupling[k];
        total += (r_.bend_stiffness[at] + r_.bend_damping[at] / tau_) * point(o_.slope, p_.row_corner[k]);
      }
      for (int i = 0; i < 3; ++i) o_.row[3 * q + i] = total[i];
    });
    if (exact)
      team_.each(2 * hinges_, [&](int k) {
        const int e = k / 2, side = k % 2;
        const auto curvature = laws::dihedral::side_curvature(corner(at, e, 0), corner(at, e, 1), corner(at, e, 2 + side),
                                                              side ? -1.0 : 1.0);
        double *to = o_.part + 54 * (triangles_ + k);
        for (int i = 0; i < 3; ++i)
          for (int j = i; j < 3; ++j) {
            const Mat3 block = side_block(o_.moment[e], curvature, i, j);
            for (int c = 0; c < 9; ++c) *to++ = block[c];
          }
      });
    if (contacts.any()) contacts.measure_stiffness(at, exact);
    team_.each(int(p_.blocks), [&](int b) {
      const Mat3 block = block_of(b, exact, o_);
      for (int k = 0; k < 9; ++k) o_.value[9 * b + k] = block[k];
    });
    stiffest_ = team_.most(unknowns_, [&](int k) { return abs(o_.value[p_.diagonal[k]]); });
  }
  double stiffest() const { return stiffest_; }
  int64_t stamp() const { return stamp_; }
  double pull() const { return pull_; }

  bool factorise(bool, double shift = 0.0) {
    ++stamp_;
    return factor.factorise(o_.value, shift);
  }
  // H^-1 of a residual, in place.
  THINSHELL_APART void solve(Values &v) {
    double *b = factor.rhs(), *at = v.data();
    team_.each(8 * int(p_.tiles), [&](int k) { b[k] = k < unknowns_ ? at[k] : 0.0; });
    factor.solve();
    const double *found = factor.answer();
    team_.each(unknowns_, [&](int k) { at[k] = found[k]; });
  }

  THINSHELL_APART Values follow(const Values &by) const {
    Values nodal(arena_, whole_), out(arena_, unknowns_);
    const double *move = by.data();
    double *to = nodal.data();
    team_.each(nodes_, [&](int i) {
      Vec3 total = contacts.follow(i, move);
      for (int k = p_.border_start[i]; k < p_.border_start[i + 1]; ++k) {
        const int b = p_.border_at[k] / 2, turned = p_.border_at[k] % 2;
        const Mat3 block = rotation_of(o_.value + 9 * b);
        const Vec3 moved = point(move, p_.block_node[2 * b + 1 - turned]);
        total += turned ? matmul(block.transpose(), moved) : matmul(block, moved);
      }
      for (int k = 0; k < 3; ++k) to[3 * i + k] = total[k];
    });
    gather(to, out.data());
    return out;
  }

 private:
  THINSHELL_APART void gather(const double *nodal, double *out) const {
    team_.each(unknowns_, [&](int k) { out[k] = nodal[p_.own[k]]; });
  }
  double rate(int t) const { return r_.stretch_damping[t] / tau_; }
  Mat<double, 3, 2> columns_of(const double *at, int t) const {
    return deformation(at, r_.triangle + 3 * t, r_.hats + 6 * t);
  }
  Vec3 stress(int t, const Vec3 &e) const {
    return stiff_times(r_.stretch_stiffness + 9 * t, Vec3((1.0 + rate(t)) * e - rate(t) * point(o_.stretch_base, t)));
  }
  Vec3 corner(const double *at, int e, int a) const { return point(at, r_.hinge[4 * e + a]); }
  double turned_by(const double *at, int e) const {
    return laws::dihedral::angle(corner(at, e, 0), corner(at, e, 1), corner(at, e, 2), corner(at, e, 3)) - r_.rest_angle[e];
  }
  void keep_stretched(int t, const Mat<double, 3, 2> &f, const Vec3 &s) {
    double *to = o_.stretched + 9 * t;
    for (int k = 0; k < 6; ++k) to[k] = f[k];
    for (int k = 0; k < 3; ++k) to[6 + k] = s[k];
  }
  static Mat<double, 3, 2> kept_columns(const Rooms &o_, int t) {
    Mat<double, 3, 2> f;
    for (int k = 0; k < 6; ++k) f[k] = o_.stretched[9 * t + k];
    return f;
  }

  // Stresses of triangles, angles of hinges with their slopes and moments.
  THINSHELL_APART void measure() {
    if (measured_) return;
    const double *at = x.data();
    const Rooms o_ = this->o_;
    for (int k = team_.thread(); k < triangles_; k += team_.threads()) {
      const Mat<double, 3, 2> f = columns_of(at, k);
      keep_stretched(k, f, stress(k, green_strain(f)));
    }
    team_.each(hinges_, [&](int e) {
      o_.angle[e] = turned_by(at, e);
      const auto g = laws::dihedral::angle_gradient(corner(at, e, 0), corner(at, e, 1), corner(at, e, 2), corner(at, e, 3));
      for (int k = 0; k < 12; ++k) o_.slope[12 * e + k] = g[k];
    });
    team_.each(hinges_, [&](int e) {
      double total = 0.0;
      THINSHELL_AHEAD for (int k = r_.coupling_start[e]; k < r_.coupling_start[e + 1]; ++k) {
        const int o = r_.coupling_column[k];
        total += r_.bend_stiffness[k] * o_.angle[o] + r_.bend_damping[k] / tau_ * (o_.angle[o] - o_.angle_base[o]);
      }
      o_.moment[e] = total;
    });
    measured_ = true;
  }

  THINSHELL_APART void assemble_gradient() {
    const double *at = x.data(), *predicted = predicted_.data(), *base = base_.data();
    double *out = gradient.data();
    const Rooms o_ = this->o_;
    team_.each(nodes_, [&](int i) {
      Vec3 total = -point(r_.external, i);
      if (contacts.any()) total -= contacts.on_node(i);
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        total += (pull_ * r_.mass[k]) * (point(at, j) - point(predicted, j)) +
                 (r_.mass_damping[k] / tau_) * (point(at, j) - point(base, j));
      }
      THINSHELL_AHEAD for (int k = p_.triangle_start[i]; k < p_.triangle_start[i + 1]; ++k) {
        const int t = p_.triangle_at[k] / 3, a = p_.triangle_at[k] % 3;
        total += corner_force(kept_columns(o_, t), point(o_.stretched + 9 * t, 2), r_.hats + 6 * t, a);
      }
      THINSHELL_AHEAD for (int k = p_.hinge_start[i]; k < p_.hinge_start[i + 1]; ++k)
        total += o_.moment[p_.hinge_at[k] / 4] * point(o_.slope, p_.hinge_at[k]);
      for (int k = 0; k < 3; ++k) out[3 * i + k] = total[k];
    });
  }

  Mat3 block_of(int b, bool exact, const Rooms &o_) const {
    Mat3 out{};
    double diagonal = 0.0;
    for (int k = p_.mass_start[b]; k < p_.mass_start[b + 1]; ++k)
      diagonal += pull_ * r_.mass[p_.mass_at[k]] + r_.mass_damping[p_.mass_at[k]] / tau_;
    for (int k = 0; k < 9; k += 4) out[k] = diagonal;
    const int end = p_.part_start[2 * b + (exact ? 2 : 1)];
    THINSHELL_AHEAD for (int k = p_.part_start[2 * b]; k < end; ++k) {
      const Mat3 part = rotation_of(o_.part + 9 * (p_.part_at[k] / 2));
      const bool turned = p_.part_at[k] % 2;
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) out(i, j) += turned ? part(j, i) : part(i, j);
    }
    THINSHELL_AHEAD for (int k = p_.bend_start[b]; k < p_.bend_start[b + 1]; ++k)
      out += point(o_.slope, p_.bend_corner[k]).outer_product(point(o_.row, p_.bend_place[k]));
    for (int k = p_.contact_start[b]; k < p_.contact_start[b + 1]; ++k) {
      const double *stiff = contacts.stiffness(p_.contact_at[k]);
      for (int i = 0; i < 9; ++i) out[i] += p_.contact_weight[k] * stiff[i];
    }
    return out;
  }

  Arena &arena_;
  const Team &team_;
  const Record &r_;
  const Plan &p_;
  const Rooms &o_;
  int whole_, nodes_, triangles_, hinges_, unknowns_;
  Values base_, velocity_, predicted_, free_predicted_;
  double tau_ = 1.0, pull_ = 0.0, free_pull_ = 0.0, load_ = 0.0, stiffest_ = 0.0;
  int64_t stamp_ = 0;
  bool measured_ = false;
};

}  // namespace thinshell
