// The fast Newton of a step: full steps that look ahead, few tangents, and steps into contact made in part.
//
// As sim_core/solve/mixed_integration_point_newton.py, tangent.py and contact_step_limit.py, which say what is done and
// by whom it was published; the numbers are theirs.
#pragma once

#include <cmath>
#include <limits>
#include <vector>

#include "system.hpp"

namespace thinshell {

using Values = std::vector<double>;

inline double dot(const Values &a, const Values &b) {
  double out = 0.0;
#pragma omp simd reduction(+ : out)
  for (std::size_t k = 0; k < a.size(); ++k) out += a[k] * b[k];
  return out;
}

// What was learned since a tangent was factorised (Broyden).
class Learned {
 public:
  void clear() { corrections_.clear(); }

  Values answer(const System &system, const Values &residual) const {
    Values moved = residual;
    system.factor.solve(moved.data());
    for (const auto &[change, step] : corrections_) {
      const double along = dot(step, moved);
      for (std::size_t k = 0; k < moved.size(); ++k) moved[k] += change[k] * along;
    }
    for (double &m : moved) m = -m;
    return moved;
  }

  Values learn(const System &system, const Values &full, const Values &step, const Values &residual) {
    Values answered = answer(system, residual), change(full.size());
    for (std::size_t k = 0; k < full.size(); ++k) change[k] = full[k] - answered[k];
    const double along = dot(step, change);
    if (along > 1e-12 * dot(step, step)) {
      for (std::size_t k = 0; k < full.size(); ++k) change[k] = (step[k] - change[k]) / along;
      const double back = dot(step, answered);
      for (std::size_t k = 0; k < full.size(); ++k) answered[k] += change[k] * back;
      corrections_.emplace_back(std::move(change), step);
    }
    return answered;
  }

 private:
  std::vector<std::pair<Values, Values>> corrections_;
};

class FastNewton {
 public:
  // `move`: of what is prescribed (nodes, 3), still to be made on the way to `targets`; empty: none. `near`: the search
  // begins so near the solution that the tangent there tells whether that is stable.
  FastNewton(System &system, const Record &record, const double *targets, Values move, bool inertia, bool near,
             StepCounts &counts)
      : s_(system), r_(record), targets_(targets), move_(std::move(move)), inertia_(inertia), near_(near), counts_(counts) {}

  // Whether it converged, with the true Hessian as its last tangent.
  bool run() {
    while (true) {
      ++counts_.iterations;
      const Values g = s_.residual();
      const double residual = largest(g.data(), g.size());
      counts_.residual = residual;
      counts_.update = update_;
      if (!std::isfinite(residual)) return false;
      if (verdict(residual)) return has_tangent_ ? definite_ : false;
      if (!advance(g)) return false;
    }
  }

 private:
  static constexpr int patience = 5;
  static constexpr double keep = 0.5, slowest = 0.1, sure = 0.02, least = 0.3, round_off = 1e-3;

  bool converged(double error, double residual) const {
    if (!(error < r_.step_tolerance)) return false;
    return residual <= std::max(r_.force_tolerance * std::max(s_.force_scale(), 1e-9), s_.force_noise());
  }

  bool verdict(double residual) {
    if (!move_.empty()) return false;
    const bool floor = !old_ && error_ < round_off * r_.step_tolerance;
    if (!floor && !converged(error_, residual)) return false;
    if (old_ && !inertia_ && !(near_ && tangents_ == 1)) {
      has_tangent_ = false;  // a static solution may be unstable: one step with its own tangent tells
      return false;
    }
    return true;
  }

  bool advance(const Values &g) {
    Values direction;
    old_ = has_tangent_ && kept(g, direction);
    if (!old_) {
      if (tangents_ >= std::min<int64_t>(r_.fast_iterations, best_at_ + patience)) return false;
      has_tangent_ = false;
      ++tangents_;
      ++counts_.factorisations;
      if (!new_direction(g, direction)) return false;
      has_tangent_ = true;
      error_ = largest(direction.data(), direction.size());
      if (error_ < best_) {
        best_ = error_;
        best_at_ = tangents_;
      }
    }
    go(direction, g);
    return true;
  }

