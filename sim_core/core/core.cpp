// The C functions of the compiled core; sim_core/core/library.py calls them.

#include "include/adjoint.hpp"

using thinshell::Adjoint;
using thinshell::Frames;
using thinshell::Outputs;
using thinshell::Record;
using thinshell::Rollout;
using thinshell::StepCounts;
using thinshell::Tape;

namespace {

// `moving`: whether motions differ from instant to instant.
Frames frames_at(const Record &record, const double *places, const double *motions, int64_t moving, const double *weights,
                 int64_t k) {
  const double *moved = nullptr;
  if (motions && record.columns) moved = motions + (moving ? 6 * record.mounts * record.columns * k : 0);
  return {places + 12 * record.mounts * k, moved, weights ? weights + record.modulations * k : nullptr};
}

Outputs outputs_at(const Record &r, const Outputs &first, int64_t k) {
  Outputs out = first;
  out.x += 3 * (r.nodes + r.yielding) * k;
  out.force += 3 * r.nodes * k;
  out.moment += 3 * r.contacts * k;
  out.d_x += 3 * (r.nodes + r.yielding) * r.columns * k;
  out.d_force += 3 * r.bearing * r.columns * k;
  out.d_moment += 3 * r.contacts * r.columns * k;
  out.motion += 6 * r.mounts * r.columns * k;
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

// How many iterations the guarded search may take.
void thinshell_iterations(void *handle, int64_t slow) { static_cast<Handle *>(handle)->rollout.may_take(slow); }

// Whether the factor is one by supernodes.
int64_t thinshell_supernodes(void *handle) { return static_cast<Handle *>(handle)->rollout.system.factor.by_supernodes(); }

// One of the arrays of the state; its size in `size`.
double *thinshell_state(void *handle, int64_t which, int64_t *size) {
  Rollout &r = static_cast<Handle *>(handle)->rollout;
  std::vector<double> *all[] = {&r.x, &r.velocity(), &r.x_past, &r.v_past,
                                &r.memory.anchor, &r.memory.load, &r.memory.speed, &r.memory.rotation, &r.memory.bonded,
                                &r.d_x, &r.d_v, &r.memory.d_rotation, &r.system.x, &r.system.gradient,
                                &r.time, &r.pair_force};
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

// What a material law remembers at its points (points, states), or the derivatives of that (points, states, columns).
double *thinshell_material(void *handle, int64_t law, int64_t derivatives, int64_t *size) {
  std::vector<double> &found = static_cast<Handle *>(handle)->rollout.system.material(int(law), derivatives != 0);
  *size = int64_t(found.size());
  return found.data();
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

// A state that can be put back, without derivatives; to be dropped.
void *thinshell_keep(void *handle) { return new Rollout::Kept(static_cast<Handle *>(handle)->rollout.keep()); }
void thinshell_put_back(void *handle, const void *kept) {
  static_cast<Handle *>(handle)->rollout.put_back(*static_cast<const Rollout::Kept *>(kept));
}
void thinshell_drop(void *kept) { delete static_cast<Rollout::Kept *>(kept); }

// Keep the forces of contacts at the ends of steps.
void thinshell_keep_forces(void *handle) { static_cast<Handle *>(handle)->rollout.keep_forces(); }

// Let another rollout of the same nodes follow this one; what its laws change in the forces is the source of a column, -1:
// of none.
void thinshell_amend(void *handle, void *other, int64_t column) {
  Rollout &r = static_cast<Handle *>(handle)->rollout;
  r.respond();
  r.amended.emplace_back(&static_cast<Handle *>(other)->rollout, int(column));
}
// Let a mount, which carries `count` nodes, give way in a column by its `compliance` [m/N] (3).
void thinshell_yield(void *handle, int64_t column, int64_t mount, const double *compliance, int64_t count,
                     const int32_t *nodes) {
  Rollout &r = static_cast<Handle *>(handle)->rollout;
  r.respond();
  r.sources.compliant.push_back({int(column), int(mount), {compliance[0], compliance[1], compliance[2]}, {nodes, nodes + count}});
}

// Steps of `dt` (count) from the present state, one after the other, along the frames of the mounts, those of the present
// state first (count + 1, mounts, 12), which move by the parameters as in `motions` (count + 1 or 1, mounts, 6, columns).
// `weights`: of the modulations (count + 1, modulations). `warm_start`: moves of the nodes of a rollout near by in these steps
// (count, nodes, 3), null: none. Returns how many were made; of the next one as much as its counts say.
int64_t thinshell_steps(void *handle, int64_t count, const double *dt, const double *places, const double *motions,
                        int64_t moving, const double *weights, const double *warm_start, int64_t inertia, const Outputs *out,
                        StepCounts *counts) {
  Handle &h = *static_cast<Handle *>(handle);
  std::vector<double> guess;
  for (int64_t k = 0; k < count; ++k) {
    const Frames from = frames_at(h.record, places, motions, moving, weights, k);
    const Frames to = frames_at(h.record, places, motions, moving, weights, k + 1);
    if (warm_start) {
      guess = h.rollout.x;
      for (int64_t i = 0; i < 3 * h.record.nodes; ++i) guess[i] += warm_start[3 * h.record.nodes * k + i];
    }
    counts[k] = StepCounts{};
    if (h.rollout.tape) ++h.rollout.tape->interval;
    if (!h.rollout.advance(dt[k], from, to, warm_start ? guess.data() : nullptr, inertia != 0, counts[k])) return k;
    h.rollout.write(outputs_at(h.record, *out, k));
  }
  return count;
}

// Forces where nothing has moved yet, as of a step of `dt` that ends there.
void thinshell_stand(void *handle, double dt, const double *places, const double *motions, const double *weights,
                     int64_t inertia, const Outputs *out) {
  Handle &h = *static_cast<Handle *>(handle);
  h.rollout.stand(dt, frames_at(h.record, places, motions, 0, weights, 0), inertia != 0);
  h.rollout.write(*out);
}

// One step that is not halved: for settling. 1 where it was made, else 0.
int64_t thinshell_step(void *handle, double dt, const double *places, const double *motions, const double *weights,
                       int64_t inertia, const Outputs *out, StepCounts *counts) {
  Handle &h = *static_cast<Handle *>(handle);
  const Frames frames = frames_at(h.record, places, motions, 0, weights, 0);
  *counts = StepCounts{};
  h.rollout.time[0] = -dt;  // loads are those of the start
  if (!h.rollout.step(dt, frames, nullptr, inertia != 0, *counts)) return 0;
  h.rollout.end(dt, frames, inertia != 0);
  h.rollout.write(*out);
  return 1;
}

// The potential of a step that is not made: energy, gradient (nodes, 3), Hessian (3 nodes, 3 nodes), zero before, at
// `there` (nodes, 3).
void thinshell_potential(void *handle, double dt, const double *places, const double *there, int64_t inertia,
                         int64_t exact, double *energy, double *gradient, double *hessian) {
  Handle &h = *static_cast<Handle *>(handle);
  const Frames frames = frames_at(h.record, places, nullptr, 0, nullptr, 0);
  h.rollout.potential(dt, frames, there, inertia != 0, exact != 0, energy, gradient, hessian);
}

// Be in the state that was written into the arrays; `dt_past`: since the one before [s], 0: there is none.
void thinshell_resume(void *handle, double dt_past) { static_cast<Handle *>(handle)->rollout.resume(dt_past); }

// Make room for what `count` pairs of the contact of edges that is `term`, surfaces first, remember.
void thinshell_hold_pairs(void *handle, int64_t term, int64_t count) {
  auto &contacts = static_cast<Handle *>(handle)->rollout.system.contacts;
  thinshell::EdgePairs &edges = contacts.edges[term - int64_t(contacts.surfaces.size())];
  edges.held.resize(std::size_t(count), std::size_t(static_cast<Handle *>(handle)->record.columns));
  edges.keys.assign(std::size_t(count), 0);
}

// One step of a system without followers, which is not halved, to `targets` of what is prescribed (nodes, 3), and where the
// potential is there [J], what elements and contacts exert there (nodes, 3). 1 where it was found; the state is what the
// search ended with either way. `guess`: where to begin (nodes, 3), null: nowhere.
int64_t thinshell_advance(void *handle, double dt, const double *places, const double *targets, const double *guess,
                          int64_t inertia, double *energy, double *exerted, StepCounts *counts) {
  Handle &h = *static_cast<Handle *>(handle);
  Frames frames{places, nullptr, nullptr, targets};
  std::vector<double> begin = h.rollout.x;
  if (guess) std::copy_n(guess, 3 * h.record.nodes, begin.begin());
  *counts = StepCounts{};
  const bool found = h.rollout.step(dt, frames, guess ? begin.data() : nullptr, inertia != 0, *counts);
  h.rollout.system.residual();
  *energy = h.rollout.system.energy() - h.rollout.system.tetrahedra.damping_at_start(h.rollout.x.data());
  h.rollout.system.exerted(exerted);
  h.rollout.end(dt, frames, inertia != 0);
  return found;
}

// The potential of such a step at `there` (nodes, 3), which is not made: energy, gradient and what elements and contacts
// exert (nodes, 3), contacts; the Hessian is that of thinshell_blocks.
void thinshell_look(void *handle, double dt, const double *places, const double *targets, const double *there,
                    int64_t inertia, int64_t exact, double *energy, double *gradient, double *exerted,
                     StepCounts *counts) {
  Rollout &r = static_cast<Handle *>(handle)->rollout;
  r.look(dt, Frames{places, nullptr, nullptr, targets}, there, inertia != 0, exact != 0, energy, gradient);
  r.system.exerted(exerted);
  *counts = StepCounts{};
  r.system.contacts.report(*counts);
}

// Such a step that ends at `there` (nodes, 3), whether that is in balance or not.
void thinshell_end(void *handle, double dt, const double *places, const double *targets, const double *there,
                   int64_t inertia) {
  static_cast<Handle *>(handle)->rollout.accept(dt, Frames{places, nullptr, nullptr, targets}, there, inertia != 0);
}

// Blocks of the Hessian that was assembled last, its lower half in the order of elimination; how many. `row`, `column`:
// their nodes, `value`: their entries (blocks, 9); null: only count.
int64_t thinshell_blocks(void *handle, int64_t *row, int64_t *column, double *value) {
  const thinshell::Blocks &found = static_cast<Handle *>(handle)->rollout.system.hessian;
  const int64_t count = found.end(found.nodes() - 1);
  for (int i = 0; row && i < found.nodes(); ++i)
    for (int k = found.begin(i); k < found.end(i); ++k) {
      row[k] = i;
      column[k] = found.column(k);
      std::copy_n(found.block(k), 9, value + 9 * k);
    }
  return count;
}

// Let a rollout's steps be noted from now on, on a tape that is returned; `bound`: on its memory [B], in addition to positions.
void *thinshell_tape(void *handle, int64_t bound) {
  Tape *tape = new Tape;
  tape->bound = std::size_t(bound);
  static_cast<Handle *>(handle)->rollout.tape = tape;
  return tape;
}
void thinshell_tape_free(void *tape) { delete static_cast<Tape *>(tape); }
int64_t thinshell_tape_bytes(void *tape) { return int64_t(static_cast<Tape *>(tape)->bytes()); }

// Positions at instants from `first` on, before `end` (., nodes and deflections, 3); steps ended at all of them.
void thinshell_tape_positions(void *tape, int64_t first, int64_t end, double *out) {
  const Tape &t = *static_cast<Tape *>(tape);
  for (std::size_t k = 0; k < t.steps.size(); ++k) {
    const int64_t at = t.steps[k].interval;
    if (at < first || at >= end || (k + 1 < t.steps.size() && t.steps[k + 1].interval == at)) continue;
    const std::vector<double> &x = t.end_of(k);
    std::copy(x.begin(), x.end(), out + (at - first) * int64_t(x.size()));
  }
}

// The way back through rollouts of a record, whose columns are those of numbers that are differentiated by.
void *thinshell_adjoint(const Record *record) { return new Adjoint(*record); }
void thinshell_adjoint_free(void *adjoint) { delete static_cast<Adjoint *>(adjoint); }
// Let weights be summed up by the record's numbers, element by element, too, and by `shapes` at rest.
void thinshell_adjoint_want(void *adjoint, const thinshell::Curving *curving, int64_t shapes) {
  static_cast<Adjoint *>(adjoint)->want_elements(*curving, shapes != 0);
}
double *thinshell_adjoint_elements(void *adjoint, int64_t which, int64_t *size) {
  thinshell::ElementWeights &e = static_cast<Adjoint *>(adjoint)->elements();
  std::vector<double> *all[] = {
      &e.mass, &e.mass_damping, &e.external, &e.stretch_stiffness, &e.stretch_damping, &e.hats, &e.curve_stiffness,
      &e.curve_damping, &e.operator_stiffness, &e.operator_damping, &e.operator_law, &e.rest_angle, &e.gel, &e.gel_gradient,
      &e.gel_volume, &e.material_row, &e.material_area, &e.sample_area, &e.surface_area, &e.edge_area, &e.edge_square,
      &e.drag_factor, &e.follower_local};
  *size = int64_t(all[which]->size());
  return all[which]->data();
}
// One of the arrays of weights; its size in `size`.
double *thinshell_adjoint_weights(void *adjoint, int64_t which, int64_t *size) {
  Adjoint &a = *static_cast<Adjoint *>(adjoint);
  std::vector<double> *all[] = {&a.x, &a.velocity(), &a.rotation(), &a.numbers(),
                                &a.held(-1).anchor, &a.held(-1).load, &a.held(-1).speed};
  *size = int64_t(all[which]->size());
  return all[which]->data();
}
// Of what the points of a contact of surfaces or edges remember, as thinshell_held has that.
const void *thinshell_adjoint_held(void *adjoint, int64_t term, int64_t which, int64_t *size) {
  thinshell::HeldWeights &held = static_cast<Adjoint *>(adjoint)->held(int(term));
  if (which == 3) {
    *size = int64_t(held.keys.size());
    return held.keys.data();
  }
  std::vector<double> *all[] = {&held.anchor, &held.load, &held.speed};
  *size = int64_t(all[which]->size());
  return all[which]->data();
}
// Of what a material law remembers (points, states).
double *thinshell_adjoint_material(void *adjoint, int64_t law, int64_t *size) {
  std::vector<double> &found = static_cast<Adjoint *>(adjoint)->material(int(law));
  *size = int64_t(found.size());
  return found.data();
}
// Begin at the end of a tape; all weights are zero.
void thinshell_adjoint_begin(void *adjoint, void *tape) {
  static_cast<Adjoint *>(adjoint)->begin(*static_cast<Tape *>(tape));
}
// Through the steps to instants from `from` on, the last one first, with weights of the readings at these (., nodes, 3),
// (., bearing, 3), (., contacts, 3), those of positions with rows of deflections. `frames`: weights of motions of the mounts (instants, mounts, 6), added to.
void thinshell_adjoint_sweep(void *adjoint, void *tape, int64_t from, const double *x, const double *force,
                             const double *moment, double *frames) {
  static_cast<Adjoint *>(adjoint)->sweep(*static_cast<Tape *>(tape), from, {from, x, force, moment}, frames);
}
// Back from forces at the start (thinshell_stand), where nodes are at `at` with velocities `v` and rigid bodies turned.
void thinshell_adjoint_stand(void *adjoint, const double *at, const double *v, const double *rotation, double dt,
                             const double *places, int64_t inertia, const double *x, const double *force,
                             const double *moment, double *frames) {
  Adjoint &a = *static_cast<Adjoint *>(adjoint);
  std::copy_n(at, a.rollout().x.size(), a.rollout().x.begin());
  std::copy_n(v, a.rollout().x.size(), a.rollout().velocity().begin());
  thinshell::Memory &memory = a.rollout().memory;
  std::copy_n(rotation, memory.rotation.size(), memory.rotation.begin());
  for (auto *held : {&memory.anchor, &memory.load, &memory.speed, &memory.bonded}) std::fill(held->begin(), held->end(), 0.0);
  a.stand(dt, places, inertia != 0, {0, x, force, moment}, frames);
}

}  // extern "C"
