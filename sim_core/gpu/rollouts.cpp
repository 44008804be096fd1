// Many rollouts of one mesh, each with numbers of its own: one thread block a rollout on a GPU (NVRTC), one after the other on a
// CPU, where the same source is compiled as a library to test it. sim_core/gpu/engine.py calls it.

#include "include/block_rollout.hpp"

#ifndef __CUDACC_RTC__
#include <vector>
#endif

namespace thinshell {

// What a call is given: arrays in the memory of the device. A record's arrays that rollouts have of their own are one after
// the other, `stride` numbers apart (0: all have the same).
struct Launch {
  Record record;
  Plan plan;
  int64_t rollouts, first, steps, inertia, settle, places_stride, frames, every;
  int64_t external_stride, mass_stride, mass_damping_stride, stretch_stiffness_stride, stretch_damping_stride,
      rest_angle_stride, bend_stiffness_stride, bend_damping_stride, law_stride, body_rotation_stride, follower_local_stride;
  double settled_after, forever;
  const double *dt;      // of the steps [s] (steps)
  const double *places;  // of the mounts (rollouts or one, frames, mounts, 12), steps begin at `first`
  double *state;         // (rollouts, state numbers)
  int64_t state_size;
  int32_t *status;       // (rollouts): steps made; -1: no rest at the start
  int32_t *failed;       // (rollouts): 1 where a step was not found
  int32_t *begun;        // how many rollouts thread blocks have taken in this call, 0 at its start
  StepCounts *counts;    // (rollouts, steps)
  double *x, *force, *moment;  // (rollouts, frames, ...): that of rest, if it is sought, then every so many steps; null: none
  double *room;          // (blocks, room numbers)
  int64_t room_size, arena_slots, window_size, window_shared, panel_size, area_size;
};

inline double *take(double *&from, int64_t count) {
  double *at = from;
  from += count;
  return at;
}

inline void own_record(const Launch &l, int64_t k, Record &r) {
  r.external += k * l.external_stride;
  r.mass += k * l.mass_stride;
  r.mass_damping += k * l.mass_damping_stride;
  r.stretch_stiffness += k * l.stretch_stiffness_stride;
  r.stretch_damping += k * l.stretch_damping_stride;
  r.rest_angle += k * l.rest_angle_stride;
  r.bend_stiffness += k * l.bend_stiffness_stride;
  r.bend_damping += k * l.bend_damping_stride;
  r.law += k * l.law_stride;
  r.body_rotation += k * l.body_rotation_stride;
  r.follower_local += k * l.follower_local_stride;
}

// Rollout `k`, with the room of thread block `block`. `fast`: memory that is shared by the threads of the block.
inline void make(const Launch &l, const Record &r, int64_t k, int64_t block, const Team &team, double *fast) {
  const int64_t whole = 3 * r.nodes, samples = r.samples, contacts = r.contacts;
  double *own = l.state + k * l.state_size;
  BlockState state;
  for (double **to : {&state.x, &state.v, &state.x_past, &state.v_past}) *to = take(own, whole);
  state.memory.anchor = take(own, 3 * samples);
  state.memory.load = take(own, samples);
  state.memory.speed = take(own, samples);
  state.memory.rotation = take(own, 9 * contacts);
  state.dt_past = take(own, 1);

  double *room = l.room + block * l.room_size;
  Rooms o;
  o.factor = take(room, 64 * l.plan.panel_tiles);  // these two first: tiles begin at multiples of 16 bytes
  double *window = take(room, l.window_size);
  o.arena = take(room, whole * l.arena_slots);
  o.contact = take(room, BlockContacts::each_sample * samples + BlockContacts::each_contact * contacts);
  o.stretched = take(room, 9 * r.triangles);
  o.stretch_base = take(room, 3 * r.triangles);
  o.angle = take(room, r.hinges);
  o.angle_base = take(room, r.hinges);
  o.moment = take(room, r.hinges);
  o.slope = take(room, 12 * r.hinges);
  o.row = take(room, 3 * l.plan.row_nodes);
  o.part = take(room, 54 * (r.triangles + 2 * r.hinges));
  o.value = take(room, 9 * l.plan.blocks + 2);
  double *places = take(room, 12 * r.mounts + 9 * contacts);
  double *panel = take(fast, l.panel_size), *area = fast;
  if (l.window_shared) window = fast;

  Arena arena(team, o.arena, int(whole), int(l.arena_slots));
  BlockRollout rollout(arena, r, l.plan, o, window, panel, area, places, state);
  const double *path = l.places + k * l.places_stride;
  int made = l.status[k];
  bool fails = l.failed[k] != 0;
  const int64_t frames = (l.settle ? 1 : 0) + l.steps / l.every;
  const auto keep = [&](int64_t frame) {
    const int64_t at = k * frames + frame;
    if (l.x) rollout.write(l.x + at * whole, l.force + at * whole, l.moment + at * 3 * contacts);
  };
  team.sync();
  if (l.settle) {
    fails = !rollout.settle(path, l.settled_after, l.forever);
    if (fails) made = -1;
    else keep(0);
  }
  for (int64_t s = 0; s < l.steps && !fails; ++s) {
    const double *from = path + 12 * r.mounts * (l.first + s);
    StepCounts counts{};
    fails = !rollout.advance(l.dt[l.first + s], from, from + 12 * r.mounts, l.inertia != 0, counts);
    team.each(1, [&](int) { l.counts[k * l.steps + s] = counts; });
    if (fails) break;
    ++made;
    if ((s + 1) % l.every == 0) keep(frames - l.steps / l.every + s / l.every);
  }
  rollout.leave();
  team.each(1, [&](int) {
    l.status[k] = made;
    l.failed[k] = fails;
  });
}

}  // namespace thinshell

using thinshell::Launch;
using thinshell::Record;
using thinshell::Team;

#ifdef __CUDACC_RTC__

extern "C" __global__ void __launch_bounds__(THINSHELL_THREADS, THINSHELL_BLOCKS) thinshell_rollouts(const Launch *launch) {
  extern __shared__ double fast[];
  __shared__ double partial[96];
  __shared__ Launch shared_launch;
  __shared__ Record record;
  for (int k = threadIdx.x; k < int(sizeof(Launch) / 8); k += blockDim.x)
    reinterpret_cast<double *>(&shared_launch)[k] = reinterpret_cast<const double *>(launch)[k];
  __syncthreads();
  const Launch &l = shared_launch;
  const Team team(partial);
  __shared__ int next;
  while (true) {
    if (threadIdx.x == 0) next = atomicAdd(l.begun, 1);  // whichever block is free takes the next one
    __syncthreads();
    const long long k = next;
    if (k >= l.rollouts) return;
    if (threadIdx.x == 0) {
      record = l.record;
      thinshell::own_record(l, k, record);
    }
    __syncthreads();
    thinshell::make(l, record, k, blockIdx.x, team, fast);
    __syncthreads();
  }
}

#else

extern "C" int64_t thinshell_gpu_sizes(int64_t which) {
  return which == 0 ? sizeof(Launch) : which == 1 ? sizeof(thinshell::StepCounts) : thinshell::Arena::most;
}

extern "C" void thinshell_rollouts(const Launch *launch) {
  const Launch &l = *launch;
  std::vector<double> fast(l.panel_size + l.window_size + l.area_size), partial(96);
  const Team team(partial.data());
  for (int64_t k = 0; k < l.rollouts; ++k) {
    Record record = l.record;
    thinshell::own_record(l, k, record);
    thinshell::make(l, record, k, 0, team, fast.data());
  }
}

#endif