  bool kept(const Values &g, Values &direction) {
    direction = learned_.learn(s_, full_, step_, g);
    const double length = largest(direction.data(), direction.size());
    if (!(length < keep * update_)) return false;
    const double rate = std::max(length / update_, slowest);
    error_ = length * rate / (1.0 - rate) / sure;
    return true;
  }

  // From the true Hessian where it is positive definite, else from the semidefinite one, else from that with a shift.
  bool new_direction(const Values &g, Values &direction) {
    const double *foreseen = foreseen_.empty() ? nullptr : foreseen_.data();
    s_.assemble(true, foreseen);
    if (attempt(g, 0.0, true, direction)) return true;
    s_.assemble(false, foreseen);
    const double stiffest = s_.stiffest();
    double shift = 0.0;
    while (stiffest > 0.0 && shift <= 1e3 * stiffest) {
      if (attempt(g, shift, false, direction)) return true;
      shift = std::max(10.0 * shift, 1e-12 * stiffest);
    }
    return false;
  }

  bool attempt(const Values &g, double shift, bool definite, Values &direction) {
    if (!s_.factorise(true, shift)) return false;
    learned_.clear();
    definite_ = definite;
    Values rhs = g;
    if (!move_.empty()) {
      const Values more = s_.follow(move_);
      for (std::size_t k = 0; k < rhs.size(); ++k) rhs[k] += more[k];
    }
    direction = learned_.answer(s_, rhs);
    return std::isfinite(largest(direction.data(), direction.size()));
  }

  // Make the step, or the part of it that contact lets through; answers of kept tangents whole.
  void go(const Values &direction, const Values &g) {
    const Values start = s_.unknowns();
    Values placed = s_.x;
    auto at = [&](double share) {
      if (!move_.empty()) {
        if (share == 1.0) {
          s_.hold(targets_);
        } else {
          Values there = placed;
          for (std::size_t k = 0; k < there.size(); ++k) there[k] += share * move_[k];
          s_.hold(there.data());
        }
      }
      s_.go(start, share, direction);
    };
    double share = 1.0;
    if (s_.contacts.any() && !old_) {
      share = contact_share([&](double a) { at(a); return s_.contact_along(direction); }, dot(g, direction));
      if (!move_.empty()) share = std::max(share, least);
    }
    at(share);
    full_ = direction;
    step_ = direction;
    for (double &v : step_) v *= share;
    update_ = share * largest(direction.data(), direction.size());
    if (share < 1.0) error_ = std::max(error_, (1.0 - share) / share * update_);
    foreseen_ = s_.spread(step_);
    if (move_.empty()) return;
    for (std::size_t k = 0; k < move_.size(); ++k) foreseen_[k] += share * move_[k];
    if (share == 1.0) {
      move_.clear();
    } else {
      for (double &m : move_) m *= 1.0 - share;
      has_tangent_ = false;
    }
  }

  // Share of a step at which the residual along it, with everything but contact as foreseen, has no more to say.
  template <class Along> double contact_share(Along &&along, double before) {
    constexpr int most = 12;
    constexpr double apart = 1e-3, keeps = 0.3;
    const double enough = keeps * std::abs(before);
    const double start = along(0.0), close = along(apart), end = along(1.0);
    counts_.tries += 3;
    if (end - start <= enough) return 1.0;
    const double slope = (close - start) / apart;
    auto phi = [&](double share, double found) { return (1.0 - share) * before + found - start - share * slope; };
    double share = 1.0, value = phi(1.0, end), low = 0.0, at_low = before, high = 1.0, at_high = value;
    int tries = 0, side = 0;
    while (tries < most && !(value <= enough && (tries == 0 || value >= -enough))) {
      share = (low * at_high - high * at_low) / (at_high - at_low);
      share = std::min(std::max(share, 0.7 * low + 0.3 * high), 0.3 * low + 0.7 * high);
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
  bool inertia_, near_, old_ = false, has_tangent_ = false, definite_ = false;
  Learned learned_;
  int64_t tangents_ = 0, best_at_ = 0;
  double best_ = std::numeric_limits<double>::infinity(), update_ = best_, error_ = best_;
  StepCounts &counts_;
};

}  // namespace thinshell
