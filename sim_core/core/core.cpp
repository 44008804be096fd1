// The C functions of the compiled core; sim_core/core/library.py calls them.

#include "include/rollout.hpp"

using thinshell::Frames;
using thinshell::Outputs;
using thinshell::Record;
using thinshell::Rollout;
using thinshell::StepCounts;

namespace {

Frames frames_at(const Record &record, const double *places, const double *motions, int64_t moving, int64_t k) {
  const double *moved = nullptr;
  if (motions && record.columns) moved = motions + (moving ? 6 * record.mounts * record.columns * k : 0);
  return {places + 12 * record.mounts * k, moved};
}

Outputs outputs_at(const Record &r, const Outputs &first, int64_t k) {
  Outputs out = first;
  out.x += 3 * r.nodes * k;
  out.force += 3 * r.nodes * k;
  out.moment += 3 * r.contacts * k;
  out.d_x += 3 * r.nodes * r.columns * k;
  out.d_force += 3 * r.bearing * r.columns * k;
  out.d_moment += 3 * r.contacts * r.columns * k;
  return out;
}

struct Handle {
  Record record;
  Rollout rollout;
  explicit Handle(const Record &r) : record(r), rollout(record) {}
};

}  // namespace

extern "C" {

int64_t thinshell_sizes(int64_t which) { return which == 0 ? sizeof(Record) : sizeof(StepCounts); }

int64_t thinshell_lanes() { return thinshell::lanes; }

void *thinshell_make(const Record *record) { return new Handle(*record); }

void thinshell_free(void *handle) { delete static_cast<Handle *>(handle); }

// Let there be PARDISO: the address of MKL's pardiso_64; null: none.
void thinshell_pardiso(void *function) {
  thinshell::pardiso_function = reinterpret_cast<thinshell::PardisoFunction>(function);
}

// Whether the factor is one by supernodes.
int64_t thinshell_supernodes(void *handle) { return static_cast<Handle *>(handle)->rollout.system.factor.by_supernodes(); }

// One of the arrays of the state; its size in `size`.
double *thinshell_state(void *handle, int64_t which, int64_t *size) {
  Rollout &r = static_cast<Handle *>(handle)->rollout;
  std::vector<double> *all[] = {&r.x, &r.velocity(), &r.x_past, &r.v_past,
                                &r.memory.anchor, &r.memory.load, &r.memory.speed, &r.memory.rotation,
                                &r.d_x, &r.d_v, &r.memory.d_rotation};
  *size = int64_t(all[which]->size());
  return all[which]->data();
}

// What the points of the contact of surfaces or edges that is `term`, surfaces first, remember: anchors, loads and slip
// speeds, and of edges the pairs that these are of, as numbers of 64 bits; how many in `size`.
const void *thinshell_held(void *handle, int64_t term, int64_t which, int64_t *size) {
  auto &contacts = static_cast<Handle *>(handle)->rollout.system.contacts;
  const int64_t surfaces = int64_t(contacts.surfaces.size());
  const thinshell::Held &held = term < surfaces ? contacts.surfaces[term].held : contacts.edges[term - surfaces].held;
  if (which == 3) {
    const thinshell::Keys &keys = contacts.edges[term - surfaces].keys;
    *size = int64_t(keys.size());
    return keys.data();
  }
  const std::vector<double> *all[] = {&held.anchor, &held.load, &held.speed};
  *size = int64_t(all[which]->size());
  return all[which]->data();
}

// The time [s] between the state and the one before it; 0: there is none.
double thinshell_past(void *handle) {
  Rollout &r = static_cast<Handle *>(handle)->rollout;
  return r.has_past ? r.dt_past : 0.0;
}

// Be at rest (or keep the velocity) in the state that was written into the arrays.
void thinshell_rest(void *handle, int64_t keep_velocity) {
  static_cast<Handle *>(handle)->rollout.rest(keep_velocity != 0);
}

// Steps of `dt` (count) from the present state, one after the other, to the frames of the mounts (count, mounts, 12), which
// move by the parameters as in `motions` (count or 1, mounts, 6, columns). `beside`: moves of the nodes of a rollout near
// by in these steps (count, nodes, 3), null: none. Returns how many were made: the search gave up in the next one.
int64_t thinshell_steps(void *handle, int64_t count, const double *dt, const double *places, const double *motions,
                        int64_t moving, const double *beside, int64_t inertia, const Outputs *out, StepCounts *counts) {
  Handle &h = *static_cast<Handle *>(handle);
  std::vector<double> guess(beside ? h.rollout.system.whole() : 0);
  for (int64_t k = 0; k < count; ++k) {
    const Frames frames = frames_at(h.record, places, motions, moving, k);
    if (beside)
      for (std::size_t i = 0; i < guess.size(); ++i) guess[i] = h.rollout.x[i] + beside[k * guess.size() + i];
    counts[k] = StepCounts{};
    if (!h.rollout.step(dt[k], frames, beside ? guess.data() : nullptr, inertia != 0, counts[k])) return k;
    h.rollout.end(dt[k], frames, inertia != 0);
    h.rollout.write(outputs_at(h.record, *out, k));
  }
  return count;
}

// A step that ends at `there` (nodes, 3), as another search has found.
void thinshell_accept(void *handle, double dt, const double *places, const double *motions, const double *there,
                      int64_t inertia, const Outputs *out) {
  Handle &h = *static_cast<Handle *>(handle);
  h.rollout.accept(dt, frames_at(h.record, places, motions, 0, 0), there, inertia != 0);
  h.rollout.write(*out);
}

// The potential of a step that is not made: energy, gradient (nodes, 3), Hessian (3 nodes, 3 nodes), zero before, at
// `there` (nodes, 3).
void thinshell_potential(void *handle, double dt, const double *places, const double *there, int64_t inertia,
                         int64_t exact, double *energy, double *gradient, double *hessian) {
  Handle &h = *static_cast<Handle *>(handle);
  h.rollout.potential(dt, frames_at(h.record, places, nullptr, 0, 0), there, inertia != 0, exact != 0, energy, gradient,
                      hessian);
}

}  // extern "C"
