// Searches that go down in energy: Newton with backtracking, and the creep of a static system to its next balance.
//
// As `_slow` and `creep` of sim_core/solve/newton.py and `shorten` of line_search.py, whose numbers these are.
#pragma once

#include "newton.hpp"

namespace thinshell {

// Where a step along `direction` from the unknowns `from` overshoots: up to where the residual along it has no more to say
// (Matthies & Strang, Int. J. Numer. Meth. Eng. 14, 1979). `before`, `after`: the residual along it at its start and end.
// Returns the share of it at which the system is left, 1 without a try.
template <class System>
THINSHELL_APART double shorten(System &s, const typename System::Values &from, const typename System::Values &step, double before, double after, int &tries) {
  constexpr double keeps = 0.3;
  constexpr int most = 4;
  double low = 0.0, high = 1.0, at_low = before, at_high = after, share = 1.0, along = after;
  const double enough = keeps * abs(before);
  for (tries = 0; tries < most && (along > enough || (tries && along < -enough)); ++tries) {
    share = (low * at_high - high * at_low) / (at_high - at_low);
    share = min(max(share, 0.9 * low + 0.1 * high), 0.1 * low + 0.9 * high);
    s.go(from, share, step);
    along = dot(s.residual(), step);
    if (along > 0.0) {
      high = share;
      at_high = along;
    } else {
      low = share;
      at_low = along;
    }
  }
  return share;
}

// Newton with backtracking on the potential; whether it converged.
template <class System> THINSHELL_APART bool slow_newton(System &s, const Record &r, StepCounts &counts) {
  using Values = typename System::Values;
  constexpr double round_off = 1e-3;
  Tangent<System> tangent(s);
  auto fails = [&](Failure why) {
    counts.failure = why;
    return false;
  };
  double energy = s.energy(), update = infinity();
  for (int64_t k = 0; k < r.slow_iterations; ++k) {
    ++counts.iterations;
    const Values g = s.residual();
    counts.residual = largest(g);
    counts.update = update;
    if (!is_finite(counts.residual) || !is_finite(energy)) return fails(not_finite);
    if (balanced(s, r, update, counts.residual)) return true;
    Values direction;
    if (!tangent.renew(g, Values(), nullptr, counts, direction)) return fails(not_factorised);
    update = largest(direction);
    const double descent = dot(g, direction), noise = 1e-13 * (abs(energy) + abs(descent)) + 1e-30;
    const Values start = s.unknowns();
    double share = 1.0, trial = energy;
    bool accepted = false;
    while (share > 1e-8) {
      ++counts.tries;
      s.go(start, share, direction);
      trial = s.energy();
      if ((accepted = trial <= energy + 1e-4 * share * descent + noise)) break;
      share *= 0.5;
    }
    if (!accepted) {
      s.go(start, 0.0, direction);
      return update < r.step_tolerance || fails(no_lower_energy);
    }
    while (!tangent.definite() && 1.0 <= share && share < 64.0) {  // too stiff along what is unstable: on while that pays
      ++counts.tries;
      s.go(start, 2.0 * share, direction);
      const double further = s.energy();
      if (!(further < trial)) {
        s.go(start, share, direction);
        break;
      }
      share *= 2.0;
      trial = further;
    }
    if (share <= 1.0) {  // the energy may go down and up again: contact that opens and closes in turn
      Values step = direction;
      scale(step, share);
      int tries;
      const double part = shorten(s, start, step, share * descent, dot(s.residual(), step), tries);
      counts.tries += tries;
      const double shorter = tries ? s.energy() : trial;
      if (shorter < trial) {
        share *= part;
        trial = shorter;
      } else if (tries) {
        s.go(start, 1.0, step);
      }
    }
    energy = trial;
    update *= share;
    if (update < round_off * r.step_tolerance) {
      const Values last = s.residual();
      counts.residual = largest(last);
      return true;
    }
  }
  return fails(iteration_limit);
}

// Let a static system that has lost its balance move to the next one: minimise the potential plus M |x - x_k|^2 / (2 tau^2)
// again and again, with longer and longer tau. Whether it came to rest.
template <class System>
THINSHELL_APART bool creep(System &s, const Record &r, const typename System::Values &targets, StepCounts &counts) {
  using Values = typename System::Values;
  constexpr double first = 3e-3, last = 1.0;
  constexpr int most = 40;
  Record loose = r;
  loose.step_tolerance *= 100.0;
  const Values none;
  double tau = first, growth = 4.0;
  for (int k = 0; k < most; ++k) {
    Values kept = s.x;
    s.tether(tau);
    Tangent<System> tied(s), own(s);
    const bool found = FastNewton<System>(s, loose, targets.data(), none, true, false, tied, counts).run();
    s.untether();
    if (!found) {
      s.put(kept);
      tau /= 4.0;
      growth = 2.0;
      continue;
    }
    tau *= growth;
    if (!(tau > last)) continue;
    kept = s.x;
    if (FastNewton<System>(s, r, targets.data(), none, false, false, own, counts).run()) return true;
    s.put(kept);
  }
  return false;
}

}  // namespace thinshell
