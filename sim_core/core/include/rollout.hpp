// A rollout: one step after the other along prescribed motions of the mounts, with derivatives by parameters.
//
// A step is searched for as in sim_core/solve/contact_newton.py and newton.py: by the fast Newton from a guess, where
// velocities lead, or where the step starts; accepted if the last tangent was the true Hessian, positive definite, the
// energy is not above that of the start, and the straight path to it is free; then by searches that go down in energy, and
// in halves, quarters and so on of the step.
//
// Derivatives follow the implicit steps, as sim_core/gradients/step.py has them: with the residual R(x'; s, p) = 0,
//
//     dx' = -H^-1 [dR/ds ds + dR/dp + H dm] + dm
//
// s: the state at the start with its memory, dm: motion of what is prescribed, H: the true Hessian at the solution.
#pragma once

#include <vector>

#include "gradings.hpp"
#include "responses.hpp"
#include "search.hpp"
#include "system.hpp"
#include "tape.hpp"

namespace thinshell {

struct Frames {
  const double *places;   // origins and rotations of the mounts (mounts, 12)
  const double *motions;  // their motions in their own frames by the parameters (mounts, 6, columns); null: none
  const double *weights;  // of the modulations; null: none
  const double *targets = nullptr;  // of what is prescribed (nodes, 3), of a system that has no mounts; null: by followers
};

// Where results of one instant go.
struct Outputs {
  double *x, *force, *moment;           // (nodes and deflections, 3), (nodes, 3), (contacts, 3)
  double *d_x, *d_force, *d_moment;     // the same with columns, forces of the bearing nodes
  double *motion;                       // of the mounts by what they give way (mounts, 6, columns)
};

class Rollout {
 public:
  explicit Rollout(const Record &record) : Rollout(record, record.columns) {}
  // `columns`: those of the record, or none.
  Rollout(const Record &record, int64_t columns)
      : r_(carrying(record, columns)), modulations_(r_), gradings_(r_, record.columns), system(r_), time(1, 0.0), tangent_(system) {
    const std::size_t whole = system.whole(), samples = r_.samples, width = r_.columns;
    for (Values *v : {&x, &v_, &x_past, &v_past}) v->assign(whole, 0.0);
    for (Values *v : {&d_x, &d_v, &d_x_past, &d_v_past}) v->assign(whole * width, 0.0);
    memory.anchor.assign(3 * samples, 0.0);
    memory.load.assign(samples, 0.0);
    memory.speed.assign(samples, 0.0);
    memory.bonded.assign(samples, 0.0);
    memory.rotation.assign(9 * r_.contacts, 0.0);
    memory.d_anchor.assign(3 * samples * width, 0.0);
    memory.d_load.assign(samples * width, 0.0);
    memory.d_speed.assign(samples * width, 0.0);
    memory.d_rotation.assign(9 * r_.contacts * width, 0.0);
    turned_.assign(9 * r_.contacts, 0.0);
    d_turned_.assign(9 * r_.contacts * width, 0.0);
    targets_.assign(whole, 0.0);
    d_force_.assign(whole * width, 0.0);
    d_moment_.assign(3 * r_.contacts * width, 0.0);
    moment_.assign(3 * r_.contacts, 0.0);
    system.contacts.guard(true);
  }

  // One step of `dt` [s] to where the mounts are at the `frames`; `guess`: where to begin the search (null: nowhere).
  bool step(double dt, const Frames &frames, const double *guess, bool inertia, StepCounts &counts) {
    place(frames);
    begin(dt, inertia);
    const int64_t residuals = system.residuals;
    const Start<System> start{x, v_, v_past, targets_, memory, dt, dt_past, has_past};
    const Values there = guess ? Values(guess, guess + system.whole()) : Values();
    const bool found = Search<System>(system, r_, start, tangent_, counts).run(there, inertia);
    const bool inverted = found && system.turns_over(x);
    if (inverted) counts.failure = turned_over;
    system.contacts.guard(true);
    counts.residuals += system.residuals - residuals;
    system.contacts.report(counts);
    return found && !inverted;
  }

