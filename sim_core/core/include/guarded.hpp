// The guarded Newton of a step with contact: every move is free of touch and goes down in energy.
//
// As `_guarded` of sim_core/solve/contact_newton.py, which says what is done and whose numbers these are.
#pragma once

#include "tangent.hpp"

namespace thinshell {

template <class System> class GuardedNewton {
 public:
  using Values = typename System::Values;
  using Memory = typename System::Memory;

  // From `x_start` to the `targets` of what is prescribed, both (nodes, 3).
  GuardedNewton(System &system, const Record &record, const Values &x_start, const Values &targets,
                const Memory &memory, StepCounts &counts)
      : s_(system), r_(record), memory_(memory), start_(x_start), base_(system.stripped(x_start)),
        whole_(system.prescribed_move(x_start, targets)), tangent_(system), counts_(counts) {}

  // Whether it converged. `moved`: the system is where the prescribed motion is made already.
  THINSHELL_APART bool run(bool moved) {
    const double length = largest(whole_);
    left_ = 0.0;
    if (!moved) {
      left_ = length > no_motion || s_.contacts.turns(memory_) ? 1.0 : 0.0;
      s_.put(start_);
      s_.hold(base_.data());
    }
    s_.contacts.guard(true);
    s_.contacts.turn(1.0 - left_, memory_);
    const int64_t most = longer * r_.slow_iterations;
    double update = infinity();
    bool moving = true;
    int relaxed = 0, stuck = 0;
    for (int64_t k = 0; k < most; ++k) {
      ++counts_.iterations;
      const Values g = s_.residual();
      counts_.residual = largest(g);
      counts_.update = update;
      if (!is_finite(counts_.residual)) return fails(not_finite);
      if (left_ == 0.0 && balanced(s_, r_, update, counts_.residual)) return true;
      Values move, direction;
      if (left_ > 0.0 && moving) {
        move = whole_;
        scale(move, left_);
      }
      if (!tangent_.renew(g, move, nullptr, counts_, direction)) return fails(not_factorised);
      update = largest(direction);
      Values step = s_.spread(direction);
      if (!move.empty()) add_scaled(step, 1.0, move);
      bool touched;
      const double share = way(direction, step, !move.empty(), touched);
      const Values unknowns = s_.unknowns();
      if (!move.empty()) {
        stuck = touched && left_ * share < shortest ? stuck + 1 : 0;
        if (stuck == patience) return fails(blocked);
        left_ = share == 1.0 ? 0.0 : left_ * (1.0 - share);
        advance(unknowns, share, direction, left_);
        moving = share > 0.5;
        relaxed = 0;
        continue;
      }
      int tries;
      const bool accepted = descend(unknowns, direction, share, dot(g, direction), tries);
      counts_.tries += tries;
      if (accepted && share == 1.0 && tries == 1 && !tangent_.definite()) further(unknowns);
      if (!accepted) return (update < r_.step_tolerance && left_ == 0.0) || fails(no_lower_energy);
      if (left_ == 0.0 && update < round_off * r_.step_tolerance) {
        const Values last = s_.residual();
        counts_.residual = largest(last);
        return true;
      }
      ++relaxed;
      moving = moving || relaxed == relaxations || update < min(1e-2 * left_ * length, keep * s_.contacts.gap());
    }
    return fails(iteration_limit);
  }

  // Share of the prescribed motion that is not made.
  double left() const { return left_; }

 private:
  static constexpr double keep = 0.1, farthest = 5e-3, shortest = 1e-4, no_motion = 1e-15, round_off = 1e-3;
  static constexpr int relaxations = 6, patience = 3, doublings = 6, longer = 4, halvings = 39;

  bool fails(Failure why) {
    counts_.failure = why;
    return false;
  }

  // Go a share of the way from the unknowns `from`, where all but the part `left` of the prescribed motion is made.
  THINSHELL_APART void advance(const Values &from, double share, const Values &direction, double left) {
    s_.contacts.turn(1.0 - left, memory_);
    Values held = base_;
    add_scaled(held, 1.0 - left, whole_);
    s_.hold(held.data());
    s_.go(from, share, direction);
  }

  // Share of a move that is free, and whether contact ends it. The system stays where it is.
  THINSHELL_APART double way(const Values &direction, const Values &step, bool moving, bool &touched) {
    const Values here = s_.x, unknowns = s_.unknowns();
    const double share = min(1.0, farthest / max(largest(step), 1e-300));
    const double then = moving ? left_ * (1.0 - share) : left_;
    advance(unknowns, share, direction, then);
    s_.cover();
    advance(unknowns, 0.0, direction, left_);
    s_.put(here);
    Values part = step;
    scale(part, share);
    const double free = s_.contacts.free_way(here, part, keep, 1.0 - left_, 1.0 - then, memory_);
    touched = free < 1.0;
    return share * free;
  }

  // Halve the move until the energy falls; whether it did, and after how many trials.
  THINSHELL_APART bool descend(const Values &from, const Values &direction, double share, double descent, int &tries) {
    const double energy = s_.energy(), noise = 1e-13 * (abs(energy) + abs(descent)) + 1e-30;
    const Values here = s_.x;
    for (tries = 1; tries <= halvings; ++tries) {
      const double enough = energy + 1e-4 * share * descent + noise;
      s_.go(from, share, direction);
      if (s_.straighten(here)) {
        if (s_.energy() <= enough && is_free(here) && s_.energy() <= enough) return true;
        s_.go(from, share, direction);
      }
      if (s_.energy() <= enough) return true;
      share *= 0.5;
    }
    s_.go(from, 0.0, direction);
    return false;
  }

  // Whether the straight way from `here` to where the system is is free of touch.
  THINSHELL_APART bool is_free(const Values &here) {
    s_.cover();
    Values way = s_.x;
    add_scaled(way, -1.0, here);
    return s_.contacts.free_way(here, way, keep, 1.0 - left_, 1.0 - left_, memory_) == 1.0;
  }

  // Double the move from the unknowns `from` while nothing touches and the energy falls: the projected matrix is too stiff
  // along what is unstable.
  THINSHELL_APART void further(const Values &from) {
    double energy = s_.energy();
    for (int k = 0; k < doublings; ++k) {
      ++counts_.tries;
      const Values there = s_.unknowns();
      Values onward = there;
      add_scaled(onward, -1.0, from);
      bool touched;
      if (way(onward, s_.spread(onward), false, touched) < 1.0) return;
      s_.go(there, 1.0, onward);
      const double found = s_.energy();
      if (!(found < energy)) {
        s_.go(there, 0.0, onward);
        return;
      }
      energy = found;
    }
  }

  System &s_;
  const Record &r_;
  const Memory &memory_;
  Values start_, base_, whole_;  // where the step starts, with mounts as they give way and without; the prescribed motion
  double left_ = 0.0;
  Tangent<System> tangent_;
  StepCounts &counts_;
};

}  // namespace thinshell
