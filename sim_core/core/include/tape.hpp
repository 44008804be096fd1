// The steps of a rollout as they were made: what it takes to stand at the end of each again.
#pragma once

#include <cstdint>
#include <vector>

#include "record.hpp"

namespace thinshell {

class Rollout;
struct Frames;

class Tape {
 public:
  using Values = std::vector<double>;
  using Numbers = std::vector<int64_t>;

  // Some of the points of a contact: which of them, and five numbers each: anchor, load, slip speed.
  struct Points {
    Numbers which;
    Values held;
  };

  // One step, of a part of the time between two instants: to instant `interval`, `share` of the way from the one before.
  struct Kept {
    int64_t interval;
    double share, dt, since, start;  // since: the time between the state and the one before it; 0: there is none; start: [s]
    bool inertia, whole;             // whole: or positions and places alone
    Values x, v, places, rotation;  // at the start of the step, places of the mounts at its end
    Values from, to;                // places of the mounts at the two instants, of a part of the time between them
    Values v_past;                  // where the step before is not whole
    Points shapes;
    Numbers bonded;
    std::vector<Points> others;      // of contacts of surfaces, then of edges
    std::vector<Numbers> keys;       // of edges, all pairs
    std::vector<Values> materials;
    std::size_t bytes() const;
  };

  std::vector<Kept> steps;
  Values last;  // positions at the end
  int64_t interval = 0;
  double share = 1.0;
  const double *from = nullptr, *to = nullptr;  // places of the mounts at the instants before and after the share

  // Take note of a step, at whose end the system stands, before the state goes on.
  void take(Rollout &rollout, double dt, const Frames &frames, bool inertia);
  // Bring a rollout to the start of a step.
  void restore(std::size_t k, Rollout &rollout) const;
  // Positions at the end of a step.
  const Values &end_of(std::size_t k) const { return k + 1 < steps.size() ? steps[k + 1].x : last; }

  std::size_t bytes() const { return bytes_; }
  std::size_t bound = 0;  // on that [B], above which steps are kept by positions and places alone; 0: none

 private:
  // Keep less; false where there is nothing left to leave out.
  bool thin();

  std::size_t bytes_ = 0, thinned_ = 0, stride_ = 2;
};

}  // namespace thinshell