  // A step from where the mounts are at the frames `from` to `to`, in as many parts as it takes; whether all of it was
  // made, else `counts` says how much.
  bool advance(double dt, const Frames &from, const Frames &to, const double *guess, bool inertia, StepCounts &counts) {
    int64_t part = finest;
    while (counts.made < finest) {
      const double begun = double(counts.made) / finest, share = double(part) / finest;
      const Frames end = between(from, to, begun + share);
      if (!step(share * dt, end, part == finest ? guess : nullptr, inertia, counts)) {
        if (part == 1) return false;
        part /= 2;
        continue;
      }
      if (tape) {
        tape->share = begun + share;
        tape->from = from.places;
        tape->to = to.places;
      }
      this->end(share * dt, end, inertia);
      ++counts.parts;
      counts.made += part;
      while (part < finest && counts.made % (2 * part) == 0) part *= 2;
    }
    return true;
  }

  // Take the step: from where the system stands at its end to the next state, with derivatives.
  void end(double dt, const Frames &frames, bool inertia) {
    if (system.contacts.any()) system.contacts.shapes.moments(system.x.data(), moment_.data());
    if (!pair_force.empty()) system.contacts.forces(system.x.data(), pair_force);
    if (tape) tape->take(*this, dt, frames, inertia);
    for (const auto &[other, column] : amended) other->trace(*this, dt, frames, inertia);
    if (r_.columns) push(dt, frames, inertia);
    system.contacts.end(system.x.data(), dt, memory);
    system.end();
    x_past.swap(x);
    v_past.swap(v_);
    x = system.x;
    if (inertia)
      for (std::size_t k = 0; k < x.size(); ++k) v_[k] = (x[k] - step_.x_base[k]) / step_.tau;
    else
      std::fill(v_.begin(), v_.end(), 0.0);
    has_past = inertia && r_.second_order;
    dt_past = dt;
    time[0] += dt;
  }

  // Take a step whose end another rollout has found [m] (nodes, 3).
  void accept(double dt, const Frames &frames, const double *there, bool inertia) {
    place(frames);
    begin(dt, inertia);
    stand_at(there);
    system.residual();
    end(dt, frames, inertia);
  }

  // Be in the state that was written into the arrays; `dt_since`: since the one before [s], 0: there is none.
  void resume(double dt_since) {
    has_past = dt_since > 0.0;
    dt_past = dt_since;
    tangent_.drop();
  }

  // The potential of the step of `dt` [s] that begins now, at `there` [m] (nodes, 3): energy [J], gradient [N], and the
  // Hessian [N/m] (3 nodes, 3 nodes).
  void potential(double dt, const Frames &frames, const double *there, bool inertia, bool exact, double *energy,
                 double *gradient, double *hessian) {
    look(dt, frames, there, inertia, exact, energy, gradient);
    system.hessian.spread(hessian);
  }
  // The same, the Hessian left with the system.
  void look(double dt, const Frames &frames, const double *there, bool inertia, bool exact, double *energy,
            double *gradient) {
    place(frames);
    begin(dt, inertia);
    stand_at(there);
    *energy = system.energy() - system.tetrahedra.damping_at_start(x.data());
    system.residual();
    std::copy_n(system.gradient.begin(), 3 * r_.nodes, gradient);
    if (!pair_force.empty()) system.contacts.forces(system.x.data(), pair_force);
    system.assemble(exact, nullptr);
  }

