// A rollout: one step after the other along prescribed motions of the mounts, with derivatives by parameters.
//
// A step that the fast Newton finds is as that of sim_core/solve/contact_newton.py and newton.py: from a guess, where
// velocities lead, or where the step starts; accepted if the last tangent was the true Hessian, positive definite, the
// energy is not above that of the start, and the straight path to it is free. What is not found is left to the caller,
// who takes the state, makes the step and hands its end back (`accept`).
//
// Derivatives follow the implicit steps, as sim_core/gradients/step.py has them: with the residual R(x'; s, p) = 0,
//
//     dx' = -H^-1 [dR/ds ds + dR/dp + H dm] + dm
//
// s: the state at the start with its memory, dm: motion of what is prescribed, H: the true Hessian at the solution.
#pragma once

#include <vector>

#include "newton.hpp"

namespace thinshell {

struct Frames {
  const double *places;   // origins and rotations of the mounts (mounts, 12)
  const double *motions;  // their motions in their own frames by the parameters (mounts, 6, columns); null: none
};

// Where results of one instant go.
struct Outputs {
  double *x, *force, *moment;           // (nodes, 3), (nodes, 3), (contacts, 3)
  double *d_x, *d_force, *d_moment;     // the same with columns, forces of the bearing nodes
};

class Rollout {
 public:
  explicit Rollout(const Record &record) : r_(record), system(r_) {
    const std::size_t whole = system.whole(), samples = r_.samples, width = r_.columns;
    for (Values *v : {&x, &v_, &x_past, &v_past}) v->assign(whole, 0.0);
    for (Values *v : {&d_x, &d_v, &d_x_past, &d_v_past}) v->assign(whole * width, 0.0);
    memory.anchor.assign(3 * samples, 0.0);
    memory.load.assign(samples, 0.0);
    memory.speed.assign(samples, 0.0);
    memory.rotation.assign(9 * r_.contacts, 0.0);
    memory.d_anchor.assign(3 * samples * width, 0.0);
    memory.d_load.assign(samples * width, 0.0);
    memory.d_speed.assign(samples * width, 0.0);
    memory.d_rotation.assign(9 * r_.contacts * width, 0.0);
    turned_.assign(9 * r_.contacts, 0.0);
    d_turned_.assign(9 * r_.contacts * width, 0.0);
    targets_.assign(whole, 0.0);
    d_force_.assign(whole * width, 0.0);
    d_moment_.assign(3 * r_.contacts * width, 0.0);
    moment_.assign(3 * r_.contacts, 0.0);
    system.contacts.guard(true);
  }

  // One step of `dt` [s] to where the mounts are at the `frames`; `guess`: where to begin the search (null: nowhere).
  bool step(double dt, const Frames &frames, const double *guess, bool inertia, StepCounts &counts) {
    place(frames);
    begin(dt, inertia);
    const int64_t residuals = system.residuals;
    const bool found = search(guess, inertia, counts);
    system.contacts.guard(true);
    counts.residuals = system.residuals - residuals;
    system.contacts.report(counts);
    return found;
  }

  // Take the step: from where the system stands at its end to the next state, with derivatives.
  void end(double dt, const Frames &frames, bool inertia) {
    if (system.contacts.any()) system.contacts.shapes.moments(system.x.data(), moment_.data());
    if (r_.columns) push(dt, frames, inertia);
    system.contacts.end(system.x.data(), dt, memory);
    x_past.swap(x);
    v_past.swap(v_);
    x = system.x;
    if (inertia)
      for (std::size_t k = 0; k < x.size(); ++k) v_[k] = (x[k] - step_.x_base[k]) / step_.tau;
    else
      std::fill(v_.begin(), v_.end(), 0.0);
    has_past = inertia && r_.second_order;
    dt_past = dt;
  }

  // Take a step whose end another search has found [m] (nodes, 3).
  void accept(double dt, const Frames &frames, const double *there, bool inertia) {
    place(frames);
    begin(dt, inertia);
    std::copy(there, there + system.whole(), system.x.begin());
    system.cover();
    system.residual();
    end(dt, frames, inertia);
  }

