// The search for the end of a step: the fast Newton from one place after the other, then searches that go down in energy.
//
// As sim_core/solve/contact_newton.py and newton.py, whose numbers these are. Of a CPU and of a thread block alike: all that
// it does to vectors and forces it asks its `System` for.
#pragma once

#include "guarded.hpp"
#include "newton.hpp"
#include "slow.hpp"

namespace thinshell {

// Where a step of `dt` [s] starts, and where it lets go of what is prescribed; `v_past`: velocities `dt_past` before that,
// where `has_past`.
template <class System> struct Start {
  const typename System::Values &x, &v, &v_past, &targets;
  const typename System::Memory &memory;
  double dt, dt_past;
  bool has_past;
};

template <class System> class Search {
 public:
  using Values = typename System::Values;

  // `tangent`: of the step before.
  Search(System &system, const Record &record, const Start<System> &start, Tangent<System> &tangent, StepCounts &counts)
      : s_(system), r_(record), start_(start), tangent_(tangent), counts_(counts) {}

  // Whether the system stands at the end of the step. `guess`: where to begin; empty: nowhere.
  THINSHELL_APART bool run(const Values &guess, bool inertia) {
    const bool fast = r_.fast_iterations > 0;
    if (fast && !guess.empty() && attempt(guess, true, inertia) == Attempt::good) return true;
    bool sound = false;
    if (fast) {
      if (inertia) {
        Values drift = start_.v;
        scale(drift, start_.dt);
        if (start_.has_past) {
          Values faster = start_.v;
          add_scaled(faster, -1.0, start_.v_past);  // first, for what cancels
          add_scaled(drift, 0.5 * start_.dt * start_.dt / start_.dt_past, faster);
        }
        if (largest(drift) > 0.0) {
          add_scaled(drift, 1.0, start_.x);
          if (!runs_into(drift)) {
            const Attempt found = attempt(drift, false, inertia);
            if (found == Attempt::good) return true;
            sound = found == Attempt::sound;
          }
        }
      }
      if (!sound) {
        const Attempt found = attempt(start_.x, false, inertia);
        if (found == Attempt::good) return true;
        sound = found == Attempt::sound;
      }
    }
    return s_.contacts.any() ? guarded(sound, inertia) : freely(fast, inertia);
  }

 private:
  static constexpr double harder = 3.0, any_gap = 1e-6;

  enum class Attempt { lost, sound, good };

  // What the fast Newton gave up, with contact. `sound`: it came to where the system can go freely, out of balance.
  THINSHELL_APART bool guarded(bool sound, bool inertia) {
    GuardedNewton<System> newton(s_, r_, start_.x, start_.targets, start_.memory, counts_);
    if (newton.run(sound)) return true;
    if (newton.left() > 0.0 || inertia) return false;
    const Values kept = s_.x;
    s_.contacts.guard(false);
    counts_.failure = iteration_limit;
    if (!creep(s_, r_, start_.targets, counts_)) return false;
    bool beyond;
    return reached(kept, beyond) && holds(true);
  }

  // What the fast Newton gave up, without contact: from the lower energy.
  THINSHELL_APART bool freely(bool fast, bool inertia) {
    s_.hold(start_.targets.data());
    if (fast) {
      const Values there = s_.x;
      const double found = s_.energy();
      s_.put(start_.x);
      s_.hold(start_.targets.data());
      if (is_finite(found) && found < s_.energy()) s_.put(there);
      if (!inertia && creep(s_, r_, start_.targets, counts_)) return true;
    } else {
      s_.put(start_.x);
      s_.hold(start_.targets.data());
    }
    return slow_newton(s_, r_, counts_);
  }

  // Whether contact would be loaded far more where velocities lead than it is: no place to search from.
  THINSHELL_APART bool runs_into(const Values &there) {
    if (!s_.contacts.any()) return false;
    s_.contacts.guard(false);
    s_.put(there);
    s_.hold(start_.targets.data());
    const double load = s_.contact_load();
    if (load <= harder * s_.largest_load()) return false;
    s_.put(start_.x);
    return load > harder * s_.contact_load();
  }

  // The fast Newton from `where`. `sound`: what it found can be reached freely, but is not in balance.
  THINSHELL_APART Attempt attempt(const Values &where, bool near, bool inertia) {
    const bool touches = s_.contacts.any();
    if (touches) s_.contacts.guard(false);
    s_.put(near ? where : start_.x);
    s_.hold(start_.targets.data());
    const double energy = s_.energy();
    Values move;
    s_.put(where);
    if (!near) {
      move = s_.prescribed_move(where, start_.targets);
      if (largest(move) < r_.step_tolerance) move.clear();
    }
    if (move.empty()) s_.hold(start_.targets.data());
    FastNewton<System> newton(s_, r_, start_.targets.data(), move, inertia, near, tangent_, counts_);
    if (!newton.run()) return Attempt::lost;
    if (!(s_.energy() <= energy + noise_of(energy))) return Attempt::lost;
    if (s_.turns_over(start_.x)) return Attempt::lost;
    if (!touches) return Attempt::good;
    bool beyond;
    if (!reached(start_.x, beyond)) return Attempt::lost;
    return holds(beyond) ? Attempt::good : Attempt::sound;
  }

  // Whether the straight path from `from` to where the system is is free. `beyond`: contact was looked for again.
  THINSHELL_APART bool reached(const Values &from, bool &beyond) {
    beyond = s_.cover();
    s_.contacts.guard(true);
    Values way = s_.x;
    add_scaled(way, -1.0, from);
    return s_.contacts.free_way(from, way, any_gap, 0.0, 1.0, start_.memory) == 1.0;
  }

  // Whether the forces of the contact law itself balance. `anew`: those that were found last are of another one.
  THINSHELL_APART bool holds(bool anew) {
    double residual = counts_.residual;
    if (anew || s_.contacts.guard_matters()) residual = largest(s_.residual());
    return balanced(s_, r_, 0.0, residual);
  }

  System &s_;
  const Record &r_;
  const Start<System> &start_;
  Tangent<System> &tangent_;
  StepCounts &counts_;
};

}  // namespace thinshell