  // Forces where nothing has moved yet, as at the end of a step of `dt` [s] without any motion, with derivatives; the
  // memory stays that of the start.
  void stand(double dt, const Frames &frames, bool inertia) {
    time[0] = -dt;
    place(frames);
    begin(dt, inertia);
    time[0] = 0.0;
    system.x = x;
    system.cover();
    system.residual();
    system.contacts.shapes.moments(system.x.data(), moment_.data());
    if (!pair_force.empty()) system.contacts.forces(system.x.data(), pair_force);
    if (!r_.columns) return;
    system.assemble(true, nullptr);
    modulations_.apply(frames.weights);
    Values unused_move(d_x.size(), 0.0);
    move(frames, unused_move);
    d_force_ = Values(d_force_.size(), 0.0);
    add_inertia(d_x, d_v, inertia);
    add_columns(d_x);
    system.hessian.multiply(d_x.data(), d_force_.data(), int(r_.columns));
    Memory unused = memory;
    system.contacts.shapes.end_columns(x.data(), x.data(), d_x.data(), d_x.data(), dt, d_turned_.data(), unused,
                                       d_moment_.data(), d_force_.data());
    system.embedding.fold(d_force_.data(), int(r_.columns));
  }

  void write(const Outputs &out) const {
    const std::size_t width = r_.columns;
    std::copy(system.x.begin(), system.x.end(), out.x);
    loads(out.force);
    std::copy(moment_.begin(), moment_.end(), out.moment);
    if (!width) return;
    std::copy(d_x.begin(), d_x.end(), out.d_x);
    for (int b = 0; b < r_.bearing; ++b) {
      const double *from = &d_force_[3 * width * r_.bearing_node[b]];
      for (std::size_t k = 0; k < 3 * width; ++k) out.d_force[3 * width * b + k] = -from[k];
    }
    std::copy(d_moment_.begin(), d_moment_.end(), out.d_moment);
    std::copy(sources.motion.begin(), sources.motion.end(), out.motion);
  }

  // Be at rest in a state that was written into x, d_x and the memory; time begins.
  void rest(bool keep_velocity) {
    if (!keep_velocity) {
      std::fill(v_.begin(), v_.end(), 0.0);
      std::fill(d_v.begin(), d_v.end(), 0.0);
    }
    has_past = false;
    time[0] = 0.0;
    if (!r_.columns) return;
    system.triangles.restart_slopes(x.data(), d_x.data());
    system.hinges.restart_slopes(x.data(), d_x.data());
    system.tetrahedra.restart_slopes(x.data(), d_x.data());
  }

 private:
  friend class Adjoint;
  static constexpr int64_t finest = 32;  // parts of a step, at most

  static Record carrying(Record record, int64_t columns) {
    record.columns = columns;
    return record;
  }

  // Where mounts are after a share of a step.
  Frames between(const Frames &from, const Frames &to, double share) {
    if (share == 1.0) return to;
    places_.resize(12 * r_.mounts);
    for (int m = 0; m < r_.mounts; ++m) {
      const double *a = from.places + 12 * m, *b = to.places + 12 * m;
      for (int k = 0; k < 3; ++k) places_[12 * m + k] = (1.0 - share) * a[k] + share * b[k];
      turn_between(a + 3, b + 3, share, &places_[12 * m + 3]);
    }
    auto mixed = [&](Values &out, const double *a, const double *b, std::size_t size) -> const double * {
      if (!b) return nullptr;
      out.resize(size);
      for (std::size_t k = 0; k < size; ++k) out[k] = (1.0 - share) * a[k] + share * b[k];
      return out.data();
    };
    const double *motions = to.motions ? moved_between(from, to, share) : nullptr;
    return {places_.data(), motions, mixed(weights_, from.weights, to.weights, r_.modulations)};
  }

  const double *moved_between(const Frames &from, const Frames &to, double share) {
    const std::size_t width = r_.columns;
    motions_.assign(6 * r_.mounts * width, 0.0);
    for (int m = 0; m < r_.mounts; ++m) {
      const MotionBetween by = motion_between(from.places + 12 * m + 3, to.places + 12 * m + 3, share);
      const auto add = [&](const Mat3 &factor, const double *motions, std::size_t part) {
        for (std::size_t i = 0; i < 3; ++i)
          for (std::size_t j = 0; j < 3; ++j)
            for (std::size_t c = 0; c < width; ++c)
              motions_[(6 * m + part + i) * width + c] += factor(int(i), int(j)) * motions[(6 * m + part + j) * width + c];
      };
      add(by.shift_from, from.motions, 0);
      add(by.shift_to, to.motions, 0);
      add(by.turn_from, from.motions, 3);
      add(by.turn_to, to.motions, 3);
    }
    return motions_.data();
  }

