// Directions of descent: from a factorised tangent, and from one that is kept over several iterates.
//
// As sim_core/solve/tangent.py, which says what is done: with H the inverse so far, s a step and y the change of the
// residual over it (Broyden, Math. Comput. 19, 1965),
//
//     H <- H + (s - H y) s^T H / (s^T H y)
#pragma once

#include "record.hpp"
#include "small.hpp"

namespace thinshell {

// Change of an energy [J] that round-off may make.
THINSHELL_FN double noise_of(double energy) { return 1e-13 * abs(energy) + 1e-30; }

// Whether positions are good enough: `error` bounds what is wrong with them [m], `residual` is the largest free force [N].
template <class System>
THINSHELL_APART bool balanced(const System &system, const Record &record, double error, double residual) {
  if (!(error < record.step_tolerance)) return false;
  return residual <= max(record.force_tolerance * max(system.force_scale(), 1e-9), system.force_noise());
}

template <class System> class Tangent {
 public:
  using Values = typename System::Values;

  explicit Tangent(System &system) : s_(system) {}

  // Newton direction at the residual `g` from the true Hessian where it is positive definite, else from the semidefinite
  // one, else from that with a shift; false when nothing holds the system. `move`: of what is prescribed (nodes, 3),
  // followed to first order (empty: none); `foreseen`: see System::assemble.
  THINSHELL_APART bool renew(const Values &g, const Values &move, const double *foreseen, StepCounts &counts, Values &direction) {
    ++counts.factorisations;
    s_.assemble(true, foreseen);
    if (attempt(g, move, 0.0, true, direction)) return true;
    s_.assemble(false, foreseen);
    const double stiffest = s_.stiffest();
    double shift = 0.0;
    while (stiffest > 0.0 && shift <= 1e3 * stiffest) {
      if (attempt(g, move, shift, false, direction)) return true;
      shift = max(10.0 * shift, 1e-12 * stiffest);
    }
    return false;
  }

  // Take the Hessian that the system has factorised.
  void adopt(bool definite) {
    corrections_.clear();
    definite_ = definite;
    stamp_ = s_.stamp();
    pull_ = s_.pull();
  }
  void drop() { stamp_ = -1; }
  // Whether the system still has the factor, and steps as long as when it was made.
  bool serves() const { return stamp_ == s_.stamp() && abs(pull_ - s_.pull()) <= 1e-6 * pull_; }
  // Direction at the residual `g` from it, where what is prescribed moves as in `renew`.
  THINSHELL_APART Values direct(const Values &g, const Values &move) const {
    if (move.empty()) return answer(g);
    Values rhs = g;
    const Values more = s_.follow(move);
    add_scaled(rhs, 1.0, more);
    return answer(rhs);
  }

  // Whether the Hessian that was factorised last is the true one.
  bool definite() const { return definite_; }

  // Change of the unknowns [m] that brings a residual [N] to zero, to first order.
  THINSHELL_APART Values answer(const Values &residual) const {
    Values moved = residual;
    s_.solve(moved);
    for (int c = 0; c < corrections_.count(); ++c)
      add_scaled(moved, dot(corrections_.step(c), moved), corrections_.change(c));
    scale(moved, -1.0);
    return moved;
  }

  // Take in the residual after a `step`, part of the `full` answer that was given before it, and answer it.
  THINSHELL_APART Values learn(const Values &full, const Values &step, const Values &residual) {
    Values answered = answer(residual), change = full;
    add_scaled(change, -1.0, answered);
    const double along = dot(step, change);
    if (along > 1e-12 * dot(step, step)) {
      set_slope(change, step, change, along);
      add_scaled(answered, dot(step, answered), change);
      corrections_.push(change, step);
    }
    return answered;
  }

 private:
  THINSHELL_APART bool attempt(const Values &g, const Values &move, double shift, bool definite, Values &direction) {
    if (!s_.factorise(true, shift)) return false;
    adopt(definite);
    direction = direct(g, move);
    return is_finite(largest(direction));
  }

  System &s_;
  bool definite_ = false;
  int64_t stamp_ = -1;
  double pull_ = 0.0;
  typename System::Corrections corrections_;
};

}  // namespace thinshell