  // The potential of the step of `dt` [s] that begins now, at `there` [m] (nodes, 3): energy [J], gradient [N], and the
  // Hessian [N/m] (3 nodes, 3 nodes).
  void potential(double dt, const Frames &frames, const double *there, bool inertia, bool exact, double *energy,
                 double *gradient, double *hessian) {
    place(frames);
    begin(dt, inertia);
    std::copy(there, there + system.whole(), system.x.begin());
    system.cover();
    *energy = system.energy();
    system.residual();
    std::copy(system.gradient.begin(), system.gradient.end(), gradient);
    system.assemble(exact, nullptr);
    system.hessian.spread(hessian);
  }

  void write(const Outputs &out) const {
    const std::size_t width = r_.columns;
    std::copy(system.x.begin(), system.x.end(), out.x);
    for (std::size_t k = 0; k < system.whole(); ++k) out.force[k] = -system.gradient[k];
    std::copy(moment_.begin(), moment_.end(), out.moment);
    if (!width) return;
    std::copy(d_x.begin(), d_x.end(), out.d_x);
    for (int b = 0; b < r_.bearing; ++b) {
      const double *from = &d_force_[3 * width * r_.bearing_node[b]];
      for (std::size_t k = 0; k < 3 * width; ++k) out.d_force[3 * width * b + k] = -from[k];
    }
    std::copy(d_moment_.begin(), d_moment_.end(), out.d_moment);
  }

  // Be at rest in a state that was written into x, d_x and the memory.
  void rest(bool keep_velocity) {
    if (!keep_velocity) {
      std::fill(v_.begin(), v_.end(), 0.0);
      std::fill(d_v.begin(), d_v.end(), 0.0);
    }
    has_past = false;
    if (!r_.columns) return;
    system.triangles.restart_slopes(x.data(), d_x.data());
    system.hinges.restart_slopes(x.data(), d_x.data());
    system.tetrahedra.restart_slopes(x.data(), d_x.data());
  }

 private:
  static constexpr double harder = 3.0, any_gap = 1e-6;

  // Where followers and rigid bodies are when the mounts are at `frames`.
  void place(const Frames &frames) {
    for (int f = 0; f < r_.followers; ++f) {
      const double *at = frames.places + 12 * r_.follower_mount[f], *local = r_.follower_local + 3 * f;
      for (int i = 0; i < 3; ++i)
        if (r_.follower_axes[3 * f + i])
          targets_[3 * r_.follower_node[f] + i] =
              at[i] + at[3 + 3 * i] * local[0] + at[4 + 3 * i] * local[1] + at[5 + 3 * i] * local[2];
    }
    for (int c = 0; c < r_.contacts; ++c) {
      const Mat3 turn = matmul(rotation_of(frames.places + 12 * r_.body_mount[c] + 3), rotation_of(r_.body_rotation + 9 * c));
      std::copy(turn.a, turn.a + 9, &turned_[9 * c]);
    }
  }

  void begin(double dt, bool inertia) {
    step_.dt = dt;
    const double r = has_past ? dt / dt_past : 0.0;
    step_.now = (1.0 + r) * (1.0 + r) / (1.0 + 2.0 * r);
    step_.before = -r * r / (1.0 + 2.0 * r);
    step_.tau = dt * (1.0 + r) / (1.0 + 2.0 * r);
    combine(x, x_past, step_.x_base);
    combine(v_, v_past, step_.v_base);
    system.x = x;
    system.hold(targets_.data());
    Values towards = x;
    for (std::size_t k = 0; k < towards.size(); ++k) towards[k] = r_.prescribed[k] ? targets_[k] : x[k] + dt * v_[k];
    system.begin(step_, x.data(), has_past ? x_past.data() : nullptr, towards.data(), turned_.data(), memory, inertia);
  }
  void combine(const Values &here, const Values &past, Values &out) const {
    out = here;
    if (!has_past) return;
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = step_.now * here[k] + step_.before * past[k];
  }

  bool search(const double *guess, bool inertia, StepCounts &counts) {
    if (guess && attempt(guess, true, inertia, counts)) return true;
    Values drift;
    if (inertia) {
      drift = v_;
      for (std::size_t k = 0; k < drift.size(); ++k) {
        drift[k] *= step_.dt;
        if (has_past) drift[k] += 0.5 * step_.dt * step_.dt * (v_[k] - v_past[k]) / dt_past;
      }
      if (largest(drift.data(), drift.size()) > 0.0 && !runs_into(drift)) {
        for (std::size_t k = 0; k < drift.size(); ++k) drift[k] += x[k];
        if (attempt(drift.data(), false, inertia, counts)) return true;
      }
    }
    return attempt(x.data(), false, inertia, counts);
  }