  // Where followers and rigid bodies are when the mounts are at `frames`.
  void place(const Frames &frames) {
    if (frames.targets) std::copy_n(frames.targets, 3 * r_.nodes, targets_.begin());
    for (int f = 0; f < r_.followers; ++f) {
      const double *at = frames.places + 12 * r_.follower_mount[f], *local = r_.follower_local + 3 * f;
      for (int i = 0; i < 3; ++i)
        if (r_.follower_axes[3 * f + i])
          targets_[3 * r_.follower_node[f] + i] =
              at[i] + at[3 + 3 * i] * local[0] + at[4 + 3 * i] * local[1] + at[5 + 3 * i] * local[2];
    }
    for (int c = 0; c < r_.contacts; ++c) {
      const Mat3 turn = matmul(rotation_of(frames.places + 12 * r_.body_mount[c] + 3), rotation_of(r_.body_rotation + 9 * c));
      std::copy(turn.a, turn.a + 9, &turned_[9 * c]);
    }
  }

  void begin(double dt, bool inertia) {
    step_.dt = dt;
    step_.end = time[0] + dt;
    if (gradings_.apply(std::max(time[0], 0.0))) system.tetrahedra.weigh();
    const double r = has_past ? dt / dt_past : 0.0;
    step_.now = (1.0 + r) * (1.0 + r) / (1.0 + 2.0 * r);
    step_.before = -r * r / (1.0 + 2.0 * r);
    step_.tau = dt * (1.0 + r) / (1.0 + 2.0 * r);
    combine(x, x_past, step_.x_base);
    combine(v_, v_past, step_.v_base);
    system.x = x;
    system.hold(targets_.data());
    Values towards = x;
    for (std::size_t k = 0; k < towards.size(); ++k) towards[k] = r_.prescribed[k] ? targets_[k] : x[k] + dt * v_[k];
    system.yielding.follow(towards.data());
    system.embedding.fill(towards.data());
    system.begin(step_, x.data(), has_past ? x_past.data() : nullptr, towards.data(), turned_.data(), memory, inertia);
  }
  void combine(const Values &here, const Values &past, Values &out) const {
    out = here;
    if (!has_past) return;
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = step_.now * here[k] + step_.before * past[k];
  }

  // Be at the positions of the nodes (nodes, 3), and where mounts have given way for them.
  void stand_at(const double *there) {
    std::copy(there, there + 3 * r_.nodes, system.x.begin());
    system.yielding.read(targets_.data(), system.x.data());
    system.cover();
  }

  // Forces on the nodes where the system stands [N] (nodes, 3), with what joints pass on.
  void loads(double *out) const {
    for (int k = 0; k < 3 * r_.nodes; ++k) out[k] = -system.gradient[k];
    system.embedding.fold(out);
    for (int e = 0; e < system.embedding.count(); ++e)  // of these what elements and contacts exert, alone
      for (int i = 3 * system.embedding.node(e); i < 3 * system.embedding.node(e) + 3; ++i) out[i] -= r_.external[i];
  }

