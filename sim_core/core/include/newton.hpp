// The fast Newton of a step: full steps that look ahead, few tangents, and steps into contact made in part.
//
// As sim_core/solve/mixed_integration_point_newton.py, tangent.py and contact_step_limit.py, which say what is done and
// by whom it was published; the numbers are theirs.
#pragma once

#include "tangent.hpp"

namespace thinshell {

template <class System> class FastNewton {
 public:
  using Values = typename System::Values;

  // `move`: of what is prescribed (nodes, 3), still to be made on the way to `targets`; empty: none. `near`: the search
  // begins so near the solution that the tangent there tells whether that is stable.
  // `tangent`: of the step before, from which the search begins where it serves. Sheets and
  // stiff bodies that turn would stretch by it.
  FastNewton(System &system, const Record &record, const double *targets, const Values &move, bool inertia,
             bool near, Tangent<System> &tangent, StepCounts &counts)
      : s_(system), r_(record), targets_(targets), move_(move), inertia_(inertia), near_(near),
        has_tangent_(!record.triangles && !record.bodies && tangent.serves()), tangent_(tangent), counts_(counts) {}

  // Whether it converged, with the true Hessian as its last tangent.
  THINSHELL_APART bool run() {
    while (true) {
      ++counts_.iterations;
      const Values g = s_.residual();
      const double residual = largest(g);
      counts_.residual = residual;
      counts_.update = update_;
      if (!is_finite(residual)) return false;
      if (verdict(residual)) return has_tangent_ && tangent_.definite();
      if (!advance(g)) return false;
    }
  }

 private:
  static constexpr int patience = 5;
  static constexpr double keep = 0.5, slowest = 0.1, sure = 0.02, least = 0.3, round_off = 1e-3;

  bool verdict(double residual) {
    if (!move_.empty()) return false;
    const bool floor = !old_ && !moved_ && error_ < round_off * r_.step_tolerance;
    if (!floor && !balanced(s_, r_, error_, residual)) return false;
    if (old_ && !inertia_ && !(near_ && tangents_ == 1)) {
      has_tangent_ = false;  // a static solution may be unstable: one step with its own tangent tells
      return false;
    }
    return true;
  }

  THINSHELL_APART bool advance(const Values &g) {
    Values direction;
    if (has_tangent_ && full_.empty()) {  // the first step
      old_ = true;
      direction = tangent_.direct(g, move_);
      if (is_finite(largest(direction))) {
        go(direction, g, true);
        return true;
      }
    }
    old_ = has_tangent_ && !full_.empty() && kept(g, direction);
    if (!old_) {
      if (tangents_ >= (r_.fast_iterations < best_at_ + patience ? r_.fast_iterations : best_at_ + patience)) return false;
      has_tangent_ = false;
      ++tangents_;
      const double *foreseen = foreseen_.empty() ? nullptr : foreseen_.data();
      if (!tangent_.renew(g, move_, foreseen, counts_, direction)) return false;
      has_tangent_ = true;
      error_ = largest(direction);
      if (error_ < best_) {
        best_ = error_;
        best_at_ = tangents_;
      }
    }
    go(direction, g, !old_);
    return true;
  }

  THINSHELL_APART bool kept(const Values &g, Values &direction) {
    direction = tangent_.learn(full_, step_, g);
    const double length = largest(direction);
    if (!(length < keep * update_)) return false;
    const double rate = max(length / update_, slowest);
    error_ = length * rate / (1.0 - rate) / sure;
    return true;
  }

  // Make the step, or, `partly`, the part of it that contact lets through.
  THINSHELL_APART void go(const Values &direction, const Values &g, bool partly) {
    const Values start = s_.unknowns();
    const Values placed = s_.stripped(s_.x);
    auto at = [&](double share) {
      if (!move_.empty()) {
        if (share == 1.0) {
          s_.hold(targets_);
        } else {
          Values there = placed;
          add_scaled(there, share, move_);
          s_.hold(there.data());
        }
      }
      s_.go(start, share, direction);
    };
    double share = 1.0;
    if (s_.contacts.any() && partly) {
      share = contact_share([&](double a) { at(a); return s_.contact_along(direction); }, dot(g, direction));
      if (!move_.empty()) share = max(share, least);
    }
    at(share);
    full_ = direction;
    step_ = direction;
    scale(step_, share);
    update_ = share * largest(direction);
    if (share < 1.0) error_ = max(error_, (1.0 - share) / share * update_);
    foreseen_ = s_.spread(step_);
    moved_ = !move_.empty();
    if (!moved_) return;
    add_scaled(foreseen_, share, move_);
    if (share == 1.0) {
      move_.clear();
    } else {
      scale(move_, 1.0 - share);
      has_tangent_ = false;
    }
  }

  // Share of a step at which the residual along it, with everything but contact as foreseen, has no more to say.
  template <class Along> double contact_share(Along &&along, double before) {
    constexpr int most = 12;
    constexpr double apart = 1e-3, keeps = 0.3;
    const double enough = keeps * abs(before);
    const double start = along(0.0), close = along(apart), end = along(1.0);
    counts_.tries += 3;
    if (end - start <= enough) return 1.0;
    const double slope = (close - start) / apart;
    auto phi = [&](double share, double found) { return (1.0 - share) * before + found - start - share * slope; };
    double share = 1.0, value = phi(1.0, end), low = 0.0, at_low = before, high = 1.0, at_high = value;
    int tries = 0, side = 0;
    while (tries < most && !(value <= enough && (tries == 0 || value >= -enough))) {
      share = (low * at_high - high * at_low) / (at_high - at_low);
      share = min(max(share, 0.7 * low + 0.3 * high), 0.3 * low + 0.7 * high);
      value = phi(share, along(share));
      ++tries;
      if (value > 0.0) {
        at_low = side <= 0 ? at_low : 0.5 * at_low;
        high = share;
        at_high = value;
        side = 1;
      } else {
        at_high = side >= 0 ? at_high : 0.5 * at_high;
        low = share;
        at_low = value;
        side = -1;
      }
    }
    counts_.tries += tries;
    return share;
  }

  System &s_;
  const Record &r_;
  const double *targets_;
  Values move_, full_, step_, foreseen_;
  bool inertia_, near_, has_tangent_, old_ = false, moved_ = false;  // moved_: what is prescribed, in the last step
  Tangent<System> &tangent_;
  int64_t tangents_ = 0, best_at_ = 0;
  double best_ = infinity(), update_ = best_, error_ = best_;
  StepCounts &counts_;
};

}  // namespace thinshell