  void put(const double *where) { std::copy(where, where + system.whole(), system.x.begin()); }

  // Whether contact would be loaded far more where velocities lead than it is: no place to search from.
  bool runs_into(const Values &drift) {
    if (!system.contacts.any()) return false;
    system.contacts.guard(false);
    for (std::size_t k = 0; k < drift.size(); ++k) system.x[k] = x[k] + drift[k];
    system.hold(targets_.data());
    const double load = system.contact_load();
    if (load <= harder * system.largest_load()) return false;
    put(x.data());
    return load > harder * system.contact_load();
  }

  bool attempt(const double *where, bool near, bool inertia, StepCounts &counts) {
    const bool touches = system.contacts.any();
    if (touches) system.contacts.guard(false);
    put(near ? where : x.data());
    system.hold(targets_.data());
    const double energy = system.energy();
    Values move;
    put(where);
    if (!near) {
      move.assign(system.whole(), 0.0);
      for (std::size_t k = 0; k < move.size(); ++k)
        if (r_.prescribed[k]) move[k] = targets_[k] - where[k];
      if (largest(move.data(), move.size()) < r_.step_tolerance) move.clear();
    }
    if (move.empty()) system.hold(targets_.data());
    FastNewton newton(system, r_, targets_.data(), std::move(move), inertia, near, counts);
    if (!newton.run()) return false;
    if (!(system.energy() <= energy + 1e-13 * std::abs(energy) + 1e-30)) return false;
    if (system.tetrahedra.turns_over(x.data(), system.x.data())) return false;
    if (!touches) return true;
    const bool beyond = system.cover();
    system.contacts.guard(true);
    Values way(system.whole());
    for (std::size_t k = 0; k < way.size(); ++k) way[k] = system.x[k] - x[k];
    if (system.contacts.free_way(x.data(), way.data(), any_gap, memory) < 1.0) return false;
    double residual = counts.residual;
    if (beyond || system.contacts.guard_matters()) {
      const Values g = system.residual();
      residual = largest(g.data(), g.size());
    }
    return residual <= std::max(r_.force_tolerance * std::max(system.force_scale(), 1e-9), system.force_noise());
  }

  // Carry the derivatives over the step at whose end the system stands.
  void push(double dt, const Frames &frames, bool inertia) {
    const std::size_t whole = system.whole(), width = r_.columns;
    system.assemble(true, nullptr);
    if (!system.factorise(true)) {
      system.factorise(false);  // need not be definite where motion holds it
    }
    Values held(whole * width, 0.0), d_base(whole * width), d_v_base(whole * width);
    move(frames, held);
    for (std::size_t k = 0; k < whole * width; ++k) {
      d_base[k] = has_past ? step_.now * d_x[k] + step_.before * d_x_past[k] : d_x[k];
      d_v_base[k] = has_past ? step_.now * d_v[k] + step_.before * d_v_past[k] : d_v[k];
    }
    std::fill(d_force_.begin(), d_force_.end(), 0.0);
    add_inertia(d_base, d_v_base, inertia);
    system.triangles.add_columns(system.x.data(), d_force_.data());
    system.hinges.add_columns(system.x.data(), d_force_.data());
    system.tetrahedra.add_columns(system.x.data(), d_force_.data());
    system.contacts.add_columns(x.data(), system.x.data(), d_x.data(), held.data(), d_turned_.data(), memory, d_force_.data());
    Values total = d_force_, moved(system.count() * width);
    system.hessian.multiply(held.data(), total.data(), int(width));
    for (int k = 0; k < system.count(); ++k)
      std::copy_n(&total[width * system.own[k]], width, &moved[width * k]);
    system.factor.solve(moved.data(), int(width));
    Values there = std::move(held);  // from here on the derivative of all positions
    for (int k = 0; k < system.count(); ++k)
      for (std::size_t c = 0; c < width; ++c) there[width * system.own[k] + c] = -moved[width * k + c];
    system.hessian.multiply(there.data(), d_force_.data(), int(width));
    system.contacts.end_columns(x.data(), system.x.data(), d_x.data(), there.data(), dt, d_turned_.data(), memory,
                                d_moment_.data(), d_force_.data());
    system.triangles.keep_slopes(system.x.data(), there.data());
    system.hinges.keep_slopes(system.x.data(), there.data());
    system.tetrahedra.keep_slopes(system.x.data(), there.data());
    d_x_past.swap(d_x);
    d_v_past.swap(d_v);
    for (std::size_t k = 0; k < whole * width; ++k) d_v[k] = inertia ? (there[k] - d_base[k]) / step_.tau : 0.0;
    d_x.swap(there);
  }