  // What the laws that this rollout lacks change in the forces of the step at whose end the system stands.
  Frames answer(const Frames &frames) {
    const std::size_t width = r_.columns;
    for (Values *v : {&sources.force, &sources.moment, &sources.motion}) std::fill(v->begin(), v->end(), 0.0);
    system.residual();
    for (const auto &[other, column] : amended) {
      if (column < 0) continue;
      for (int k = 0; k < 3 * r_.nodes; ++k)
        sources.force[k * width + column] = other->system.gradient[k] - system.gradient[k];
      for (std::size_t k = 0; k < moment_.size(); ++k)
        sources.moment[k * width + column] = other->moment_[k] - moment_[k];
    }
    if (sources.compliant.empty()) return frames;
    Values load(3 * r_.nodes);
    loads(load.data());
    for (const Sources::Compliant &c : sources.compliant) {
      Vec3 way = {{0.0, 0.0, 0.0}};
      for (const int node : c.nodes)
        for (int i = 0; i < 3; ++i) way[i] += c.compliance[i] * load[3 * node + i];
      const Vec3 own = matmul(rotation_of(frames.places + 12 * c.mount + 3).transpose(), way);
      for (int i = 0; i < 3; ++i) sources.motion[(6 * c.mount + i) * width + c.column] += own[i];
    }
    moved_ = sources.motion;
    for (std::size_t k = 0; frames.motions && k < moved_.size(); ++k) moved_[k] += frames.motions[k];
    return {frames.places, moved_.data(), frames.weights};
  }
  // Make the step that another rollout, of the same nodes, has found, with a memory of its own.
  void trace(const Rollout &other, double dt, const Frames &frames, bool inertia) {
    for (auto [to, from] : {std::pair(&x, &other.x), {&v_, &other.v_}, {&x_past, &other.x_past}, {&v_past, &other.v_past}}) {
      *to = *from;
      to->resize(system.whole(), 0.0);  // other mounts may give way
    }
    has_past = other.has_past;
    dt_past = other.dt_past;
    time = other.time;
    accept(dt, frames, other.system.x.data(), inertia);
  }

  // Carry the derivatives over the step at whose end the system stands.
  void push(double dt, const Frames &given, bool inertia) {
    const std::size_t whole = system.whole(), width = r_.columns;
    const bool responding = sources.any();
    const Frames frames = responding ? answer(given) : given;
    modulations_.apply(frames.weights);
    system.assemble(true, nullptr);
    if (system.factorise(true))
      tangent_.adopt(true);
    else
      system.factorise(false);  // need not be definite where motion holds it
    Values held(whole * width, 0.0), d_base(whole * width), d_v_base(whole * width);
    move(frames, held);
    system.embedding.fill(held.data(), int(width));
    for (std::size_t k = 0; k < whole * width; ++k) {
      d_base[k] = has_past ? step_.now * d_x[k] + step_.before * d_x_past[k] : d_x[k];
      d_v_base[k] = has_past ? step_.now * d_v[k] + step_.before * d_v_past[k] : d_v[k];
    }
    std::fill(d_force_.begin(), d_force_.end(), 0.0);
    add_inertia(d_base, d_v_base, inertia);
    add_columns(held);
    for (std::size_t k = 0; responding && k < d_force_.size(); ++k) d_force_[k] += sources.force[k];
    Values total = d_force_, moved(system.count() * width);
    system.hessian.multiply(held.data(), total.data(), int(width));
    system.fold(total.data(), int(width));
    for (int k = 0; k < system.count(); ++k)
      std::copy_n(&total[width * system.own[k]], width, &moved[width * k]);
    system.factor.solve(moved.data(), int(width));
    Values there = std::move(held);  // from here on the derivative of all positions
    for (int k = 0; k < system.count(); ++k)
      for (std::size_t c = 0; c < width; ++c) there[width * system.own[k] + c] = -moved[width * k + c];
    system.yielding.follow(there.data(), int(width));
    system.embedding.fill(there.data(), int(width));
    system.hessian.multiply(there.data(), d_force_.data(), int(width));
    system.contacts.end_columns(x.data(), system.x.data(), d_x.data(), there.data(), dt, d_turned_.data(), memory,
                                d_moment_.data(), d_force_.data());
    if (responding) add_on_bodies();
    system.embedding.fold(d_force_.data(), int(width));
    system.triangles.keep_slopes(system.x.data(), there.data());
    system.hinges.keep_slopes(system.x.data(), there.data());
    system.tetrahedra.keep_slopes(system.x.data(), there.data());
    d_x_past.swap(d_x);
    d_v_past.swap(d_v);
    for (std::size_t k = 0; k < whole * width; ++k) d_v[k] = inertia ? (there[k] - d_base[k]) / step_.tau : 0.0;
    d_x.swap(there);
  }

