// One rollout in a thread block: its start, and one step after the other, in halves, quarters and so on where the searches
// give up; as Rollout of sim_core/core/include/rollout.hpp, without derivatives, with the same Search.
#pragma once

#include "block_system.hpp"
#include "search.hpp"

namespace thinshell {

// State of one rollout in global memory.
struct BlockState {
  double *x, *v, *x_past, *v_past;  // (nodes, 3) each
  BlockMemory memory;
  double *dt_past;  // [s]; 0: there is no state before
};

class BlockRollout {
 public:
  // `places`: room for where mounts are, (mounts, 12), and rotations of bodies, (contacts, 9).
  BlockRollout(Arena &arena, const Record &record, const Plan &plan, const Rooms &rooms, double *window, double *panel,
               double *area, double *places, const BlockState &state)
      : system(arena, record, plan, rooms, window, panel, area), arena_(arena), team_(arena.team), r_(record), state_(state),
        places_(places), turned_(places + 12 * record.mounts), x_(system.vector()), v_(system.vector()),
        v_past_(system.vector()), targets_(arena, system.whole(), 0.0), tangent_(system), dt_past_(*state.dt_past) {
    copy(state.x, x_);
    copy(state.v, v_);
    copy(state.v_past, v_past_);
    team_.sync();
    system.contacts.guard(true);
  }

  BlockSystem system;

  // Come to rest where mounts are at `places`, as sim_core.core.rollout.CoreRollout.settle does; false where there is no rest.
  bool settle(const double *places, double longest, double forever) {
    team_.each(9 * int(r_.contacts), [&](int k) { turned_rotation(places, k, state_.memory.rotation); });
    double dt = 1e-3;
    StepCounts counts{};
    while (dt < longest) {
      rest();
      if (step(dt, places, true, counts)) {
        end(dt, true);
        dt *= 3.0;
      } else if (dt > 1e-6) {
        dt /= 4.0;
      } else {
        return false;
      }
    }
    rest();
    if (!step(forever, places, false, counts)) return false;
    end(forever, false);
    rest();
    return true;
  }

  // A step from where the mounts are at `from` to `to`, in as many parts as it takes; whether all of it was made.
  bool advance(double dt, const double *from, const double *to, bool inertia, StepCounts &counts) {
    int64_t part = finest;
    while (counts.made < finest) {
      const double share = double(part) / finest, reached = double(counts.made) / finest + share;
      const double *there = to;
      if (reached != 1.0) {
        team_.each(int(r_.mounts), [&](int m) {
          const double *a = from + 12 * m, *b = to + 12 * m;
          for (int k = 0; k < 3; ++k) places_[12 * m + k] = (1.0 - reached) * a[k] + reached * b[k];
          turn_between(a + 3, b + 3, reached, places_ + 12 * m + 3);
        });
        there = places_;
      }
      if (!step(share * dt, there, inertia, counts)) {
        if (part == 1 || system.exhausted()) return false;
        part /= 2;
        continue;
      }
      end(share * dt, inertia);
      ++counts.parts;
      counts.made += part;
      while (part < finest && counts.made % (2 * part) == 0) part *= 2;
    }
    return true;
  }

  // Leave the state for another call.
  void leave() {
    copy(x_, state_.x);
    copy(v_, state_.v);
    copy(v_past_, state_.v_past);
    team_.each(1, [&](int) { *state_.dt_past = dt_past_; });
  }

  // Positions [m] and forces [N] (nodes, 3), moments [N m] (contacts, 3) at the end of the step.
  void write(double *x, double *force, double *moment) {
    const double *at = system.x.data(), *gradient = system.gradient.data();
    team_.each(system.whole(), [&](int k) {
      x[k] = at[k];
      force[k] = -gradient[k];
    });
    system.contacts.moments(at, moment);
  }

 private:
  using Values = BlockValues;
  static constexpr int64_t finest = 32;  // parts of a step, at most

  THINSHELL_APART void copy(const double *from, Values &to) {
    double *there = to.data();
    team_.each(system.whole(), [&](int k) { there[k] = from[k]; });
  }
  THINSHELL_APART void copy(const Values &from, double *to) {
    const double *here = from.data();
    team_.each(system.whole(), [&](int k) { to[k] = here[k]; });
  }

  THINSHELL_APART void rest() {
    double *v = v_.data();
    team_.each(system.whole(), [&](int k) { v[k] = 0.0; });
    dt_past_ = 0.0;
  }

  void turned_rotation(const double *places, int k, double *out) const {
    const int c = k / 9;
    out[k] = matmul(rotation_of(places + 12 * r_.body_mount[c] + 3), rotation_of(r_.body_rotation + 9 * c))[k % 9];
  }
  // Where followers and rigid bodies are when the mounts are at `places`.
  THINSHELL_APART void place(const double *places) {
    double *targets = targets_.data();
    team_.each(int(r_.followers), [&](int f) {
      const double *at = places + 12 * r_.follower_mount[f], *local = r_.follower_local + 3 * f;
      for (int i = 0; i < 3; ++i)
        if (r_.follower_axes[3 * f + i])
          targets[3 * r_.follower_node[f] + i] =
              at[i] + at[3 + 3 * i] * local[0] + at[4 + 3 * i] * local[1] + at[5 + 3 * i] * local[2];
    });
    team_.each(9 * int(r_.contacts), [&](int k) { turned_rotation(places, k, turned_); });
  }

  THINSHELL_APART bool step(double dt, const double *places, bool inertia, StepCounts &counts) {
    place(places);
    const bool has_past = dt_past_ != 0.0;
    const double r = has_past ? dt / dt_past_ : 0.0;
    const BlockStep now{dt, dt * (1.0 + r) / (1.0 + 2.0 * r), (1.0 + r) * (1.0 + r) / (1.0 + 2.0 * r), -r * r / (1.0 + 2.0 * r)};
    system.put(x_);
    system.hold(targets_.data());
    system.begin(now, x_, v_, has_past ? state_.x_past : nullptr, v_past_.data(), turned_, state_.memory, inertia);
    const int64_t residuals = system.residuals;
    const Start<BlockSystem> start{x_, v_, v_past_, targets_, state_.memory, dt, dt_past_, has_past};
    const bool found = Search<BlockSystem>(system, r_, start, tangent_, counts).run(Values(), inertia);
    system.contacts.guard(true);
    counts.residuals += system.residuals - residuals;
    if (system.contacts.any()) system.contacts.report(counts);
    return found && !system.exhausted();
  }

  // Take the step: from where the system stands at its end to the next state.
  THINSHELL_APART void end(double dt, bool inertia) {
    if (system.contacts.any()) system.contacts.end(system.x.data(), dt, state_.memory);
    copy(x_, state_.x_past);
    v_past_ = v_;
    x_ = system.x;
    system.velocities(v_.data(), inertia);
    dt_past_ = inertia && r_.second_order ? dt : 0.0;
  }

  Arena &arena_;
  const Team &team_;
  const Record &r_;
  BlockState state_;
  double *places_, *turned_;
  Values x_, v_, v_past_, targets_;
  Tangent<BlockSystem> tangent_;  // of the step before
  double dt_past_;
};

}  // namespace thinshell