  // Motions of followers and turns of rigid bodies by the parameters.
  void move(const Frames &frames, Values &held) {
    std::fill(d_turned_.begin(), d_turned_.end(), 0.0);
    if (!frames.motions) return;
    const std::size_t width = r_.columns;
    for (int f = 0; f < r_.followers; ++f) {
      const double *turn = frames.places + 12 * r_.follower_mount[f] + 3, *y = r_.follower_local + 3 * f;
      const double *m = frames.motions + 6 * width * r_.follower_mount[f];
      for (std::size_t c = 0; c < width; ++c) {
        const Vec3 shift = {{m[c], m[width + c], m[2 * width + c]}};
        const Vec3 spin = {{m[3 * width + c], m[4 * width + c], m[5 * width + c]}};
        const Vec3 there = matmul(rotation_of(turn), Vec3(shift + spin.cross(Vec3{{y[0], y[1], y[2]}})));
        for (int i = 0; i < 3; ++i)
          if (r_.follower_axes[3 * f + i] && r_.prescribed[3 * r_.follower_node[f] + i])
            held[(3 * r_.follower_node[f] + i) * width + c] = there[i];
      }
    }
    for (int b = 0; b < r_.contacts; ++b) {
      const double *m = frames.motions + 6 * width * r_.body_mount[b];
      const Mat3 turn = rotation_of(frames.places + 12 * r_.body_mount[b] + 3), own = rotation_of(r_.body_rotation + 9 * b);
      for (std::size_t c = 0; c < width; ++c) {
        const double p = m[3 * width + c], q = m[4 * width + c], s = m[5 * width + c];
        const Mat3 cross = {{0.0, -s, q, s, 0.0, -p, -q, p, 0.0}};
        const Mat3 by = matmul(matmul(turn, cross), own);
        for (int k = 0; k < 9; ++k) d_turned_[(9 * b + k) * width + c] = by[k];
      }
    }
  }

  // What inertia, damping by mass and loads change by, into d_force_.
  void add_inertia(const Values &d_base, const Values &d_v_base, bool inertia) {
    const std::size_t width = r_.columns;
    const double tau = step_.tau, factor = inertia ? 1.0 / (tau * tau) : 0.0;
    for (std::size_t k = 0; k < d_force_.size(); ++k) d_force_[k] -= r_.d_external[k];
    const int entries = r_.mass_start[r_.nodes];
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double pull = -factor * r_.mass[k], rub = -r_.mass_damping[k] / tau;
        for (int a = 0; a < 3; ++a) {
          double *to = &d_force_[(3 * i + a) * width];
          const double *by = &d_base[(3 * j + a) * width], *by_v = &d_v_base[(3 * j + a) * width];
          for (std::size_t c = 0; c < width; ++c) to[c] += (pull + rub) * by[c] + pull * tau * by_v[c];
          const double since = system.x[3 * j + a] - step_.x_base[3 * j + a];
          const double accelerated = factor * (since - tau * step_.v_base[3 * j + a]);
          for (int m = 0; m < r_.mass_blocks; ++m)
            to[r_.mass_of[m]] += r_.d_mass[m * entries + k] * accelerated + r_.d_mass_damping[m * entries + k] * since / tau;
        }
      }
  }

  Record r_;
  Step step_;
  Values v_, turned_, d_turned_, targets_, d_force_, d_moment_, moment_;

 public:
  System system;
  Values x, x_past, v_past, d_x, d_v, d_x_past, d_v_past;
  Memory memory;
  double dt_past = 0.0;
  bool has_past = false;
  Values &velocity() { return v_; }
};

}  // namespace thinshell