  // Sources on what is set anew with the memory: forces on the nodes of rigid bodies, and moments about these.
  void add_on_bodies() {
    const std::size_t width = r_.columns;
    for (std::size_t k = 0; k < d_moment_.size(); ++k) d_moment_[k] += sources.moment[k];
    for (int c = 0; c < r_.contacts; ++c) {
      const int32_t *end = r_.body_node + c;
      if (std::find(r_.body_node, end, *end) != end) continue;
      for (std::size_t k = 3 * width * *end; k < 3 * width * (*end + 1); ++k) d_force_[k] += sources.force[k];
    }
  }

  // What forces of the elements change by where positions at the end are held but for those of rigid bodies, `dx`, into
  // d_force_.
  void add_columns(const Values &dx) {
    system.triangles.add_columns(system.x.data(), d_force_.data());
    system.hinges.add_columns(system.x.data(), d_force_.data());
    system.tetrahedra.add_columns(system.x.data(), d_force_.data());
    system.drag.add_columns(system.x.data(), d_x.data(), d_force_.data());
    system.loads.add_columns(system.x.data(), d_x.data(), d_force_.data());
    system.yielding.add_columns(system.x.data(), d_force_.data());
    system.contacts.add_columns(x.data(), system.x.data(), d_x.data(), dx.data(), d_turned_.data(), memory, d_force_.data());
  }

  // Motions of followers and turns of rigid bodies by the parameters.
  void move(const Frames &frames, Values &held) {
    std::fill(d_turned_.begin(), d_turned_.end(), 0.0);
    if (!frames.motions) return;
    const std::size_t width = r_.columns;
    for (int f = 0; f < r_.followers; ++f) {
      const double *turn = frames.places + 12 * r_.follower_mount[f] + 3, *y = r_.follower_local + 3 * f;
      const double *m = frames.motions + 6 * width * r_.follower_mount[f];
      for (std::size_t c = 0; c < width; ++c) {
        const Vec3 shift = {{m[c], m[width + c], m[2 * width + c]}};
        const Vec3 spin = {{m[3 * width + c], m[4 * width + c], m[5 * width + c]}};
        const Vec3 there = matmul(rotation_of(turn), Vec3(shift + spin.cross(Vec3{{y[0], y[1], y[2]}})));
        for (int i = 0; i < 3; ++i)
          if (r_.follower_axes[3 * f + i] && r_.prescribed[3 * r_.follower_node[f] + i])
            held[(3 * r_.follower_node[f] + i) * width + c] = there[i];
      }
    }
    for (int b = 0; b < r_.contacts; ++b) {
      const double *m = frames.motions + 6 * width * r_.body_mount[b];
      const Mat3 turn = rotation_of(frames.places + 12 * r_.body_mount[b] + 3), own = rotation_of(r_.body_rotation + 9 * b);
      for (std::size_t c = 0; c < width; ++c) {
        const double p = m[3 * width + c], q = m[4 * width + c], s = m[5 * width + c];
        const Mat3 cross = {{0.0, -s, q, s, 0.0, -p, -q, p, 0.0}};
        const Mat3 by = matmul(matmul(turn, cross), own);
        for (int k = 0; k < 9; ++k) d_turned_[(9 * b + k) * width + c] = by[k];
      }
    }
  }

  // What inertia, damping by mass and loads change by, into d_force_.
  void add_inertia(const Values &d_base, const Values &d_v_base, bool inertia) {
    const std::size_t width = r_.columns;
    const double tau = step_.tau, factor = inertia ? 1.0 / (tau * tau) : 0.0;
    for (std::size_t k = 0; k < d_force_.size(); ++k) d_force_[k] -= r_.d_external[k];
    const int entries = r_.mass_start[r_.nodes];
    for (int i = 0; i < r_.nodes; ++i)
      for (int k = r_.mass_start[i]; k < r_.mass_start[i + 1]; ++k) {
        const int j = r_.mass_column[k];
        const double pull = -factor * r_.mass[k], rub = -r_.mass_damping[k] / tau;
        for (int a = 0; a < 3; ++a) {
          double *to = &d_force_[(3 * i + a) * width];
          const double *by = &d_base[(3 * j + a) * width], *by_v = &d_v_base[(3 * j + a) * width];
          for (std::size_t c = 0; c < width; ++c) to[c] += (pull + rub) * by[c] + pull * tau * by_v[c];
          const double since = system.x[3 * j + a] - step_.x_base[3 * j + a];
          const double accelerated = factor * (since - tau * step_.v_base[3 * j + a]);
          for (int m = 0; m < r_.mass_blocks; ++m)
            to[r_.mass_of[m]] += r_.d_mass[m * entries + k] * accelerated + r_.d_mass_damping[m * entries + k] * since / tau;
        }
      }
  }

  Record r_;
  Modulations modulations_;
  Gradings gradings_;
  Step step_;
  Values v_, turned_, d_turned_, targets_, d_force_, d_moment_, moment_, places_, motions_, weights_, moved_;

 public:
  System system;
  Values x, x_past, v_past, d_x, d_v, d_x_past, d_v_past;
  Memory memory;
  Values time;        // since the start [s] (1)
  Values pair_force;  // of the contacts at the end of the last step (terms, nodes, 3); empty: not kept
  double dt_past = 0.0;
  bool has_past = false;
  Values &velocity() { return v_; }
  const Record &record() const { return r_; }
  void may_take(int64_t iterations) { r_.slow_iterations = iterations; }  // of a guarded search

  Tape *tape = nullptr;  // takes note of the steps
  Sources sources;
  std::vector<std::pair<Rollout *, int>> amended;  // rollouts with laws that this one lacks, and their columns, -1: none

  // A state without its derivatives.
  struct Kept {
    Values x, v, x_past, v_past, turned, moment, pair_force, end, gradient, time;
    Memory memory;
    std::vector<Held> held;
    std::vector<Keys> keys;
    std::vector<Values> materials;
    double dt_past;
    bool has_past;
  };
  Kept keep() {
    Kept out{x, v_, x_past, v_past, turned_, moment_, pair_force, system.x, system.gradient, time, memory, {}, {}, {}, dt_past, has_past};
    for (Surface &term : system.contacts.surfaces) out.held.push_back(term.held);
    for (EdgePairs &term : system.contacts.edges) {
      out.held.push_back(term.held);
      out.keys.push_back(term.keys);
    }
    for (int k = 0; k < r_.material_laws; ++k) out.materials.push_back(system.material(k, false));
    return out;
  }
  void put_back(const Kept &kept) {
    x = kept.x;
    v_ = kept.v;
    x_past = kept.x_past;
    v_past = kept.v_past;
    turned_ = kept.turned;
    moment_ = kept.moment;
    pair_force = kept.pair_force;
    system.x = kept.end;
    system.gradient = kept.gradient;
    memory = kept.memory;
    std::size_t k = 0;
    for (Surface &term : system.contacts.surfaces) term.held = kept.held[k++];
    std::size_t e = 0;
    for (EdgePairs &term : system.contacts.edges) {
      term.held = kept.held[k++];
      term.keys = kept.keys[e++];
    }
    for (int law = 0; law < r_.material_laws; ++law) system.material(law, false) = kept.materials[law];
    dt_past = kept.dt_past;
    time = kept.time;
    has_past = kept.has_past;
    tangent_.drop();
  }

  // Keep the forces of contacts.
  void keep_forces() { pair_force.assign(3 * r_.nodes * (r_.contacts + r_.surfaces + r_.edge_pairs), 0.0); }

  // Make room for sources.
  void respond() {
    sources.force.assign(system.whole() * r_.columns, 0.0);
    sources.moment.assign(3 * r_.contacts * r_.columns, 0.0);
    sources.motion.assign(6 * r_.mounts * r_.columns, 0.0);
  }

 private:
  Tangent<System> tangent_;  // of the step before
};

}  // namespace thinshell
